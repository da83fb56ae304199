// importance: error cues of each Gaussian from one view's error maps.
// Launch: one work-item per Gaussian. The pixel under the projected centre, if it is in front of the camera and inside
// the image; sums over the views of the subset. Source: [MH] Eq. 11 and 13, with the Gaussian projected into each view.

__kernel void importance(__global const real *params, uint stride, uint count, // in [planes, stride]
                         const Camera cam,
                         __global const real *maps, int map_stride, int map_rows, // in [2, rows, stride]
                         int first_view,                      // 1: start the sums
                         __global real *ssim, __global real *l1, // in/out [count] sums of 1 - SSIM, |x - y|
                         __global uint *views) {              // in/out [count] views that see the centre
  const uint i = get_global_id(0);
  if (i >= count) return;
  real sum_ssim = R(0.0), sum_l1 = R(0.0);
  uint seen = 0;
  if (!first_view) {
    sum_ssim = ssim[i];
    sum_l1 = l1[i];
    seen = views[i];
  }
  real x[3], t[3];
  for (int k = 0; k < 3; k++) x[k] = params[(size_t)(P_POSITION + k) * stride + i];
  to_camera(&cam, x, t);
  if (t[2] > cam.near) {
    const real px = floor(fma(cam.fx, t[0] / t[2], cam.cx)), py = floor(fma(cam.fy, t[1] / t[2], cam.cy));
    if (px >= R(0.0) && px < (real)cam.width && py >= R(0.0) && py < (real)cam.height) {
      const size_t at = (size_t)(int)py * map_stride + (size_t)(int)px;
      sum_ssim += maps[at];
      sum_l1 += maps[(size_t)map_stride * map_rows + at];
      seen++;
    }
  }
  ssim[i] = sum_ssim;
  l1[i] = sum_l1;
  views[i] = seen;
}
