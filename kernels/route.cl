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

// Pixel rows of a Gaussian in a band that it touches, packed as they are in its record.
static inline uint cut_to_band(uint by, uint from, uint to) {
  return max((uint)BOUND_LO(by), from * TILE) | min((uint)BOUND_HI(by), to * TILE - 1) << 16;
}

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
      cut.by = cut_to_band(cut.by, from, to);
      sent_keys[(size_t)to_rank + at] = keys[i];
      sent[(size_t)to_rank + at] = cut;
      place[own + i] = at;
    }
    before += total;
  }
}

// Launch: one work-item per own Gaussian, when others have got what they get. Leaves what is of the rank's own band in the view, which is that of the
// band: Gaussians elsewhere pass for culled ones there, and those that it cuts end at its edges.
__kernel void route_stay(ROUTE_ARGUMENTS, uint own,               // number of the rank
                         __global Projected *records,             // in/out [end]
                         __global uint *keys,                     // in/out [end]
                         __global uint *isect_counts) {           // in/out [end] rows of tiles, none of Gaussians elsewhere
  const uint i = begin + get_global_id(0);
  if (i >= end) return;
  const uint span = spans[i], from = bands[own], to = bands[own + 1];
  if (!touches_band(span, from, to)) {
    keys[i] = KEY_CULLED;
    isect_counts[i] = 0;
  } else if (FIRST_ROW(span) < from || END_ROW(span) > to)
    records[i].by = cut_to_band(records[i].by, from, to);
}

// First slots of what was sent to each other rank, as that rank counts them: in [number sent + 1] from offsets[rank] on; the slot here is
// shifts[rank] more, modulo 2^32.
#define RETURN_ARGUMENTS                                                                                                       \
  uint ranks, uint own, uint stride, __global const uint *place, __global const uint *starts, __global const uint *offsets,    \
      __global const uint *shifts
#define RETURN_NAMES ranks, own, stride, place, starts, offsets, shifts

// First slot of the sums of a Gaussian's pairs in a band of another rank that it touches, and their number.
static inline uint2 returned(uint rank, uint i, RETURN_ARGUMENTS) {
  __global const uint *slot = starts + offsets[rank] + place[(size_t)rank * stride + i];
  return (uint2)(slot[0] + shifts[rank], slot[1] - slot[0]);
}

// Launch: one work-item per own Gaussian. Adds its pairs in other bands to those in the own one and, where it touches one band, writes the first
// slot of their sums; where it touches more, it wants a place for all of them together, of this length.
__kernel void route_pairs(ROUTE_ARGUMENTS, RETURN_ARGUMENTS, __global uint *isect_counts, // in/out [end]
                          __global uint *isect_start,                                     // in/out [end]
                          __global uint *wanted) {                                        // out [end - begin]
  const uint i = begin + get_global_id(0);
  if (i >= end) return;
  const uint2 touched = bands_of(spans[i], bands, ranks);
  uint lists = 0, length = 0;
  if (touched.x < touched.y && (touched.x != own || touched.y != own + 1)) {
    uint n = isect_counts[i], only = isect_start[i];
    for (uint rank = touched.x; rank < touched.y; rank++) {
      if (IS_EMPTY(rank)) continue;
      lists++;
      if (rank == own) continue;
      const uint2 list = returned(rank, i, RETURN_NAMES);
      n += list.y;
      only = list.x;
    }
    isect_counts[i] = n;
    if (lists > 1) length = n;
    else isect_start[i] = only;
  }
  wanted[i - begin] = length;
}

// Launch: one work-item per own Gaussian. Brings the sums of the pairs of one that touches more than one band together, by bands from top to bottom.
__kernel void route_sums(ROUTE_ARGUMENTS, RETURN_ARGUMENTS, __global const uint *wanted, // in [end - begin]
                         __global const uint *before,                                    // in [end - begin] exclusive sums of these
                         uint together,                                                  // first slot of all of them
                         __global uint *isect_start,                                     // in/out [end]
                         __global real *sums) {                                          // in/out [pairs, SUMS] as they came, and together
  const uint i = begin + get_global_id(0);
  if (i >= end || wanted[i - begin] == 0) return;
  const uint2 touched = bands_of(spans[i], bands, ranks);
  const uint at = together + before[i - begin], at_own = isect_start[i];
  uint in_own = wanted[i - begin];
  for (uint rank = touched.x; rank < touched.y; rank++)
    if (rank != own && !IS_EMPTY(rank)) in_own -= returned(rank, i, RETURN_NAMES).y;
  isect_start[i] = at;
  __global real *to = sums + (size_t)at * SUMS;
  for (uint rank = touched.x; rank < touched.y; rank++) {
    if (IS_EMPTY(rank)) continue;
    const uint2 list = rank == own ? (uint2)(at_own, in_own) : returned(rank, i, RETURN_NAMES);
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

// Other ranks' Gaussians that a band got, which lie from `begin` to before `end` in its view: in [end] numbers of pairs.
#define OTHERS_ARGUMENTS uint begin, uint end, __global const uint *isect_counts

// Launch: one work-item per Gaussian of other ranks. Counts the pairs whose sums go back.
__kernel void route_lengths(OTHERS_ARGUMENTS, __global const Projected *records, // in [end]
                            uint from, uint to, uint rows,                       // rows of tiles: the band's first, the one after it, all
                            __global uint *lengths) {                            // out [end - begin]
  const uint k = get_global_id(0), i = begin + k;
  if (i >= end) return;
  lengths[k] = pairs_back(isect_counts[i], records[i].by, from, to, rows);
}

// Launch: one work-item per Gaussian of other ranks. Writes their sums, in the order of the Gaussians.
__kernel void route_return(OTHERS_ARGUMENTS, __global const uint *isect_start, // in [end] first slot
                           __global const uint *lengths,                       // in [end - begin] pairs whose sums go back
                           __global const uint *row_start,                     // in [end - begin] exclusive sums of the lengths
                           __global const real *sums,                          // in [pairs, SUMS]
                           __global real *ordered) {                           // out [pairs that are written, SUMS]
  const uint k = get_global_id(0), i = begin + k;
  if (i >= end) return;
  const uint pairs = isect_counts[i], back = lengths[k];
  __global const real *of = sums + (size_t)isect_start[i] * SUMS;
  __global real *to_row = ordered + (size_t)row_start[k] * SUMS;
  if (back < pairs) {
    real sum[SUMS];
    for (int q = 0; q < SUMS; q++) sum[q] = R(0.0);
    for (uint p = 0; p < pairs; p++)
      for (int q = 0; q < SUMS; q++) sum[q] += of[p * SUMS + q];
    for (int q = 0; q < SUMS; q++) to_row[q] = sum[q];
  } else
    for (uint q = 0; q < pairs * SUMS; q++) to_row[q] = of[q];
}
