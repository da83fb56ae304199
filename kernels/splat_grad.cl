// splat_grad: derivative of the compositing, front to back over the same pairs with the same formula. Per (tile,
// Gaussian) pair it writes nine sums at the pair's emission slot; project_grad adds a Gaussian's slots up, so no atomics
// and a fixed order. With g = dL/dalpha * alpha (0 where alpha is capped):
//   0 sum g, 1 sum g u, 2 sum g dy, 3 sum g u^2, 4 sum g u dy, 5 sum g dy^2, 6..8 sum alpha T dL/dcolour
// (u, dy are the coordinates in which the record's quadratic form is diagonal: no cancellation for needles).
// g = alpha T <dL/dC, c> - behind alpha / (1 - alpha), behind = <dL/dC, what is composited after>, kept by subtraction from
// the final colour (1 - alpha >= 1 - ALPHA_MAX). Source: 3DGS backward; front to back as in Faster-GS.
#include "pixels.clh"

// The first sum's term of each pixel of a block. Adds those of s[3] and of the colours; d*: dL/dC, T and behind are advanced.
static inline realV grad_block(const Projected *g, realV u, realV dy, realV dred, realV dgreen, realV dblue, realV *T,
                               realV *behind, realV s[SUMS]) {
  const realV log2_alpha = LOG2_ALPHA(u, dy, (realV)(g->a), (realV)(g->c), (realV)(g->lo));
  const realV free_alpha = exp2_negative(log2_alpha), alpha = min(free_alpha, (realV)ALPHA_MAX);
  const maskV takes = contributes(log2_alpha, *T);
  const realV w = choose(takes, alpha * *T, (realV)(R(0.0))); // the bits of weight_of()
  const realV along = fma(dred, (realV)(g->red), fma(dgreen, (realV)(g->green), dblue * (realV)(g->blue)));
  const realV own = w * along, odds = alpha / ((realV)(R(1.0)) - alpha);
  *behind -= own;
  *T -= w;
  const realV gr = choose(takes & (free_alpha < (realV)ALPHA_MAX), fma(-*behind, odds, own), (realV)(R(0.0)));
  s[3] = fma(gr * u, u, s[3]);
  s[6] = fma(w, dred, s[6]);
  s[7] = fma(w, dgreen, s[7]);
  s[8] = fma(w, dblue, s[8]);
  return gr;
}

// Adds the other sums of pixels with one dy, from their sums of g and g u.
static inline void grad_row(realV g, realV gu, realV dy, realV s[SUMS]) {
  const realV gy = g * dy;
  s[0] += g;
  s[1] += gu;
  s[2] += gy;
  s[4] = fma(gu, dy, s[4]);
  s[5] = fma(gy, dy, s[5]);
}

#if !GROUP_STYLE
// Sums of neighbouring lanes of a and b, in turn two of a and two of b, and of neighbouring groups of four lanes, half of them of a before those
// of b. Each takes two shuffles that a processor has; composed vectors take many.
#if VW == 4
#define ADD_LANES(a, b) (__builtin_shufflevector(a, b, 0, 2, 4, 6) + __builtin_shufflevector(a, b, 1, 3, 5, 7))
#elif VW == 8
#define ADD_LANES(a, b)                                     \
  (__builtin_shufflevector(a, b, 0, 2, 8, 10, 4, 6, 12, 14) + \
   __builtin_shufflevector(a, b, 1, 3, 9, 11, 5, 7, 13, 15))
#define ADD_QUARTERS(a, b)                                  \
  (__builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11) +  \
   __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15))
#elif VW == 16
#define ADD_LANES(a, b)                                                                             \
  (__builtin_shufflevector(a, b, 0, 2, 16, 18, 4, 6, 20, 22, 8, 10, 24, 26, 12, 14, 28, 30) +         \
   __builtin_shufflevector(a, b, 1, 3, 17, 19, 5, 7, 21, 23, 9, 11, 25, 27, 13, 15, 29, 31))
#define ADD_QUARTERS(a, b)                                                                          \
  (__builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27) +          \
   __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31))
#endif

// Sums over the lanes of each of the vectors s, written to `out`. Every round adds neighbours of two vectors into one, first lanes, then
// groups of four, so that SUMS sums cost about SUMS additions of vectors instead of SUMS times log2(VW) of shrinking ones.
static inline void lane_sums(const realV s[SUMS], __global real *out) {
#if VW == 1
  for (int q = 0; q < SUMS; q++) out[q] = s[q];
#else
  const realV low = ADD_LANES(ADD_LANES(s[0], s[1]), ADD_LANES(s[2], s[3]));
  const realV high = ADD_LANES(ADD_LANES(s[4], s[5]), ADD_LANES(s[6], s[7]));
  const realV two = ADD_LANES(s[8], s[8]), ninth = ADD_LANES(two, two);
#if VW == 4
  vstore4(low, 0, out);
  vstore4(high, 1, out);
  out[8] = ninth.s0;
#elif VW == 8
  vstore8(ADD_QUARTERS(low, high), 0, out);
  out[8] = ninth.s0 + ninth.s4;
#else
  const realV eight = ADD_QUARTERS(low, high), one = ADD_QUARTERS(ninth, ninth), all = ADD_QUARTERS(eight, one);
  vstore8(all.lo, 0, out);
  out[8] = all.s8;
#endif
#endif
}

// Launch: one work-item per tile, local size 1.
__kernel void splat_grad(__global const Projected *records, __global const uint *isect_owner, // in [count], [pairs]
                         __global const uint *order, __global const uint *tile_start, // in [pairs], [tiles + 1]
                         __global const uint *tile_used, int tiles_x, int tiles,      // in [tiles]
                         __global const real *image,  // in [4, rows, stride] as splat left it
                         __global const real *dimage, // in [3, rows, stride] dL/dC, 0 outside of the image
                         __global real *sums) {       // out [pairs, SUMS] at emission slots
  const int tile = get_global_id(0);
  if (tile >= tiles) return;
  const int tile_x = tile % tiles_x * TILE, tile_y = tile / tiles_x * TILE, stride = tiles_x * TILE;
  const size_t plane = (size_t)stride * (size_t)(tiles / tiles_x * TILE);
  const uint start = tile_start[tile], end = tile_start[tile + 1], used = start + tile_used[tile];
  const realV lanes = LANES, lane_y = floor(lanes / (real)BLOCK_W), lane_x = lanes - lane_y * (real)BLOCK_W;
  realV px[BLOCKS_X];
  for (int k = 0; k < BLOCKS_X; k++) px[k] = lane_x + (real)(k * BLOCK_W);
  realV T[BLOCKS], behind[BLOCKS], dred[BLOCKS], dgreen[BLOCKS], dblue[BLOCKS];
  for (int k = 0; k < BLOCKS; k++) {
    T[k] = (realV)(R(1.0));
    const size_t at = (size_t)(tile_y + k / BLOCKS_X * BLOCK_H) * stride + (tile_x + k % BLOCKS_X * BLOCK_W);
    dred[k] = load_block(dimage + at, stride);
    dgreen[k] = load_block(dimage + plane + at, stride);
    dblue[k] = load_block(dimage + 2 * plane + at, stride);
    behind[k] = dred[k] * load_block(image + at, stride) + dgreen[k] * load_block(image + plane + at, stride) +
                dblue[k] * load_block(image + 2 * plane + at, stride);
  }
  Projected staged[SPLAT_BATCH];
  uint slot[SPLAT_BATCH];
  for (uint p = start; p < used; p += SPLAT_BATCH) {
    const uint n = min((uint)SPLAT_BATCH, used - p);
    for (uint j = 0; j < n; j++) {
      slot[j] = order[p + j];
      staged[j] = records[isect_owner[slot[j]]];
      __global const real *to = sums + (size_t)slot[j] * SUMS; // in two lines at most
      ASK_FOR_TO_WRITE(to);
      ASK_FOR_TO_WRITE(to + SUMS - 1);
    }
    ask_for_batch(records, isect_owner, order, p + n, used);
    for (uint j = 0; j < n; j++) {
      const Projected *g = &staged[j];
      const real gx = g->x - (real)tile_x - R(0.5), gy = g->y - (real)tile_y - R(0.5);
      int x0, x1, y0, y1;
      block_range(g->bx, tile_x, BLOCK_W, &x0, &x1);
      block_range(g->by, tile_y, BLOCK_H, &y0, &y1);
      realV s[SUMS];
#pragma unroll
      for (int q = 0; q < SUMS; q++) s[q] = (realV)(R(0.0));
      for (int by = y0; by <= y1; by++) {
        const realV dy = lane_y + (real)(by * BLOCK_H) - gy, line = fma((realV)(g->r), dy, (realV)(gx));
        realV row = (realV)(R(0.0)), row_u = (realV)(R(0.0));
        for (int bx = x0; bx <= x1; bx++) {
          const int k = by * BLOCKS_X + bx;
          const realV u = px[bx] - line;
          const realV gr = grad_block(g, u, dy, dred[k], dgreen[k], dblue[k], &T[k], &behind[k], s);
          row += gr;
          row_u = fma(gr, u, row_u);
        }
        grad_row(row, row_u, dy, s);
      }
      lane_sums(s, sums + (size_t)slot[j] * SUMS);
    }
  }
  for (uint p = used; p < end; p++)
    for (int q = 0; q < SUMS; q++) sums[(size_t)order[p] * SUMS + q] = R(0.0);
}
#else
// Pixels of a work-item, those of its column every ROW_STEP rows. Work-items that run together, on many GPUs 32, have blocks of 8 x 4
// pixels: fewer Gaussians reach one of those than two whole rows of a tile.
#define PIXELS (TILE * TILE / GRAD_GROUP)
#define ROW_STEP (GRAD_GROUP / TILE)
#define BLOCK_X (get_local_id(0) % 8 + get_local_id(0) / 32 % 2 * 8)
#define BLOCK_Y (get_local_id(0) / 8 % 4 + get_local_id(0) / 64 * 4)
// True inside of pixel bounds and next to them: splat, in the group style, leaves out rows beyond them and no columns, so that one at the
// bounds' very edge may take a contribution.
static inline int beside(uint bounds, int pixel) {
  return pixel + 1 >= (int)BOUND_LO(bounds) && pixel <= (int)BOUND_HI(bounds) + 1;
}

// Launch: `runs` work-groups of GRAD_GROUP work-items, one per GRAD_SEGMENT pairs that there is room for, then one per tile from
// `first_tile` on. A tile's pairs are cut into segments of GRAD_SEGMENT, from the first one on: its own group takes the first segment, and
// of those that begin among the pairs of a run, where there is one at most, the run's group. So no tile, however many Gaussians it has, keeps
// a group longer than others, and the segments are the same however tiles are shared out. A work-item adds up its pixels in registers,
// then every GRAD_SUMS pairs one work-item adds up each of their sums: a fixed order, no assumption on sub-groups. Rows of local
// memory are padded by four numbers, so that the work-items that read them side by side do so from different banks.
__kernel __attribute__((reqd_work_group_size(GRAD_GROUP, 1, 1))) void
splat_grad(__global const Projected *records, __global const uint *isect_owner, // in [count], [pairs]
           __global const uint *order, __global const uint *tile_start,     // in [pairs], [tiles + 1]
           __global const uint *tile_used, int tiles_x, int tiles,          // in [tiles]
           __global const real *image,  // in [4, rows, stride] as splat left it
           __global const real *dimage, // in [3, rows, stride] dL/dC, 0 outside of the image
           uint runs, uint first_tile, __global const uint *status, // in S_INTERSECTIONS
           __global const uint *tile_of,   // in [pairs] tiles in ascending order
           __global const real *snapshots, // in [pairs / GRAD_SEGMENT, 4, TILE * TILE] as splat left them
           __global real *sums) {       // out [pairs, SUMS] at emission slots
  const int l = get_local_id(0), x = BLOCK_X, y = BLOCK_Y, stride = tiles_x * TILE;
  const size_t plane = (size_t)stride * (size_t)(tiles / tiles_x * TILE);
  const uint group = get_group_id(0), first_pair = group * GRAD_SEGMENT, pairs = status[S_INTERSECTIONS];
  const int own = group >= runs, listed = own || first_pair < pairs;
  const uint tile = own ? first_tile + group - runs : listed ? tile_of[first_pair] : 0;
  const uint start = tile_start[tile], end = tile_start[tile + 1], used = start + tile_used[tile];
  uint p = own ? start : start + (first_pair - start + GRAD_SEGMENT - 1) / GRAD_SEGMENT * GRAD_SEGMENT; // next pair
  const int begins = own || (listed && p > start && p < min(first_pair + GRAD_SEGMENT, end));
  const uint all = begins ? min(p + GRAD_SEGMENT, end) : p, last = max(p, min(all, used));
  for (uint unused = last + l; unused < all; unused += GRAD_GROUP)
    for (int q = 0; q < SUMS; q++) sums[(size_t)order[unused] * SUMS + q] = R(0.0);
  const int tile_x = tile % tiles_x * TILE, tile_y = tile / tiles_x * TILE;
  real T[PIXELS], behind[PIXELS], dred[PIXELS], dgreen[PIXELS], dblue[PIXELS];
  if (p < last) {
    __global const real *before = snapshots + (size_t)(p / GRAD_SEGMENT) * 4 * (TILE * TILE) + y * TILE + x;
#pragma unroll
    for (int k = 0; k < PIXELS; k++, before += ROW_STEP * TILE) {
      const size_t at = (size_t)(tile_y + y + k * ROW_STEP) * stride + (tile_x + x);
      real red = image[at], green = image[plane + at], blue = image[2 * plane + at];
      T[k] = R(1.0);
      if (p > start) {
        red -= before[0];
        green -= before[TILE * TILE];
        blue -= before[2 * TILE * TILE];
        T[k] = before[3 * TILE * TILE];
      }
      dred[k] = dimage[at];
      dgreen[k] = dimage[plane + at];
      dblue[k] = dimage[2 * plane + at];
      behind[k] = dred[k] * red + dgreen[k] * green + dblue[k] * blue;
    }
  }
  __local Projected staged[SPLAT_BATCH];
  __local uint slot[SPLAT_BATCH];
  __local real4 part[GRAD_SUMS][SUMS][GRAD_GROUP / 4 + 1];
  while (p < last) {
    const uint n = min((uint)SPLAT_BATCH, last - p);
    if ((uint)l < n) {
      slot[l] = order[p + l];
      staged[l] = records[isect_owner[slot[l]]];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint first = 0; first < n; first += GRAD_SUMS) {
      const uint count = min((uint)GRAD_SUMS, n - first);
      for (uint j = 0; j < count; j++) {
        const Projected g = staged[first + j];
        const real gx = g.x - (real)tile_x - R(0.5), gy = g.y - (real)tile_y - R(0.5);
        real s[SUMS];
        for (int q = 0; q < SUMS; q++) s[q] = R(0.0);
#pragma unroll
        for (int k = 0; k < PIXELS; k++)
          if (beside(g.bx, tile_x + x) && reaches(g.by, tile_y + y + k * ROW_STEP)) {
            const real dy = (real)(y + k * ROW_STEP) - gy, u = (real)x - fma(g.r, dy, gx);
            if (contributes(LOG2_ALPHA(u, dy, g.a, g.c, g.lo), T[k])) {
              const real gr = grad_block(&g, u, dy, dred[k], dgreen[k], dblue[k], &T[k], &behind[k], s);
              grad_row(gr, gr * u, dy, s);
            }
          }
        for (int q = 0; q < SUMS; q++) ((__local real *)part[j][q])[l] = s[q];
      }
      barrier(CLK_LOCAL_MEM_FENCE);
      if ((uint)l < count * SUMS) {
        real4 sum = (real4)(R(0.0));
        for (int k = 0; k < GRAD_GROUP / 4; k++) sum += part[l / SUMS][l % SUMS][k];
        sums[(size_t)slot[first + l / SUMS] * SUMS + l % SUMS] = (sum.x + sum.y) + (sum.z + sum.w);
      }
      barrier(CLK_LOCAL_MEM_FENCE);
    }
    p += n;
  }
}
#endif
