// scan: exclusive prefix sum of uint, in fixed order, in two launches over chunks.
#include "chunks.clh"

CHUNK_KERNEL void scan_sums(__global const uint *values, uint n, // in [n]
                            uint chunks, __global uint *sums) {  // out [chunks]
  SCRATCH;
  const uint c = CHUNK;
  if (c >= chunks) return;
  const uint size = chunk_size(n, chunks), first = min(c * size, n), last = min(first + size, n);
  uint sum = 0;
  for (uint i = first + ITEM; i < last; i += GROUP) sum += values[i];
  sum = (uint)group_sum(sum, scratch);
  if (ITEM == 0) sums[c] = sum;
}

// Writes the total to status[total_slot], too; a total above the capacity raises the sticky overflow flag (the host grows the
// buffer and repeats) and leaves nothing to do for the stages that follow.
CHUNK_KERNEL void scan_write(__global const uint *values, uint n,    // in [n]
                             uint chunks, __global const uint *sums, // in [chunks]
                             __global uint *out,                     // out [n] exclusive prefix sums
                             __global uint *status, uint total_slot, uint capacity) {
  SCRATCH;
  const uint c = CHUNK;
  if (c >= chunks) return;
  const uint size = chunk_size(n, chunks), first = min(c * size, n), last = min(first + size, n);
  const ulong before = group_sum(sum_before(sums, c), scratch);
  // Before the loop: what stands after one that holds barriers and has no turn, PoCL 3.1 leaves out.
  if (c == chunks - 1 && ITEM == 0) {
    const ulong all = before + sums[c];
    const uint needed = (uint)min(all, (ulong)0xffffffffu);
    // None either while the flag of an iteration before is up: nobody has written pairs then.
    status[total_slot] = all > (ulong)capacity || status[S_OVERFLOW] != 0 ? 0 : needed;
    if (all > (ulong)capacity && status[S_OVERFLOW] < needed) status[S_OVERFLOW] = needed;
  }
  uint sum = (uint)before;
  for (uint block = first; block < last; block += GROUP) {
    const uint i = block + ITEM, value = i < last ? values[i] : 0;
    uint total;
    const uint within = group_scan(value, scratch, &total);
    if (i < last) out[i] = sum + within;
    sum += total;
  }
}
