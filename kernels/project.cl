// project: raw Gaussians -> records of one camera.
// Launch: one work-item per Gaussian. Culled (behind the near plane, outside the image, below the alpha cut, any
// non-finite value): key KEY_CULLED, no record. Source: 3DGS image formation in the stable forms of the reference twin.

// Colour from SH coefficients: max(0, sum + 1/2).
static inline void sh_color(__global const real *params, uint stride, uint i, const real basis[SH_COUNT], real rgb[3]) {
  for (int ch = 0; ch < 3; ch++) {
    real sum = R(0.5);
    for (int k = 0; k < SH_COUNT; k++) sum = fma(basis[k], params[(size_t)(P_SH + 3 * k + ch) * stride + i], sum);
    rgb[ch] = fmax(sum, R(0.0));
  }
}

// Inclusive pixel range |p + 1/2 - mean| <= half within [0, size); returns 0 when empty.
static inline int pixel_bounds(real mean, real half_extent, int size, uint *packed) {
  const real lo = ceil(mean - half_extent - R(0.5)), hi = floor(mean + half_extent - R(0.5));
  if (!(hi >= R(0.0) && lo <= (real)(size - 1) && lo <= hi)) return 0;
  const uint first = (uint)fmax(lo, R(0.0)), last = (uint)fmin(hi, (real)(size - 1));
  *packed = first | (last << 16);
  return 1;
}

__kernel void project(__global const real *params,   // in [planes, stride] raw parameters
                      uint stride, uint count,       // Gaussians allocated, Gaussians
                      const Camera cam,              // in camera
                      int depth_as_color,            // 1: the colour is the depth (for depth images)
                      __global Record *records,      // out [stride]
                      __global uint *keys,           // out [stride] bits of the f32 depth, or KEY_CULLED
                      __global uint *pair_counts) {  // out [stride] 0: no pair of this Gaussian yet
  const uint i = get_global_id(0);
  if (i >= count) return;
  keys[i] = KEY_CULLED;
  pair_counts[i] = 0;
  real x[3], ls[3], q[4];
  for (int k = 0; k < 3; k++) {
    x[k] = params[(size_t)(P_POSITION + k) * stride + i];
    ls[k] = params[(size_t)(P_LOG_SCALE + k) * stride + i];
  }
  for (int k = 0; k < 4; k++) q[k] = params[(size_t)(P_ROTATION + k) * stride + i];
  Shape o;
  if (!shape_of(&cam, x, ls, q, &o)) return;
  Record g;
  g.lo = -softplus(-params[(size_t)P_OPACITY * stride + i]) * R(1.4426950408889634);
  const real tau = g.lo - (real)LOG2_ALPHA_MIN;
  if (!(tau > R(0.0))) return;
  g.x = fma(cam.fx, o.t[0] * o.iz, cam.cx);
  g.y = fma(cam.fy, o.t[1] * o.iz, cam.cy);
  const real reach = R(1.3862943611198906) * tau; // 2 ln2
  if (!pixel_bounds(g.x, sqrt(reach * o.sxx), cam.width, &g.bx)) return;
  if (!pixel_bounds(g.y, sqrt(reach * o.syy), cam.height, &g.by)) return;
  g.a = R(0.7213475204444817) * (o.syy / o.det);
  g.r = o.sxy / o.syy;
  g.c = R(0.7213475204444817) / o.syy;
  if (!(isfinite(g.a) && isfinite(g.r) && isfinite(g.c))) return;
  g.depth = o.t[2];
  real dir[3], basis[SH_COUNT], rgb[3];
  view_direction(&cam, x, dir);
  sh_basis(dir, basis);
  sh_color(params, stride, i, basis, rgb);
  if (!(isfinite(rgb[0]) && isfinite(rgb[1]) && isfinite(rgb[2]))) return;
  g.red = depth_as_color ? g.depth : rgb[0];
  g.green = depth_as_color ? g.depth : rgb[1];
  g.blue = depth_as_color ? g.depth : rgb[2];
  records[i] = g;
  keys[i] = as_uint((float)o.t[2]);
}
