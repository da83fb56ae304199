// importance: error cues of each Gaussian from one view's error maps.
// Launch: one work-item per VW Gaussians. The pixel under the projected centre, if it is in front of the camera and inside
// the image; sums over the views of the subset. Source: [MH] Eq. 11 and 13, with the Gaussian projected into each view.

__kernel void importance(__global const real *params, uint stride, uint count, // in [planes, stride]
                         const Camera cam,
                         __global const real *maps, int map_stride, int map_rows, // in [2, rows, stride]
                         int first_view,                      // 1: start the sums
                         __global real *ssim, __global real *l1, // in/out [count] sums of 1 - SSIM, |x - y|
                         __global uint *views) {              // in/out [count] views that see the centre
  const uint i = get_global_id(0) * VW;
  if (i >= count) return;
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
    if (first_view) {
      ssim[at] = l1[at] = R(0.0);
      views[at] = 0;
    }
    if (!(inside[l] > R(0.0))) continue;
    const size_t pixel = (size_t)(int)py[l] * map_stride + (size_t)(int)px[l];
    ssim[at] += maps[pixel];
    l1[at] += maps[(size_t)map_stride * map_rows + pixel];
    views[at]++;
  }
}
