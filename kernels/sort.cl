// sort: one pass of a stable least-significant-digit radix sort of (key, value) pairs. Chunks of contiguous elements
// keep their order, bins are walked in order: no atomics, the same result on every device.

static inline uint digit_of(uint key, uint shift, uint bins) { return (key >> shift) & (bins - 1); }

// Launch: one work-item per chunk.
__kernel void sort_histogram(__global const uint *keys, // in [n]
                             __global const uint *status, uint n_slot, uint chunks, uint shift, uint bins,
                             __global uint *histogram) { // out [chunks, bins]
  const uint c = get_global_id(0);
  if (c >= chunks) return;
  __global uint *row = histogram + (size_t)c * bins;
  for (uint b = 0; b < bins; b++) row[b] = 0;
  const uint n = status[n_slot], size = (n + chunks - 1) / chunks;
  const uint first = min(c * size, n), last = min(first + size, n);
  for (uint i = first; i < last; i++) row[digit_of(keys[i], shift, bins)]++;
}

// Launch: one work-item per bin. Sums the bin over the chunks.
__kernel void sort_totals(__global const uint *histogram, uint chunks, uint bins,
                          __global uint *totals) { // out [bins]
  const uint b = get_global_id(0);
  if (b >= bins) return;
  uint sum = 0;
  for (uint c = 0; c < chunks; c++) sum += histogram[(size_t)c * bins + b];
  totals[b] = sum;
}

// Launch: one work-item. Exclusive prefix sum of the bins' totals.
__kernel void sort_bins(__global uint *totals, uint bins) { // in/out [bins]
  if (get_global_id(0) != 0) return;
  uint sum = 0;
  for (uint b = 0; b < bins; b++) {
    const uint v = totals[b];
    totals[b] = sum;
    sum += v;
  }
}

// Launch: one work-item per bin. Turns counts into first positions, chunk by chunk.
__kernel void sort_offsets(__global uint *histogram, uint chunks, uint bins, // in/out [chunks, bins]
                           __global const uint *totals) {                    // in [bins] exclusive
  const uint b = get_global_id(0);
  if (b >= bins) return;
  uint sum = totals[b];
  for (uint c = 0; c < chunks; c++) {
    const size_t at = (size_t)c * bins + b;
    const uint v = histogram[at];
    histogram[at] = sum;
    sum += v;
  }
}

// Launch: one work-item per chunk.
__kernel void sort_scatter(__global const uint *keys, // in [n]
                           __global const uint *status, uint n_slot, uint chunks, uint shift, uint bins,
                           __global uint *histogram,    // in/out [chunks, bins] next position
                           __global const uint *values, // in [n]
                           __global uint *keys_out, __global uint *values_out) { // out [n]
  const uint c = get_global_id(0);
  if (c >= chunks) return;
  __global uint *row = histogram + (size_t)c * bins;
  const uint n = status[n_slot], size = (n + chunks - 1) / chunks;
  const uint first = min(c * size, n), last = min(first + size, n);
  for (uint i = first; i < last; i++) {
    const uint key = keys[i], at = row[digit_of(key, shift, bins)]++;
    keys_out[at] = key;
    values_out[at] = values[i];
  }
}
