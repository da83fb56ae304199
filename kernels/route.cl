// route: where several ranks train one scene, the visible Gaussians of one of them -> the bands of tile rows that they touch, one band a
// rank; and the sums of their pairs there -> one list for each Gaussian, by bands from top to bottom, which is the order of its pairs
// where one rank has them all; pairs of another rank's Gaussian that lies in one band are added up there, in the same order. A Gaussian
// that a band gets is cut to the rows of the band, so that its pairs there are those of these rows. Launches are over chunks of Gaussians, or Gaussians, of some rows alone where what is sent of them travels while the device is at
// others. Source: the division of Gaussians and pixels among devices of Grendel-GS,
// Zhao et al. 2024.
#include "chunks.clh"

// Rows of tiles of a Gaussian, as project leaves them in the place of the number of its pairs: the first, and the one after the last in the high
// half; of a culled one no row.
#define FIRST_ROW(span) ((span) & 0xffffu)
#define END_ROW(span) ((span) >> 16)

// True if a Gaussian touches the rows of tiles from `from` to before `to`.
static inline int touches_band(uint span, uint from, uint to) { return END_ROW(span) > from && FIRST_ROW(span) < to && from < to; }

// Bands that a Gaussian touches, from .x to before .y; empty ones between them, too. Sums in the place of branches, of which half would be
// foretold wrongly.
static inline uint2 bands_of(uint span, __global const uint *bands, uint ranks) {
  uint2 touched = (uint2)(0, 0);
  for (uint rank = 0; rank < ranks; rank++) touched += (uint2)(bands[rank + 1] <= FIRST_ROW(span), bands[rank] < END_ROW(span));
  return touched;
}
#define IS_EMPTY(rank) (bands[rank] == bands[(rank) + 1])

// Own Gaussians from `begin` to before `end`: in [end] rows of tiles; bands in [ranks + 1] first row of tiles of each.
#define ROUTE_ARGUMENTS __global const uint *spans, uint begin, uint end, __global const uint *bands
// A chunk of them: the first, and the one after the last.
#define CHUNK_BEGIN(c) min(begin + (c) * chunk_size(end - begin, chunks), end)

// Launch: over chunks of Gaussians (first axis) and ranks (second). Counts those that touch a rank's band.
CHUNK_KERNEL void route_count(ROUTE_ARGUMENTS, uint chunks, __global uint *sums) { // out [ranks, chunks]
  SCRATCH;
  const uint c = CHUNK, rank = get_global_id(1);
  if (c >= chunks) return;
  const uint first = CHUNK_BEGIN(c), last = CHUNK_BEGIN(c + 1);
  const uint from = bands[rank], to = bands[rank + 1];
  uint n = 0;
  for (uint i = first + ITEM; i < last; i += GROUP) n += touches_band(spans[i], from, to);
  n = (uint)group_sum(n, scratch);
  if (ITEM == 0) sums[rank * chunks + c] = n;
}

// Launch: over chunks of Gaussians (first axis) and some ranks from `begins` on (second). Writes what each of these gets, in the order of the
// Gaussians, one rank's after the other's.
CHUNK_KERNEL void route_pack(ROUTE_ARGUMENTS, uint chunks, __global const uint *sums, // in [ranks, chunks]
                             __global const Projected *records, __global const uint *keys, // in [end]
                             uint begins, uint at_first,                              // first of the ranks, and the place of its first
                             __global uint *sent_keys,                                // out [at_first + sent to them]
                             __global Projected *sent,                                // out [at_first + sent to them], cut to the band
                             uint stride, __global uint *place) {                     // out [ranks, stride] number among those that a rank gets
  SCRATCH;
  const uint c = CHUNK, rank = begins + get_global_id(1);
  if (c >= chunks) return;
  const uint first = CHUNK_BEGIN(c), last = CHUNK_BEGIN(c + 1);
  const uint from = bands[rank], to = bands[rank + 1];
  const size_t own = (size_t)rank * stride;
  const uint sums_before = (uint)group_sum(sum_before(sums + begins * chunks, (rank - begins) * chunks), scratch);
  const uint to_rank = at_first + sums_before;
  uint before = (uint)group_sum(sum_before(sums + rank * chunks, c), scratch);
  for (uint block = first; block < last; block += GROUP) {
    const uint i = block + ITEM;
    const int touches = i < last && touches_band(spans[i], from, to);
    uint total;
    const uint at = before + group_scan(touches, scratch, &total);
    if (touches) {
      Projected cut = records[i];
      cut.by = max((uint)BOUND_LO(cut.by), from * TILE) | min((uint)BOUND_HI(cut.by), to * TILE - 1) << 16;
      sent_keys[(size_t)to_rank + at] = keys[i];
      sent[(size_t)to_rank + at] = cut;
      place[own + i] = at;
    }
    before += total;
  }
}

// First slots of what was sent to each other rank, as that rank counts them: in [number sent + 1] from offsets[rank] on; the slot here is
// shifts[rank] more, modulo 2^32. In the own band first slots and numbers of pairs are those of its view, in which the Gaussians of these rows
// begin at own_first.
#define RETURN_ARGUMENTS                                                                                                       \
  uint ranks, uint stride, __global const uint *place, __global const uint *starts, __global const uint *offsets,              \
      __global const uint *shifts, uint own, uint own_first, __global const uint *own_start, __global const uint *own_counts
#define RETURN_NAMES ranks, stride, place, starts, offsets, shifts, own, own_first, own_start, own_counts

// First slot of the sums of a Gaussian's pairs in a band that it touches, and their number.
static inline uint2 returned(uint rank, uint i, RETURN_ARGUMENTS) {
  const uint at = place[(size_t)rank * stride + i];
  if (rank == own) return (uint2)(own_start[own_first + at], own_counts[own_first + at]);
  __global const uint *slot = starts + offsets[rank] + at;
  return (uint2)(slot[0] + shifts[rank], slot[1] - slot[0]);
}

// Launch: one work-item per own Gaussian. Writes the number of its pairs in all bands and, where it touches one band, the first slot of
// their sums; where it touches more, it wants a place for all of them together, of this length.
__kernel void route_pairs(ROUTE_ARGUMENTS, RETURN_ARGUMENTS, __global uint *isect_counts, // out [end]
                          __global uint *isect_start,                                     // out [end]
                          __global uint *wanted) {                                        // out [end - begin]
  const uint i = begin + get_global_id(0);
  if (i >= end) return;
  const uint2 touched = bands_of(spans[i], bands, ranks);
  uint n = 0, lists = 0, only = 0;
  for (uint rank = touched.x; rank < touched.y; rank++) {
    if (IS_EMPTY(rank)) continue;
    const uint2 list = returned(rank, i, RETURN_NAMES);
    n += list.y;
    only = list.x;
    lists++;
  }
  isect_counts[i] = n;
  isect_start[i] = only;
  wanted[i - begin] = lists > 1 ? n : 0;
}

// Launch: one work-item per own Gaussian. Brings the sums of the pairs of one that touches more than one band together, by bands from top to bottom.
__kernel void route_sums(ROUTE_ARGUMENTS, RETURN_ARGUMENTS, __global const uint *wanted, // in [end - begin]
                         __global const uint *before,                                    // in [end - begin] exclusive sums of these
                         uint together,                                                  // first slot of all of them
                         __global uint *isect_start,                                     // out [end]
                         __global real *sums) {                                          // in/out [pairs, SUMS] as they came, and together
  const uint i = begin + get_global_id(0);
  if (i >= end || wanted[i - begin] == 0) return;
  const uint2 touched = bands_of(spans[i], bands, ranks);
  const uint at = together + before[i - begin];
  isect_start[i] = at;
  __global real *to = sums + (size_t)at * SUMS;
  for (uint rank = touched.x; rank < touched.y; rank++) {
    if (IS_EMPTY(rank)) continue;
    const uint2 list = returned(rank, i, RETURN_NAMES);
    __global const real *from = sums + (size_t)list.x * SUMS;
    const uint n = list.y * SUMS;
    for (uint k = 0; k < n; k++) to[k] = from[k];
    to += n;
  }
}

// Pairs of a Gaussian that a band got whose sums go back: one for all of them where the band has it whole, which has then been added up as
// project_grad adds pairs, in their order. One at the edge of the band may have pairs elsewhere; one with more than LARGE_PAIRS pairs is
// added up by a group where work-items are many.
static inline uint pairs_back(const uint pairs, uint by, uint from, uint to, uint rows) {
  const int whole = (from == 0 || (uint)BOUND_LO(by) > from * TILE) && (to == rows || (uint)BOUND_HI(by) < to * TILE - 1);
  return whole && (!GROUP_STYLE || pairs <= LARGE_PAIRS) ? min(pairs, 1u) : pairs;
}

// Gaussians that a band got: in [count] records, numbers of pairs; first row of tiles of the band, the one after it, rows of tiles.
#define BAND_ARGUMENTS                                                                                                \
  __global const Projected *records, uint count, uint from, uint to, uint rows, __global const uint *isect_counts

// Launch: one work-item per Gaussian that a band got. Counts the pairs whose sums go back: none of the rank's own.
__kernel void route_lengths(BAND_ARGUMENTS, uint own_first, uint own_end, __global uint *lengths) { // out [count]
  const uint i = get_global_id(0);
  if (i >= count) return;
  uint back = 0;
  if (i < own_first || i >= own_end) back = pairs_back(isect_counts[i], records[i].by, from, to, rows);
  lengths[i] = back;
}

// Launch: one work-item per Gaussian that a band got from `begin` to before `end`. Writes their sums, in the order of the Gaussians.
__kernel void route_return(uint begin, uint end, __global const uint *isect_counts, __global const uint *isect_start, // in [end] pairs, first slot
                           __global const uint *lengths,                     // in [end] pairs whose sums go back
                           __global const uint *row_start,                   // in [end] exclusive sums of the lengths
                           __global const real *sums,                        // in [pairs, SUMS]
                           __global real *ordered) {                         // out [pairs that are written, SUMS]
  const uint i = begin + get_global_id(0);
  if (i >= end) return;
  const uint pairs = isect_counts[i], back = lengths[i];
  __global const real *of = sums + (size_t)isect_start[i] * SUMS;
  __global real *to_row = ordered + (size_t)row_start[i] * SUMS;
  if (back < pairs) {
    real sum[SUMS];
    for (int q = 0; q < SUMS; q++) sum[q] = R(0.0);
    for (uint p = 0; p < pairs; p++)
      for (int q = 0; q < SUMS; q++) sum[q] += of[p * SUMS + q];
    for (int q = 0; q < SUMS; q++) to_row[q] = sum[q];
  } else
    for (uint k = 0; k < pairs * SUMS; k++) to_row[k] = of[k];
}
