// scan: exclusive prefix sum of uint, in fixed order, in two launches of one work-item per chunk; the values of a chunk are contiguous.

static inline uint chunk_size(uint n, uint chunks) { return (n + chunks - 1) / chunks; }

__kernel void scan_sums(__global const uint *values, uint n, // in [n]
                        uint chunks, __global uint *sums) {  // out [chunks]
  const uint c = get_global_id(0);
  if (c >= chunks) return;
  const uint size = chunk_size(n, chunks), first = min(c * size, n), last = min(first + size, n);
  uint sum = 0;
  for (uint i = first; i < last; i++) sum += values[i];
  sums[c] = sum;
}

// Writes the total to status[total_slot], too; a total above the capacity raises the sticky overflow flag (the host grows the
// buffer and repeats) and leaves nothing to do for the stages that follow.
__kernel void scan_write(__global const uint *values, uint n,       // in [n]
                         uint chunks, __global const uint *sums,    // in [chunks]
                         __global uint *out,                        // out [n] exclusive prefix sums
                         __global uint *status, uint total_slot, uint capacity) {
  const uint c = get_global_id(0);
  if (c >= chunks) return;
  const uint size = chunk_size(n, chunks), first = min(c * size, n), last = min(first + size, n);
  const ulong before = sum_before(sums, c);
  uint sum = (uint)before;
  for (uint i = first; i < last; i++) {
    out[i] = sum;
    sum += values[i];
  }
  if (c < chunks - 1) return;
  const ulong total = before + sums[c];
  const uint needed = (uint)min(total, (ulong)0xffffffffu);
  status[total_slot] = total > (ulong)capacity ? 0 : needed;
  if (total > (ulong)capacity && status[S_OVERFLOW] < needed) status[S_OVERFLOW] = needed;
}
