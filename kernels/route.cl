// route: where several ranks train one scene, the visible Gaussians of one of them -> the bands of tile rows that they touch, one band a
// rank; and the sums of their pairs there -> one list for each Gaussian, by bands from top to bottom, which is the order of its pairs
// where one rank has them all. A Gaussian that a band gets is cut to the rows of the band, so that its pairs there are those of these
// rows. Launches are over chunks of Gaussians, or Gaussians. Source: the division of Gaussians and pixels among devices of Grendel-GS,
// Zhao et al. 2024.

// True if a Gaussian touches the rows of tiles from `from` to before `to`.
static inline int touches_band(uint key, uint by, uint from, uint to) {
  return key != KEY_CULLED && from < to && (uint)BOUND_HI(by) / TILE >= from && (uint)BOUND_LO(by) / TILE < to;
}

// Own Gaussians: in [count] records and depth bits or KEY_CULLED; bands in [ranks + 1] first row of tiles of each.
#define ROUTE_ARGUMENTS __global const Projected *records, __global const uint *keys, uint count, __global const uint *bands

// Launch: over chunks of Gaussians (first axis) and ranks (second). Counts those that touch a rank's band.
CHUNK_KERNEL void route_count(ROUTE_ARGUMENTS, uint chunks, __global uint *sums) { // out [ranks, chunks]
  SCRATCH;
  const uint c = CHUNK, rank = get_global_id(1);
  if (c >= chunks) return;
  const uint size = chunk_size(count, chunks), first = min(c * size, count), last = min(first + size, count);
  const uint from = bands[rank], to = bands[rank + 1];
  uint n = 0;
  for (uint i = first + ITEM; i < last; i += GROUP) n += touches_band(keys[i], records[i].by, from, to);
  n = (uint)group_sum(n, scratch);
  if (ITEM == 0) sums[rank * chunks + c] = n;
}

// Launch: as route_count. Writes what each rank gets, in the order of the Gaussians, and its number.
CHUNK_KERNEL void route_pack(ROUTE_ARGUMENTS, uint chunks, __global const uint *sums, // in [ranks, chunks]
                             uint stride, __global uint *sent_keys,                   // out [ranks, stride]
                             __global Projected *sent,                                // out [ranks, stride], cut to the band
                             __global uint *place,                                    // out [ranks, stride] number among those sent
                             __global uint *totals) {                                 // out [ranks]
  SCRATCH;
  const uint c = CHUNK, rank = get_global_id(1);
  if (c >= chunks) return;
  const uint size = chunk_size(count, chunks), first = min(c * size, count), last = min(first + size, count);
  const uint from = bands[rank], to = bands[rank + 1];
  __global const uint *of = sums + rank * chunks;
  const size_t own = (size_t)rank * stride;
  uint before = (uint)group_sum(sum_before(of, c), scratch);
  // Before the loop: what stands after one that holds barriers and has no turn, PoCL 3.1 leaves out.
  if (c == chunks - 1 && ITEM == 0) totals[rank] = before + of[c];
  for (uint block = first; block < last; block += GROUP) {
    const uint i = block + ITEM;
    const int touches = i < last && touches_band(keys[i], records[i].by, from, to);
    uint total;
    const uint at = before + group_scan(touches, scratch, &total);
    if (touches) {
      Projected cut = records[i];
      cut.by = max((uint)BOUND_LO(cut.by), from * TILE) | min((uint)BOUND_HI(cut.by), to * TILE - 1) << 16;
      sent_keys[own + at] = keys[i];
      sent[own + at] = cut;
      place[own + i] = at;
    }
    before += total;
  }
}

// First slots of what was sent to each rank, as it came back: in [number sent + 1] from offsets[rank] on. A Gaussian's pairs there:
#define RETURN_ARGUMENTS uint ranks, uint stride, __global const uint *place, __global const uint *starts, __global const uint *offsets
#define RETURNED(rank) (starts + offsets[rank] + place[(size_t)(rank) * stride + i])

// Launch: one work-item per Gaussian. Adds up the numbers of its pairs in all bands.
__kernel void route_pairs(ROUTE_ARGUMENTS, RETURN_ARGUMENTS, __global uint *isect_counts) { // out [count]
  const uint i = get_global_id(0);
  if (i >= count) return;
  const uint key = keys[i], by = records[i].by;
  uint n = 0;
  for (uint rank = 0; rank < ranks; rank++)
    if (touches_band(key, by, bands[rank], bands[rank + 1])) {
      __global const uint *slot = RETURNED(rank);
      n += slot[1] - slot[0];
    }
  isect_counts[i] = n;
}

// Launch: one work-item per Gaussian. Brings the sums of its pairs together, by bands from top to bottom.
__kernel void route_sums(ROUTE_ARGUMENTS, RETURN_ARGUMENTS, __global const real *returned, // in [pairs, SUMS] of all ranks
                         __global const uint *isect_start,                                 // in [count]
                         __global real *sums) {                                            // out [pairs, SUMS]
  const uint i = get_global_id(0);
  if (i >= count) return;
  const uint key = keys[i], by = records[i].by;
  __global real *to = sums + (size_t)isect_start[i] * SUMS;
  for (uint rank = 0; rank < ranks; rank++)
    if (touches_band(key, by, bands[rank], bands[rank + 1])) {
      __global const uint *slot = RETURNED(rank);
      __global const real *from = returned + (size_t)slot[0] * SUMS;
      const uint n = (slot[1] - slot[0]) * SUMS;
      for (uint k = 0; k < n; k++) to[k] = from[k];
      to += n;
    }
}

// Launch: one work-item per Gaussian that a band got. Puts the sums of its pairs in the order of the Gaussians, where pairs have theirs by
// depth.
__kernel void route_order(uint count, __global const uint *isect_start, // in [count] first slot by depth
                          __global const uint *isect_counts,            // in [count]
                          __global const uint *row_start,               // in [count] exclusive sums of isect_counts
                          __global const real *sums,                    // in [pairs, SUMS]
                          __global real *ordered) {                     // out [pairs, SUMS]
  const uint i = get_global_id(0);
  if (i >= count) return;
  __global const real *from = sums + (size_t)isect_start[i] * SUMS;
  __global real *to = ordered + (size_t)row_start[i] * SUMS;
  for (uint k = 0; k < isect_counts[i] * SUMS; k++) to[k] = from[k];
}
