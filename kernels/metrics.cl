// metrics: squared error of a render clamped to [0, 1] against a photo; the clamped image stays in place, so that SSIM
// (loss_forward) is taken of the same picture; then the sum of 1 - SSIM over the pixels, as far as each counts. With a mask
// m both are of the masked pictures: (m x - m y)^2, and m (1 - SSIM) of the map between m x and m y, so that nothing under a
// mask changes a score. Launch of both kernels: one work-group per image row, or one work-item where that is a whole core; the
// sums are in a fixed order.
#include "chunks.clh"

CHUNK_KERNEL void metrics(__global real *image,               // in/out [>= 3, rows, stride]
                          __global const uchar *photo,        // in [3 or 4, height, width]
                          int width, int height, int stride, int rows, real bg_red, real bg_green, real bg_blue,
                          __global real *score) { // out [>= 2, height]: 0 sum over the row and the channels, 1 pixels that count
  PARTS;
  const int y = CHUNK;
  const size_t plane = (size_t)stride * rows, pixels = (size_t)width * height;
  real sum = R(0.0), counted = R(0.0);
  for (int ch = 0; ch < 3; ch++) {
    const real background = ch == 0 ? bg_red : ch == 1 ? bg_green : bg_blue;
    for (int x = ITEM; x < width; x += GROUP) {
      const size_t at = ch * plane + (size_t)y * stride + x, from = (size_t)y * width + x;
      const real c = clamp(image[at], R(0.0), R(1.0));
      image[at] = c;
      real p = (real)photo[ch * pixels + from] / R(255.0);
#if HAS_MASK
      const real m = (real)photo[3 * pixels + from] / R(255.0);
      sum = fma(m * c - p, m * c - p, sum);
      if (ch == 0) counted += m;
#else
#if HAS_ALPHA
      p += (R(1.0) - (real)photo[3 * pixels + from] / R(255.0)) * background;
#endif
      sum = fma(c - p, c - p, sum);
#endif
    }
  }
  const real2 total = group_total((real2)(sum, counted), parts);
  if (ITEM != 0) return;
  score[y] = total.x;
#if HAS_MASK
  score[height + y] = total.y;
#else
  score[height + y] = (real)width;
#endif
}

CHUNK_KERNEL void metrics_ssim(__global const real *maps,   // in [ERROR_SETS, 2, rows, stride] 1 - SSIM first
                               __global const uchar *photo, // in [3 or 4, height, width]
                               int width, int height, int stride, int rows,
                               __global real *score) { // out [3, height]: 2 sum over the row
  PARTS;
  const int y = CHUNK;
  real sum = R(0.0);
  for (int x = ITEM; x < width; x += GROUP) {
    real e = maps[(size_t)y * stride + x];
    for (int set = 1; set < ERROR_SETS; set++) e += maps[((size_t)(2 * set) * rows + y) * stride + x];
#if HAS_MASK
    const size_t pixels = (size_t)width * height;
    sum = fma((real)photo[3 * pixels + (size_t)y * width + x] / R(255.0), e, sum);
#else
    sum += e;
#endif
  }
  const real2 total = group_total((real2)(sum, R(0.0)), parts);
  if (ITEM == 0) score[2 * height + y] = total.x;
}
