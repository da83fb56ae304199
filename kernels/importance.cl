// importance: error statistics of each Gaussian from one view's error maps, of a render that training has just made.
// Launch: one work-item per VW Gaussians. The pixel under the projected centre, if it is in front of the camera and inside
// the image; sums over the views of the subset. Source: [MH] Eq. 11 and 13, with the Gaussian projected into each view.
#include "gaussians.clh"

__kernel void importance(__global const real *params, uint stride, uint count, // in [planes, stride]
                         const Camera cam,
                         __global const real *maps, int map_stride, int map_rows, // in [ERROR_SETS, 2, rows, stride]
                         int first_view,              // 1: start the sums
                         __global const uint *status, // in S_OVERFLOW: then the view does not count
                         __global real *statistics) { // in/out [3, stride] sums of 1 - SSIM and |x - y|, views that see the centre
  const uint i = get_global_id(0) * VW;
  if (i >= count || status[S_OVERFLOW] != 0) return;
  realV x[3], t[3];
  for (int k = 0; k < 3; k++) x[k] = PLANE(params, P_POSITION + k);
  to_camera(&cam, x, t);
  real px[VW], py[VW], inside[VW];
  const realV zero = V(R(0.0));
  const realV u = floor(fma(V(cam.fx), t[0] / t[2], V(cam.cx))), v = floor(fma(V(cam.fy), t[1] / t[2], V(cam.cy)));
  const maskV seen = (t[2] > V(cam.near)) & (u >= zero) & (u < V((real)cam.width)) & (v >= zero) & (v < V((real)cam.height));
  vstore_real(u, 0, px);
  vstore_real(v, 0, py);
  vstore_real(choose(seen, V(R(1.0)), zero), 0, inside);
  for (uint l = 0; l < min((uint)VW, count - i); l++) {
    const uint at = i + l;
    __global real *ssim = statistics + at, *l1 = ssim + stride, *views = l1 + stride;
    if (first_view) *ssim = *l1 = *views = R(0.0);
    if (!(inside[l] > R(0.0))) continue;
    const size_t pixel = (size_t)(int)py[l] * map_stride + (size_t)(int)px[l], plane = (size_t)map_stride * map_rows;
    real e[2] = {maps[pixel], maps[plane + pixel]};
    for (int set = 1; set < ERROR_SETS; set++)
      for (int k = 0; k < 2; k++) e[k] += maps[(2 * set + k) * plane + pixel];
    *ssim += e[0];
    *l1 += e[1];
    *views += R(1.0);
  }
}
