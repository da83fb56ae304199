// sort: a stable least-significant-digit radix sort of (key, value) pairs. Chunks of contiguous elements
// keep their order, bins are walked in order: no atomics, the same result on every device. A pass is sort_histogram, sort_bins
// and sort_scatter; few elements are sorted by one work-item in one launch.

static inline uint digit_of(uint key, uint shift, uint bins) { return (key >> shift) & (bins - 1); }

// Exclusive prefix sum.
static inline void sum_bins(__global uint *totals, uint bins) { // in/out [bins]
  uint sum = 0;
  for (uint b = 0; b < bins; b++) {
    const uint v = totals[b];
    totals[b] = sum;
    sum += v;
  }
}

// Launch: one work-item per chunk.
__kernel void sort_histogram(__global const uint *keys, // in [n]
                             __global const uint *status, uint chunks, uint shift, uint bins,
                             __global uint *histogram) { // out [chunks, bins]
  const uint c = get_global_id(0);
  if (c >= chunks) return;
  __global uint *row = histogram + (size_t)c * bins;
  for (uint b = 0; b < bins; b++) row[b] = 0;
  const uint n = status[S_VISIBLE], size = (n + chunks - 1) / chunks;
  const uint first = min(c * size, n), last = min(first + size, n);
  for (uint i = first; i < last; i++) row[digit_of(keys[i], shift, bins)]++;
}

#if GROUP_STYLE
// Launch: one work-item per bin. Turns a bin's counts into those of the chunks before, and sums them up.
__kernel void sort_totals(__global uint *histogram, uint chunks, uint bins, // in/out [chunks, bins]
                          __global uint *totals) {                          // out [bins]
  const uint b = get_global_id(0);
  if (b >= bins) return;
  uint sum = 0;
  for (uint c = 0; c < chunks; c++) {
    const size_t at = (size_t)c * bins + b;
    const uint v = histogram[at];
    histogram[at] = sum;
    sum += v;
  }
  totals[b] = sum;
}
#endif

// Launch: one work-item. Writes first places of the bins, after sort_totals; where a work-item is a whole core this does the work of
// that kernel, too, along the rows of the histogram.
__kernel void sort_bins(__global uint *histogram, uint chunks, uint bins, // in/out [chunks, bins] elements of the chunks before
                        __global uint *totals) {                          // out [bins + 1] first place; the number of elements
  if (get_global_id(0) != 0) return;
#if !GROUP_STYLE
  for (uint b = 0; b < bins; b++) totals[b] = 0;
  for (uint c = 0; c < chunks; c++) {
    __global uint *row = histogram + (size_t)c * bins;
    for (uint b = 0; b < bins; b++) {
      const uint v = row[b];
      row[b] = totals[b];
      totals[b] += v;
    }
  }
#endif
  totals[bins] = 0;
  sum_bins(totals, bins + 1);
}

// Launch: one work-item per chunk.
__kernel void sort_scatter(__global const uint *keys, // in [n]
                           __global const uint *status, uint chunks, uint shift, uint bins,
                           __global uint *histogram,    // in/out [chunks, bins] elements of the chunks before
                           __global const uint *totals, // in [bins + 1] first places
                           __global const uint *values, // in [n]
                           __global uint *keys_out, __global uint *values_out) { // out [n]
  const uint c = get_global_id(0);
  if (c >= chunks) return;
  __global uint *row = histogram + (size_t)c * bins;
  const uint n = status[S_VISIBLE], size = (n + chunks - 1) / chunks;
  const uint first = min(c * size, n), last = min(first + size, n);
  for (uint i = first; i < last; i++) {
    const uint key = keys[i], digit = digit_of(key, shift, bins), at = totals[digit] + row[digit]++;
    keys_out[at] = key;
    values_out[at] = values[i];
  }
}

// Launch: one work-item. All passes of few elements: one sweep counts the digits of all passes.
__kernel void sort_few(__global const uint *status, uint passes, uint bits, // passes, bits of a digit
                       __global uint *histogram,                           // scratch [passes, bins]
                       __global uint *keys, __global uint *values,         // in [n], and out after an even number of passes
                       __global uint *keys_too, __global uint *values_too) { // out [n] after an odd number
  if (get_global_id(0) != 0) return;
  const uint n = status[S_VISIBLE], bins = 1u << bits;
  for (uint b = 0; b < passes * bins; b++) histogram[b] = 0;
  for (uint i = 0; i < n; i++)
    for (uint p = 0; p < passes; p++) histogram[p * bins + digit_of(keys[i], p * bits, bins)]++;
  for (uint p = 0; p < passes; p++) {
    __global uint *row = histogram + p * bins;
    __global const uint *from = p % 2 ? keys_too : keys, *values_from = p % 2 ? values_too : values;
    __global uint *to = p % 2 ? keys : keys_too, *values_to = p % 2 ? values : values_too;
    sum_bins(row, bins);
    for (uint i = 0; i < n; i++) {
      const uint key = from[i], at = row[digit_of(key, p * bits, bins)]++;
      to[at] = key;
      values_to[at] = values_from[i];
    }
  }
}
