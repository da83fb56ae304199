// photo_error: how far a render is from its photo at each pixel, from which density control draws the births in image space: the
// mean over the channels of |x - y|, with x the render under the transform of its view (see exposure) and y the photo: over the
// background if it is transparent, without its mask if it has one. It is multiplied by that opacity or mask: nothing is born
// where the photo has nothing, whatever fog is there. Non-finite values are taken as they are. Sums and quotients are those that
// the formula has, without fma(): density control decided by the same numbers when the host computed them.
// Launch: one work-group per image row, or one work-item where that is a whole core.
#include "chunks.clh"
#include "lanes.clh"

// VW values of a plane of the photo, `left` of which are of the row.
static inline realV photo_values(__global const uchar *from, int left) {
#if VW > 1
  if (left < VW) {
    real in[VW];
    for (int l = 0; l < VW; l++) in[l] = l < left ? (real)from[l] : R(0.0);
    return vload_real(0, in) / V(R(255.0));
  }
#endif
  return bytes_to_real(from) / V(R(255.0));
}

CHUNK_KERNEL void photo_error(__global real *image, // in [4, rows, stride] colour; out in plane 2, beside transmittance: the error
                              __global const uchar *photo, // in [3 or 4, height, width]
                              int width, int height, int stride, int rows, real bg_red, real bg_green, real bg_blue,
                              __global const real *exposures, uint view) { // in [views, 12]
  const int y = CHUNK;
  const size_t plane = (size_t)stride * rows, pixels = (size_t)width * height;
  const real background[3] = {bg_red, bg_green, bg_blue};
  real e[12];
  for (int k = 0; k < 12; k++) e[k] = exposures[12 * view + k];
  for (int x = ITEM * VW; x < width; x += GROUP * VW) {
    __global real *at = image + (size_t)y * stride + x;
    __global const uchar *from = photo + (size_t)y * width + x;
    const realV red = vload_real(0, at), green = vload_real(0, at + plane), blue = vload_real(0, at + 2 * plane);
    realV sum = V(R(0.0));
#if HAS_ALPHA || HAS_MASK
    const realV a = photo_values(from + 3 * pixels, width - x);
#endif
    for (int ch = 0; ch < 3; ch++) {
      const realV seen = V(e[4 * ch]) * red + V(e[4 * ch + 1]) * green + V(e[4 * ch + 2]) * blue + V(e[4 * ch + 3]);
      realV taken = photo_values(from + ch * pixels, width - x);
#if HAS_ALPHA
      taken += (V(R(1.0)) - a) * V(background[ch]);
#elif HAS_MASK
      taken = choose(a > V(R(0.0)), fmin(taken / a, V(R(1.0))), V(R(0.0)));
#endif
      sum += fabs(seen - taken);
    }
#if HAS_ALPHA || HAS_MASK
    sum *= a;
#endif
    vstore_real(sum / V(R(3.0)), 0, at + 2 * plane);
  }
}
