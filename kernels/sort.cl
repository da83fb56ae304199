// sort: a stable least-significant-digit radix sort of (key, value) pairs. Chunks of contiguous elements keep their order, bins are
// walked in order: the same result on every device. The number of elements is in the status. A pass is sort_histogram, sort_bins (by
// groups: sort_totals) and sort_scatter; by groups bin_compact counts for the first pass by depth. Few elements are sorted by one
// work-item in one launch where that is a whole core.
#include "chunks.clh"

#if !GROUP_STYLE
// Exclusive prefix sum.
static inline void sum_bins(__global uint *totals, uint bins) { // in/out [bins]
  uint sum = 0;
  for (uint b = 0; b < bins; b++) {
    const uint v = totals[b];
    totals[b] = sum;
    sum += v;
  }
}
#endif

// Launch: over chunks.
CHUNK_KERNEL void sort_histogram(__global const uint *keys, // in [n]
                                 __global const uint *status, uint counter, uint chunks, uint shift, uint bins,
                                 __global uint *histogram) { // out [chunks, bins]
  const uint c = CHUNK;
  if (c >= chunks) return;
  __global uint *row = histogram + (size_t)c * bins;
  const uint n = status[counter], size = chunk_size(n, chunks);
  const uint first = min(c * size, n), last = min(first + size, n);
#if GROUP_STYLE
  __local uint counts[GROUP];
  counts[ITEM] = 0;
  barrier(CLK_LOCAL_MEM_FENCE);
  for (uint i = first + ITEM; i < last; i += GROUP)
    atomic_inc(counts + digit_of(keys[i], shift, bins)); // of integers: the same in any order
  barrier(CLK_LOCAL_MEM_FENCE);
  if (ITEM < bins) row[ITEM] = counts[ITEM];
#else
  for (uint b = 0; b < bins; b++) row[b] = 0;
  for (uint i = first; i < last; i++) row[digit_of(keys[i], shift, bins)]++;
#endif
}

#if GROUP_STYLE
// Runs of chunks that the work-items of a group of sort_totals share out.
#define RUNS (GROUP / GROUP_BINS)

// Launch: one work-group per GROUP_BINS bins. Turns a bin's counts into those of the chunks before, and sums them up: a work-item has a
// run of the chunks of one bin.
CHUNK_KERNEL void sort_totals(__global uint *histogram, uint chunks, uint bins, // in/out [chunks, bins]
                              __global uint *totals) {                          // out [bins]
  __local uint counts[RUNS][GROUP_BINS];
  const uint x = ITEM % GROUP_BINS, y = ITEM / GROUP_BINS, b = CHUNK * GROUP_BINS + x, run = (chunks + RUNS - 1) / RUNS;
  const uint first = min(y * run, chunks), last = b < bins ? min(first + run, chunks) : first;
  uint sum = 0, before = 0;
  for (uint c = first; c < last; c++) sum += histogram[(size_t)c * bins + b];
  counts[y][x] = sum;
  barrier(CLK_LOCAL_MEM_FENCE);
  for (uint k = 0; k < y; k++) before += counts[k][x];
  for (uint c = first; c < last; c++) {
    const size_t at = (size_t)c * bins + b;
    const uint count = histogram[at];
    histogram[at] = before;
    before += count;
  }
  if (b < bins && y == RUNS - 1) totals[b] = before;
}
#else
// Launch: one work-item. Turns counts into those of the chunks before, along the rows of the histogram, and writes first places of the
// bins.
__kernel void sort_bins(__global uint *histogram, uint chunks, uint bins, // in/out [chunks, bins] elements of the chunks before
                        __global uint *totals) {                          // out [bins + 1] first place; the number of elements
  if (get_global_id(0) != 0) return;
  for (uint b = 0; b < bins; b++) totals[b] = 0;
  for (uint c = 0; c < chunks; c++) {
    __global uint *row = histogram + (size_t)c * bins;
    for (uint b = 0; b < bins; b++) {
      const uint v = row[b];
      row[b] = totals[b];
      totals[b] += v;
    }
  }
  totals[bins] = 0;
  sum_bins(totals, bins + 1);
}
#endif

#if GROUP_STYLE
// Elements that a group sorts at a time, and those of a work-item.
#define BLOCK (1 << BLOCK_BITS)
#define SORT_RUN (BLOCK / GROUP)
#endif

#if GROUP_STYLE
#define CHUNK_STARTS __global const uint *starts, uint uneven, // in [chunks + 1] where chunks begin, if they are not as long as others
#else
#define CHUNK_STARTS
#endif

// Launch: over chunks.
CHUNK_KERNEL void sort_scatter(__global const uint *keys, // in [n]
                               __global const uint *status, uint counter, uint chunks, uint shift, uint bins,
                               __global uint *histogram,    // in/out [chunks, bins] elements of the chunks before
                               CHUNK_STARTS
                               __global const uint *totals, // in [bins + 1] first places; by groups [bins] elements
                               __global const uint *values, // in [n]
                               __global uint *keys_out, __global uint *values_out) { // out [n]
  const uint c = CHUNK;
  if (c >= chunks) return;
  __global uint *row = histogram + (size_t)c * bins;
  const uint n = status[counter], size = chunk_size(n, chunks);
#if GROUP_STYLE
  SCRATCH;
  const uint first = uneven ? starts[c] : min(c * size, n), last = uneven ? starts[c + 1] : min(first + size, n);
  __local uint place[GROUP], head[GROUP], sorted[BLOCK + 1]; // of sorted: digit and place in the block, after one that is no digit
  const uint l = ITEM;
  uint all;
  const uint before_bin = group_scan(l < bins ? totals[l] : 0, scratch, &all);
  if (l < bins) place[l] = before_bin + row[l];
  if (l == 0) sorted[0] = bins * BLOCK;
  for (uint block = first; block < last; block += BLOCK) {
    const uint here = min((uint)BLOCK, last - block);
    uint own[SORT_RUN];
    // A block is sorted by its digits first, two bits after the other. What is not there comes last.
#pragma unroll
    for (uint k = 0; k < SORT_RUN; k++) {
      const uint from = l * SORT_RUN + k;
      own[k] = (from < here ? digit_of(keys[block + from], shift, bins) : bins - 1) * BLOCK + from;
    }
    for (uint bit = BLOCK_BITS; 1u << bit < bins * BLOCK; bit += 2) {
      // Four counters of 16 bits.
      ulong counts = 0, sums;
#pragma unroll
      for (uint k = 0; k < SORT_RUN; k++) counts += 1ul << 16 * (own[k] >> bit & 3);
      ulong next = group_scan_long(counts, scratch, &sums);
      next += (sums << 16) + (sums << 32) + (sums << 48);
#pragma unroll
      for (uint k = 0; k < SORT_RUN; k++) {
        const uint field = 16 * (own[k] >> bit & 3);
        sorted[1 + (uint)(next >> field & 0xffff)] = own[k];
        next += 1ul << field;
      }
      barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
      for (uint k = 0; k < SORT_RUN; k++) own[k] = sorted[1 + l * SORT_RUN + k];
    }
    for (uint k = l; k < BLOCK; k += GROUP)
      if (sorted[k] / BLOCK != sorted[1 + k] / BLOCK) head[sorted[1 + k] / BLOCK] = k;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint k = l; k < BLOCK; k += GROUP) {
      const uint digit = sorted[1 + k] / BLOCK, from = sorted[1 + k] % BLOCK;
      if (from < here) {
        const uint at = place[digit] + k - head[digit];
        keys_out[at] = keys[block + from];
        values_out[at] = values[block + from];
      }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint k = l; k < BLOCK; k += GROUP) {
      const uint digit = sorted[1 + k] / BLOCK;
      if (k == BLOCK - 1 || sorted[2 + k] / BLOCK != digit) place[digit] += k + 1 - head[digit];
    }
  }
#else
  const uint first = min(c * size, n), last = min(first + size, n);
  for (uint i = first; i < last; i++) {
    const uint key = keys[i], digit = digit_of(key, shift, bins), at = totals[digit] + row[digit]++;
    keys_out[at] = key;
    values_out[at] = values[i];
  }
#endif
}

#if !GROUP_STYLE
// Launch: one work-item. All passes of few elements: one sweep counts the digits of all passes.
__kernel void sort_few(__global const uint *status, uint counter, uint passes, uint bits, // passes, bits of a digit
                       __global uint *histogram,                           // scratch [passes, bins]
                       __global uint *keys, __global uint *values,         // in [n], and out after an even number of passes
                       __global uint *keys_too, __global uint *values_too) { // out [n] after an odd number
  if (get_global_id(0) != 0) return;
  const uint n = status[counter], bins = 1u << bits;
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
#endif
