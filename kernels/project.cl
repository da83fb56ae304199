// project: raw Gaussians -> records of one camera.
// Launch: one work-item per VW Gaussians. Culled (behind the near plane, outside the image, below the alpha cut, any
// non-finite value): key KEY_CULLED, no record that means anything. Source: 3DGS image formation in numerically stable forms; the definition in f64 is that of the textbook.
#include "ahead.clh"
#include "projection.clh"

// Colour from SH coefficients: max(0, sum + 1/2); off where that is broken. Three sums at once: none waits for the additions of another.
static inline maskV sh_color(__global const real *params, uint stride, uint i, const realV basis[SH_COUNT],
                             realV rgb[3]) {
  maskV good = V(R(0.0)) == V(R(0.0));
  realV sum[3];
  for (int ch = 0; ch < 3; ch++) sum[ch] = V(R(0.5));
#if VW > 1
#pragma unroll
#endif
  for (int k = 0; k < SH_COUNT; k++)
#pragma unroll
    for (int ch = 0; ch < 3; ch++) sum[ch] = fma(basis[k], PLANE(params, P_SH + 3 * k + ch), sum[ch]);
  for (int ch = 0; ch < 3; ch++) {
    good &= fabs(sum[ch]) < V(COLOR_MAX);
    rgb[ch] = max(sum[ch], V(R(0.0)));
  }
  return good;
}

// Inclusive pixel range |p + 1/2 - mean| <= half within [0, size); off when empty or not finite.
static inline maskV pixel_bounds(realV mean, realV half_extent, int size, realV *first, realV *last) {
  const realV zero = V(R(0.0)), end = V((real)(size - 1));
  const realV lo = ceil(mean - half_extent - R(0.5)), hi = floor(mean + half_extent - R(0.5));
  *first = fmax(lo, zero);
  *last = fmin(hi, end);
  return (hi >= zero) & (lo <= end) & (lo <= hi);
}

#if CULL_CHUNKS
// Off for what project() is sure to cull, by its centre and its largest scale alone: behind the near plane, or beyond the
// image by more than the widest ellipse that any opacity gives it. Neighbours in Morton order are off together. What is
// broken is off here or in shape_of().
static inline maskV may_be_seen(const Camera *cam, const realV x[3], const realV ls[3], realV sigma) {
  realV t[3];
  to_camera(cam, x, t);
  realV largest = exp(clamp(fmax(ls[0], fmax(ls[1], ls[2])), V(LOG_SCALE_MIN), V(LOG_SCALE_MAX)));
#if ANTI_ALIAS
  largest = sqrt(fma(sigma, sigma, largest * largest));
#endif
  const realV iz = R(1.0) / t[2], u = t[0] * iz, v = t[1] * iz;
  const realV reach = V(R(-1.4) * (real)LOG2_ALPHA_MIN); // 2 ln2 (1 + 1 %) of the largest exponent
  // |J W| of a row is f/z |(1, u)| with the clamped u; the rest of M is a rotation and the scales.
  const realV cu = clamp(u, V(cam->u_min), V(cam->u_max)), cv = clamp(v, V(cam->v_min), V(cam->v_max));
  const realV jx = cam->fx * iz * largest, jy = cam->fy * iz * largest;
  const realV wide = sqrt(reach * fma(jx * jx, fma(cu, cu, V(R(1.0))), V((real)BLUR))) + R(1.0);
  const realV high = sqrt(reach * fma(jy * jy, fma(cv, cv, V(R(1.0))), V((real)BLUR))) + R(1.0);
  const realV px = fma(V(cam->fx), u, V(cam->cx)), py = fma(V(cam->fy), v, V(cam->cy));
  return (t[2] > V(cam->near)) & (px + wide >= V(R(0.0))) & (px - wide <= V((real)cam->width)) &
         (py + high >= V(R(0.0))) & (py - high <= V((real)cam->height));
}
#endif

// Rows of tiles of a Gaussian, for ranks that share a view (route): the first, and the one after the last in the high half.
static inline uint tile_rows(uint by) { return (uint)BOUND_LO(by) / TILE | ((uint)BOUND_HI(by) / TILE + 1) << 16; }

// 1: several f32 lanes, whose records are written as rows.
#define HAS_ROWS (VW > 1 && !REAL_IS_DOUBLE)
#if HAS_ROWS
// Lanes k and k + 1 of each group of four of a and b: in turn a, b, a, b; a, a, b, b.
#if VW == 4
#define MIX(a, b, k) __builtin_shufflevector(a, b, k, (k) + 4, (k) + 1, (k) + 5)
#define MIX_PAIRS(a, b, k) __builtin_shufflevector(a, b, k, (k) + 1, (k) + 4, (k) + 5)
#elif VW == 8
#define MIX(a, b, k) __builtin_shufflevector(a, b, k, (k) + 8, (k) + 1, (k) + 9, (k) + 4, (k) + 12, (k) + 5, (k) + 13)
#define MIX_PAIRS(a, b, k) __builtin_shufflevector(a, b, k, (k) + 1, (k) + 8, (k) + 9, (k) + 4, (k) + 5, (k) + 12, (k) + 13)
#else
#define MIX(a, b, k)                                                                                                           \
  __builtin_shufflevector(a, b, k, (k) + 16, (k) + 1, (k) + 17, (k) + 4, (k) + 20, (k) + 5, (k) + 21, (k) + 8, (k) + 24, (k) + 9, \
                          (k) + 25, (k) + 12, (k) + 28, (k) + 13, (k) + 29)
#define MIX_PAIRS(a, b, k)                                                                                                     \
  __builtin_shufflevector(a, b, k, (k) + 1, (k) + 16, (k) + 17, (k) + 4, (k) + 5, (k) + 20, (k) + 21, (k) + 8, (k) + 9, (k) + 24, \
                          (k) + 25, (k) + 12, (k) + 13, (k) + 28, (k) + 29)
#endif

// Writes each group of four lanes of v as a piece of a row: that of lane `first`, and of every fourth one after it.
#if VW == 4
#define STORE_FOURS(v, first, to, row) vstore4(v, 0, to + (first) * row)
#elif VW == 8
#define STORE_FOURS(v, first, to, row) (vstore4((v).lo, 0, to + (first) * row), vstore4((v).hi, 0, to + ((first) + 4) * row))
#else
#define STORE_FOURS(v, first, to, row)                                                               \
  (vstore4((v).lo.lo, 0, to + (first) * row), vstore4((v).lo.hi, 0, to + ((first) + 4) * row),       \
   vstore4((v).hi.lo, 0, to + ((first) + 8) * row), vstore4((v).hi.hi, 0, to + ((first) + 12) * row))
#endif

// A piece of the rows of VW lanes: a, b, c and d of lane l go to to[l * row] to to[l * row + 3].
static inline void store_rows(realV a, realV b, realV c, realV d, __global real *to, uint row) {
  const realV first = MIX(a, b, 0), second = MIX(a, b, 2), third = MIX(c, d, 0), fourth = MIX(c, d, 2);
  STORE_FOURS(MIX_PAIRS(first, third, 0), 0, to, row);
  STORE_FOURS(MIX_PAIRS(first, third, 2), 1, to, row);
  STORE_FOURS(MIX_PAIRS(second, fourth, 0), 2, to, row);
  STORE_FOURS(MIX_PAIRS(second, fourth, 2), 3, to, row);
}
#else
// A field of the records of VW Gaussians, lane by lane.
#define EACH_LANE(field, value)                  \
  do {                                           \
    real lane[VW];                               \
    vstore_real(value, 0, lane);                 \
    for (int l = 0; l < VW; l++) g[l].field = lane[l]; \
  } while (0)
#endif

__kernel void project(__global const real *params,   // in [planes, stride] raw parameters
                      uint stride, uint count,       // Gaussians allocated (a multiple of VW), Gaussians
#if ANTI_ALIAS
                      __global const real *filter,   // in [stride] standard deviation of the 3D filter, local units
#endif
                      const Camera cam,              // in camera
                      __global Projected *records,      // out [stride]
                      __global uint *keys,           // out [stride] bits of the f32 depth, or KEY_CULLED
                      __global uint *isect_counts) {  // out [stride] tile_rows() until bin counts the pairs; 0 where culled. Of each whole vectors are written
  const uint i = get_global_id(0) * VW;
  if (i >= count) return;
#if HAS_ROWS
  vstore_uint((uintV)(KEY_CULLED), 0, keys + i);
  vstore_uint((uintV)(0), 0, isect_counts + i);
#else
  const uint n = min((uint)VW, count - i);
  for (uint l = 0; l < n; l++) {
    keys[i + l] = KEY_CULLED;
    isect_counts[i + l] = 0;
  }
#endif
  // First the planes that culling reads.
  for (int k = 0; k < P_ROTATION; k++) ASK_FOR(params + (size_t)k * stride + i + LINES_AHEAD * LINE);
  realV x[3], ls[3], q[4];
  for (int k = 0; k < 3; k++) {
    x[k] = PLANE(params, P_POSITION + k);
    ls[k] = PLANE(params, P_LOG_SCALE + k);
  }
  Shape o;
#if ANTI_ALIAS
  o.sigma = vload_real(0, filter + i);
  ASK_FOR(filter + i + LINES_AHEAD * LINE);
  const realV sigma = o.sigma;
#else
  const realV sigma = V(R(0.0));
#endif
#if CULL_CHUNKS
  if (!any_lane(may_be_seen(&cam, x, ls, sigma))) return;
#endif
  // Neighbours are seen together, mostly.
  for (int k = P_ROTATION; k < P_SH + 3 * SH_COUNT; k++) ASK_FOR(params + (size_t)k * stride + i + LINES_AHEAD * LINE);
  realV lo = -softplus(-PLANE(params, P_OPACITY)) * R(1.4426950408889634);
  for (int k = 0; k < 4; k++) q[k] = PLANE(params, P_ROTATION + k);
  maskV seen = shape_of(&cam, x, ls, q, &o);
#if ANTI_ALIAS
  lo += log2_left(&o);
#endif
  const realV tau = lo - (real)LOG2_ALPHA_MIN;
  seen &= tau > V(R(0.0));
  const realV px = fma(V(cam.fx), o.t[0] * o.iz, V(cam.cx)), py = fma(V(cam.fy), o.t[1] * o.iz, V(cam.cy));
  const realV reach = R(1.3862943611198906) * tau; // 2 ln2
  realV x0, x1, y0, y1;
  seen &= pixel_bounds(px, sqrt(reach * o.sxx), cam.width, &x0, &x1);
  seen &= pixel_bounds(py, sqrt(reach * o.syy), cam.height, &y0, &y1);
  const realV a = R(0.7213475204444817) * (o.syy / o.det), r = o.sxy / o.syy, c = R(0.7213475204444817) / o.syy;
  const realV large = V(R(1e38));
  seen &= (a < large) & (fabs(r) < large) & (c < large);
  if (!any_lane(seen)) return;
  realV dir[3], basis[SH_COUNT], rgb[3];
  view_direction(&cam, x, dir);
  sh_basis(dir, basis);
  seen &= sh_color(params, stride, i, basis, rgb);
#if HAS_ROWS
  // A culled one has a record, too, which nobody reads, and so have rows beyond the last.
  const uintV bx = to_uint(x0) | to_uint(x1) << 16, by = to_uint(y0) | to_uint(y1) << 16;
  __global real *to = (__global real *)(records + i);
  const uint row = sizeof(Projected) / sizeof(real);
  store_rows(px, py, a, r, to, row);
  store_rows(c, lo, rgb[0], rgb[1], to + 4, row);
  store_rows(rgb[2], o.t[2], real_of(bx), real_of(by), to + 8, row);
  seen &= LANES < V((real)(count - i));
  const uintV rows = (by & 0xffffu) / TILE | ((by >> 16) / TILE + 1) << 16; // tile_rows()
  vstore_uint(select((uintV)(KEY_CULLED), bits_of(o.t[2]), seen), 0, keys + i);
  vstore_uint(select((uintV)(0), rows, seen), 0, isect_counts + i);
#else
  Projected g[VW];
  EACH_LANE(x, px);
  EACH_LANE(y, py);
  EACH_LANE(a, a);
  EACH_LANE(r, r);
  EACH_LANE(c, c);
  EACH_LANE(lo, lo);
  EACH_LANE(red, rgb[0]);
  EACH_LANE(green, rgb[1]);
  EACH_LANE(blue, rgb[2]);
  EACH_LANE(depth, o.t[2]);
  real on[VW], left[VW], right[VW], top[VW], bottom[VW];
  vstore_real(choose(seen, V(R(1.0)), V(R(0.0))), 0, on);
  vstore_real(x0, 0, left);
  vstore_real(x1, 0, right);
  vstore_real(y0, 0, top);
  vstore_real(y1, 0, bottom);
  for (uint l = 0; l < n; l++) {
    if (!(on[l] > R(0.0))) continue;
    g[l].bx = (uint)left[l] | ((uint)right[l] << 16);
    g[l].by = (uint)top[l] | ((uint)bottom[l] << 16);
    records[i + l] = g[l];
    keys[i + l] = as_uint((float)g[l].depth);
    isect_counts[i + l] = tile_rows(g[l].by);
  }
#endif
}

// The depth in the place of the colour of each visible Gaussian, so that splat composites depths over the pairs that there are.
// Launch: one work-item per Gaussian.
__kernel void project_depths(__global const uint *keys, uint count, // in [count] depth bits or KEY_CULLED
                             __global Projected *records) {         // in/out [count]
  const uint i = get_global_id(0);
  if (i >= count || keys[i] == KEY_CULLED) return;
  __global Projected *g = records + i;
  g->red = g->green = g->blue = g->depth;
}
