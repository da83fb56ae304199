// scan: exclusive prefix sum of uint, in fixed order, in three launches. The number of elements is status[n_slot], so
// that no count ever travels to the host (or `known`, where n_slot is no slot); `chunk` elements per work-item are contiguous.

static inline uint chunk_size(uint n, uint chunks) { return (n + chunks - 1) / chunks; }

static inline uint count_of(__global const uint *status, uint n_slot, uint known) {
  return n_slot < STATUS_SLOTS ? status[n_slot] : known;
}

// Launch: one work-item per chunk.
__kernel void scan_sums(__global const uint *values, // in [n]
                        __global const uint *status, uint n_slot, uint known, uint chunks,
                        __global uint *sums) { // out [chunks]
  const uint c = get_global_id(0);
  if (c >= chunks) return;
  const uint n = count_of(status, n_slot, known), size = chunk_size(n, chunks);
  const uint first = min(c * size, n), last = min(first + size, n);
  uint sum = 0;
  for (uint i = first; i < last; i++) sum += values[i];
  sums[c] = sum;
}

// Launch: one work-item. Writes the total to status[total_slot]; a total above the capacity raises the sticky overflow
// flag (the host grows the buffer and repeats) and leaves nothing to do for the stages that follow.
__kernel void scan_chunks(__global uint *sums, uint chunks, // in/out [chunks]
                          __global uint *status, uint total_slot, uint capacity) {
  if (get_global_id(0) != 0) return;
  ulong total = 0;
  for (uint c = 0; c < chunks; c++) {
    const uint v = sums[c];
    sums[c] = (uint)total;
    total += v;
  }
  const uint needed = (uint)min(total, (ulong)0xffffffffu);
  status[total_slot] = needed;
  if (total > (ulong)capacity) {
    if (status[S_OVERFLOW] < needed) status[S_OVERFLOW] = needed;
    status[total_slot] = 0;
  }
}

// Launch: one work-item per chunk.
__kernel void scan_write(__global const uint *values, // in [n]
                         __global const uint *status, uint n_slot, uint known, uint chunks,
                         __global const uint *sums, // in [chunks] exclusive
                         __global uint *out) {      // out [n] exclusive prefix sums
  const uint c = get_global_id(0);
  if (c >= chunks) return;
  const uint n = count_of(status, n_slot, known), size = chunk_size(n, chunks);
  const uint first = min(c * size, n), last = min(first + size, n);
  uint sum = sums[c];
  for (uint i = first; i < last; i++) {
    out[i] = sum;
    sum += values[i];
  }
}
