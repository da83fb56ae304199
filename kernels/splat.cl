// splat: front-to-back compositing of each tile's Gaussians. One formula for both styles: a work-item per tile with
// blocks of VW pixels in registers (CPUs), or a work-group per tile with a few pixels a work-item (GPUs).
// A pixel takes contributions while its transmittance is >= T_MIN; alpha is capped at ALPHA_MAX and dropped below the
// cut. Longer than a function should be: the compositing loop stays in one piece, in registers. Source: 3DGS; block structure and staging measured on CPUs.
// Images are planar with stride tiles_x*TILE and tiles_y*TILE rows: planes red, green, blue, transmittance.
#include "pixels.clh"

#if !GROUP_STYLE
// Launch: one work-item per tile, local size 1.
__kernel void splat(__global const Projected *records, __global const uint *isect_owner, // in [count], [pairs]
                    __global const uint *order,      // in [pairs] sorted: emission slot of each pair
                    __global const uint *tile_start, // in [tiles + 1]
                    int tiles_x, int tiles, real bg_red, real bg_green, real bg_blue,
                    __global real *image,       // out [4, rows, stride]
                    __global uint *tile_used) { // out [tiles] pairs looked at before every pixel was opaque
  const int tile = get_global_id(0);
  if (tile >= tiles) return;
  const int tile_x = tile % tiles_x * TILE, tile_y = tile / tiles_x * TILE, stride = tiles_x * TILE;
  const uint start = tile_start[tile], end = tile_start[tile + 1];
  const realV lanes = LANES, lane_y = floor(lanes / (real)BLOCK_W), lane_x = lanes - lane_y * (real)BLOCK_W;
  realV px[BLOCKS_X];
  for (int k = 0; k < BLOCKS_X; k++) px[k] = lane_x + (real)(k * BLOCK_W);
  realV T[BLOCKS], red[BLOCKS], green[BLOCKS], blue[BLOCKS];
  for (int k = 0; k < BLOCKS; k++) {
    T[k] = (realV)(R(1.0));
    red[k] = green[k] = blue[k] = (realV)(R(0.0));
  }
  Projected staged[SPLAT_BATCH];
  uint p = start;
  while (p < end) {
    realV most = T[0];
    for (int k = 1; k < BLOCKS; k++) most = max(most, T[k]);
    if (!any_lane(most >= (realV)T_MIN)) break;
    const uint n = min((uint)SPLAT_BATCH, end - p);
    for (uint j = 0; j < n; j++) staged[j] = records[isect_owner[order[p + j]]];
    ask_for_batch(records, isect_owner, order, p + n, end);
    for (uint j = 0; j < n; j++) {
      const Projected *g = &staged[j];
      const real gx = g->x - (real)tile_x - R(0.5), gy = g->y - (real)tile_y - R(0.5);
      int x0, x1, y0, y1;
      block_range(g->bx, tile_x, BLOCK_W, &x0, &x1);
      block_range(g->by, tile_y, BLOCK_H, &y0, &y1);
      for (int by = y0; by <= y1; by++) {
        const realV dy = lane_y + (real)(by * BLOCK_H) - gy, line = fma((realV)(g->r), dy, (realV)(gx));
        for (int bx = x0; bx <= x1; bx++) {
          const int k = by * BLOCKS_X + bx;
          const realV u = px[bx] - line;
          const realV w = weight_of(LOG2_ALPHA(u, dy, (realV)(g->a), (realV)(g->c), (realV)(g->lo)), T[k]);
          red[k] = fma(w, (realV)(g->red), red[k]);
          green[k] = fma(w, (realV)(g->green), green[k]);
          blue[k] = fma(w, (realV)(g->blue), blue[k]);
          T[k] -= w;
        }
      }
    }
    p += n;
  }
  tile_used[tile] = p - start;
  const size_t plane = (size_t)stride * (size_t)(tiles / tiles_x * TILE);
  for (int k = 0; k < BLOCKS; k++) {
    __global real *at =
        image + (size_t)(tile_y + k / BLOCKS_X * BLOCK_H) * stride + (tile_x + k % BLOCKS_X * BLOCK_W);
    store_block(fma(T[k], (realV)(bg_red), red[k]), at, stride);
    store_block(fma(T[k], (realV)(bg_green), green[k]), at + plane, stride);
    store_block(fma(T[k], (realV)(bg_blue), blue[k]), at + 2 * plane, stride);
    store_block(T[k], at + 3 * plane, stride);
  }
}
#else
// Pixels of a work-item, those of its column every ROW_STEP rows: records are read once for all of them.
#define PIXELS (TILE * TILE / SPLAT_GROUP)
#define ROW_STEP (SPLAT_GROUP / TILE)

// Launch: one work-group of SPLAT_GROUP work-items per tile. Before every GRAD_SEGMENT-th pair of a tile but the first, colours and
// transmittance are kept, so that splat_grad can begin there: no other tile keeps any with the same number.
__kernel __attribute__((reqd_work_group_size(SPLAT_GROUP, 1, 1))) void
splat(__global const Projected *records, __global const uint *isect_owner, // in [count], [pairs]
      __global const uint *order,      // in [pairs] sorted: emission slot of each pair
      __global const uint *tile_start, // in [tiles + 1]
      int tiles_x, int tiles, int height, real bg_red, real bg_green, real bg_blue,
      __global real *image,       // out [4, rows, stride]
      __global uint *tile_used,   // out [tiles] pairs looked at before every pixel was opaque
      int keeps, __global real *snapshots) { // out [pairs / GRAD_SEGMENT, 4, TILE * TILE] where `keeps` is on
  const int tile = get_global_id(0) / SPLAT_GROUP, l = get_local_id(0);
  const int tile_x = tile % tiles_x * TILE, tile_y = tile / tiles_x * TILE, stride = tiles_x * TILE;
  const int x = l % TILE, y = l / TILE;
  const uint start = tile_start[tile], end = tile_start[tile + 1];
  real T[PIXELS], red[PIXELS], green[PIXELS], blue[PIXELS];
#pragma unroll
  for (int k = 0; k < PIXELS; k++) {
    T[k] = R(1.0);
    red[k] = green[k] = blue[k] = R(0.0);
  }
  __local Projected staged[SPLAT_BATCH];
  __local int open;
  uint p = start;
  for (;;) {
    barrier(CLK_LOCAL_MEM_FENCE);
    if (l == 0) open = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    int opaque = 1;
#pragma unroll
    for (int k = 0; k < PIXELS; k++) opaque &= T[k] < (real)T_MIN || tile_y + y + k * ROW_STEP >= height;
    if (!opaque) open = 1; // every writer writes the same value
    const uint n = min((uint)SPLAT_BATCH, end - p);
    if ((uint)l < n) staged[l] = records[isect_owner[order[p + l]]];
    barrier(CLK_LOCAL_MEM_FENCE);
    if (n == 0 || !open) break;
    if (keeps && p > start && (p - start) % GRAD_SEGMENT == 0) {
      __global real *at = snapshots + (size_t)(p / GRAD_SEGMENT) * 4 * (TILE * TILE) + l;
#pragma unroll
      for (int k = 0; k < PIXELS; k++, at += SPLAT_GROUP) {
        at[0] = red[k];
        at[TILE * TILE] = green[k];
        at[2 * TILE * TILE] = blue[k];
        at[3 * TILE * TILE] = T[k];
      }
    }
    for (uint j = 0; j < n; j++) {
      const Projected g = staged[j];
      const real gx = g.x - (real)tile_x - R(0.5), gy = g.y - (real)tile_y - R(0.5);
#pragma unroll
      for (int k = 0; k < PIXELS; k++)
        if (reaches(g.by, tile_y + y + k * ROW_STEP)) {
          const real dy = (real)(y + k * ROW_STEP) - gy, u = (real)x - fma(g.r, dy, gx);
          const real w = weight_of(LOG2_ALPHA(u, dy, g.a, g.c, g.lo), T[k]);
          red[k] = fma(w, g.red, red[k]);
          green[k] = fma(w, g.green, green[k]);
          blue[k] = fma(w, g.blue, blue[k]);
          T[k] -= w;
        }
    }
    p += n;
  }
  if (l == 0) tile_used[tile] = p - start;
  const size_t plane = (size_t)stride * (size_t)(tiles / tiles_x * TILE);
#pragma unroll
  for (int k = 0; k < PIXELS; k++) {
    const size_t at = (size_t)(tile_y + y + k * ROW_STEP) * stride + (tile_x + x);
    image[at] = fma(T[k], bg_red, red[k]);
    image[plane + at] = fma(T[k], bg_green, green[k]);
    image[2 * plane + at] = fma(T[k], bg_blue, blue[k]);
    image[3 * plane + at] = T[k];
  }
}
#endif
