// seen: which Gaussians a view shows, where a pixel adds alpha T > 0 of their colour. Only tiles with a Gaussian that no view
// before has shown are composited, without colours, and no further than the last of these; the decisions are splat's,
// to the bit. Source: compositing as in splat.cl.
#include "pixels.clh"

// Launch: as splat. Writes `shown` at the emission slots of the pairs whose Gaussian was not seen before.
#if !GROUP_STYLE
__kernel void seen_pairs(__global const Projected *records, __global const uint *isect_owner, // in [count], [pairs]
                         __global const uint *order,                       // in [pairs] sorted: emission slot of each pair
                         __global const uint *tile_start,                  // in [tiles + 1]
                         int tiles_x, int tiles, int width, int height,    // pixels of the image
                         __global const uint *seen,                        // in [count] 1: by a view before
                         __global uchar *shown) {                          // out [pairs]
  const int tile = get_global_id(0);
  if (tile >= tiles) return;
  const int tile_x = tile % tiles_x * TILE, tile_y = tile / tiles_x * TILE;
  const uint start = tile_start[tile], end = tile_start[tile + 1];
  uint last = start;
  for (uint p = start; p < end; p++) {
    const uint slot = order[p];
    if (seen[isect_owner[slot]]) continue;
    shown[slot] = 0;
    last = p + 1;
  }
  if (last == start) return;
  const realV lanes = LANES, lane_y = floor(lanes / (real)BLOCK_W), lane_x = lanes - lane_y * (real)BLOCK_W;
  const realV zero = (realV)(R(0.0)), one = (realV)(R(1.0));
  const realV right = (realV)((real)(width - tile_x)), below = (realV)((real)(height - tile_y));
  realV px[BLOCKS_X], T[BLOCKS];
  for (int k = 0; k < BLOCKS_X; k++) px[k] = lane_x + (real)(k * BLOCK_W);
  for (int k = 0; k < BLOCKS; k++) {
    const realV y = lane_y + (real)(k / BLOCKS_X * BLOCK_H);
    T[k] = choose((px[k % BLOCKS_X] < right) & (y < below), one, zero); // what is opaque shows nothing
  }
  Projected staged[SPLAT_BATCH];
  for (uint p = start; p < last; p += SPLAT_BATCH) {
    realV most = T[0];
    for (int k = 1; k < BLOCKS; k++) most = max(most, T[k]);
    if (!any_lane(most >= (realV)T_MIN)) break;
    const uint n = min((uint)SPLAT_BATCH, last - p);
    for (uint j = 0; j < n; j++) staged[j] = records[isect_owner[order[p + j]]];
    ask_for_batch(records, isect_owner, order, p + n, last);
    for (uint j = 0; j < n; j++) {
      const Projected *g = &staged[j];
      const real gx = g->x - (real)tile_x - R(0.5), gy = g->y - (real)tile_y - R(0.5);
      int x0, x1, y0, y1;
      block_range(g->bx, tile_x, BLOCK_W, &x0, &x1);
      block_range(g->by, tile_y, BLOCK_H, &y0, &y1);
      realV sum = zero;
      for (int by = y0; by <= y1; by++) {
        const realV dy = lane_y + (real)(by * BLOCK_H) - gy, line = fma((realV)(g->r), dy, (realV)(gx));
        for (int bx = x0; bx <= x1; bx++) {
          const int k = by * BLOCKS_X + bx;
          const realV u = px[bx] - line;
          const realV w = weight_of(LOG2_ALPHA(u, dy, (realV)(g->a), (realV)(g->c), (realV)(g->lo)), T[k]);
          T[k] -= w;
          sum += w;
        }
      }
      if (any_lane(sum > zero)) shown[order[p + j]] = 1;
    }
  }
}
#else
__kernel __attribute__((reqd_work_group_size(TILE * TILE, 1, 1))) void
seen_pairs(__global const Projected *records, __global const uint *isect_owner, // in [count], [pairs]
           __global const uint *order,                    // in [pairs] sorted: emission slot of each pair
           __global const uint *tile_start,               // in [tiles + 1]
           int tiles_x, int tiles, int width, int height, // pixels of the image
           __global const uint *seen,                     // in [count] 1: by a view before
           __global uchar *shown) {                       // out [pairs]
  const int tile = get_global_id(0) / (TILE * TILE), l = get_local_id(0);
  const int tile_x = tile % tiles_x * TILE, tile_y = tile / tiles_x * TILE;
  const int x = l % TILE, y = l / TILE;
  const uint start = tile_start[tile], end = tile_start[tile + 1];
  __local Projected staged[SPLAT_BATCH];
  __local uint hit[SPLAT_BATCH];
  __local uint last;
  __local int open;
  if (l == 0) last = start;
  barrier(CLK_LOCAL_MEM_FENCE);
  for (uint p = start + l; p < end; p += TILE * TILE) {
    const uint slot = order[p];
    if (seen[isect_owner[slot]]) continue;
    shown[slot] = 0;
    atomic_max(&last, p + 1); // of integers: the same in any order
  }
  barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
  const uint stop = last;
  real T = tile_x + x < width && tile_y + y < height ? R(1.0) : R(0.0); // what is opaque shows nothing
  for (uint p = start; p < stop; p += SPLAT_BATCH) {
    if (l == 0) open = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (T >= (real)T_MIN) open = 1; // every writer writes the same value
    const uint n = min((uint)SPLAT_BATCH, stop - p);
    if ((uint)l < n) {
      staged[l] = records[isect_owner[order[p + l]]];
      hit[l] = 0;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (!open) break;
    for (uint j = 0; j < n; j++) {
      const Projected g = staged[j];
      if (!reaches(g.by, tile_y + y)) continue;
      const real gx = g.x - (real)tile_x - R(0.5), gy = g.y - (real)tile_y - R(0.5);
      const real dy = (real)y - gy, u = (real)x - fma(g.r, dy, gx);
      const real w = weight_of(LOG2_ALPHA(u, dy, g.a, g.c, g.lo), T);
      T -= w;
      if (w > R(0.0)) hit[j] = 1; // every writer writes the same value
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if ((uint)l < n && hit[l]) shown[order[p + l]] = 1;
  }
}
#endif

// Launch: one work-item per Gaussian, after seen_pairs of each view.
__kernel void seen_gather(uint count, __global const uint *isect_start, // in [count] first emission slot
                          __global const uint *isect_counts,            // in [count]
                          __global const uchar *shown,                 // in [pairs]
                          __global uint *seen) {                       // in/out [count] 1: by some view
  const uint i = get_global_id(0);
  if (i >= count || seen[i]) return;
  const uint first = isect_start[i], pairs = isect_counts[i];
  for (uint p = 0; p < pairs; p++)
    if (shown[first + p]) seen[i] = 1;
}
