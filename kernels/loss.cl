// loss: L = (1 - lambda) mean|x - y| + lambda (1 - mean SSIM) and dL/dx, by two sweeps of separable 11-tap windows
// (sigma 1.5, zero padding, per channel). Both images are shifted by SHIFT = 1/2, padding included, which leaves
// variances and covariances as they are and keeps E[x^2] - E[x]^2 from cancelling on flat images.
// A work-item takes a strip: VW columns by STRIP rows. Source: [MH] Eq. 4; SSIM of Wang et al. 2004; gradient through
// three maps as in fused-ssim.

#define RADIUS (TAPS / 2)
#define ROW (VW + 2 * RADIUS)
#define SHIFT R(0.5)
__constant real WINDOW[TAPS] = SSIM_WINDOW;

// ROW shifted values of a rendered row from column x0 - RADIUS on; 0 before the shift outside of the image.
static inline void render_row(__global const real *plane, int stride, int x0, int y, int width, int height,
                              real out[ROW]) {
  const int inside = y >= 0 && y < height;
  if (inside && x0 >= RADIUS && x0 + VW + RADIUS <= width) {
    __global const real *from = plane + (size_t)y * stride + (x0 - RADIUS);
    for (int k = 0; k < ROW; k++) out[k] = from[k] - SHIFT;
  } else {
    for (int k = 0; k < ROW; k++) {
      const int x = x0 - RADIUS + k;
      out[k] = (inside && x >= 0 && x < width ? plane[(size_t)y * stride + x] : R(0.0)) - SHIFT;
    }
  }
}

// The photo's counterpart: bytes, premultiplied colour plus (1 - alpha) of the background when there is an alpha plane.
static inline void photo_row(__global const uchar *plane, __global const uchar *alpha, real background, int x0, int y,
                             int width, int height, real out[ROW]) {
  const int inside = y >= 0 && y < height;
  for (int k = 0; k < ROW; k++) {
    const int x = x0 - RADIUS + k;
    real v = R(0.0);
    if (inside && x >= 0 && x < width) {
      const size_t at = (size_t)y * width + x;
      v = (real)plane[at] / R(255.0);
#if HAS_ALPHA
      v += (R(1.0) - (real)alpha[at] / R(255.0)) * background;
#endif
    }
    out[k] = v - SHIFT;
  }
}

// Horizontal window over a row.
static inline realV window_row(const real *row) {
  realV sum = (realV)(R(0.0));
  for (int k = 0; k < TAPS; k++) sum = fma((realV)(WINDOW[k]), vload_real(0, row + k), sum);
  return sum;
}

// Vertical window over TAPS consecutive entries.
static inline realV window_column(const realV *rows) {
  realV sum = (realV)(R(0.0));
  for (int k = 0; k < TAPS; k++) sum = fma((realV)(WINDOW[k]), rows[k], sum);
  return sum;
}

// Sum over the lanes that lie inside of the image.
static inline real inside_sum(realV v, int x0, int width) {
  real lane[VW], sum = R(0.0);
  vstore_real(v, 0, lane);
  for (int l = 0; l < VW; l++)
    if (x0 + l < width) sum += lane[l];
  return sum;
}

// SSIM of a pixel block from the windowed moments of the shifted images, and its derivatives with respect to the
// windowed x, x^2 and x y.
static inline realV ssim_of(realV mx, realV my, realV xx, realV yy, realV xy, realV *dmx, realV *dxx, realV *dxy) {
  const realV c1 = (realV)(SSIM_C1), c2 = (realV)(SSIM_C2), two = (realV)(R(2.0));
  const realV mux = mx + SHIFT, muy = my + SHIFT;
  const realV vx = xx - mx * mx, vy = yy - my * my, cov = xy - mx * my;
  const realV a1 = fma(two * mux, muy, c1), a2 = fma(two, cov, c2);
  const realV b1 = fma(mux, mux, fma(muy, muy, c1)), b2 = vx + vy + c2;
  const realV inv = (realV)(R(1.0)) / (b1 * b2), ssim = a1 * a2 * inv;
  *dxx = -ssim / b2;
  *dxy = two * a1 * inv;
  *dmx = two * (muy * a2 * inv - mux * ssim / b1) - two * mx * *dxx - my * *dxy;
  return ssim;
}

// Launch: one work-item per strip (columns x rows of strips). With write_error the maps hold the channel means of
// 1 - SSIM (plane 0) and |x - y| (plane 1); otherwise the derivative maps of the three channels.
__kernel void loss_forward(__global const real *image,  // in [>= 3, rows, stride]
                           __global const uchar *photo, // in [3 or 4, height, width]
                           real bg_red, real bg_green, real bg_blue, int width, int height, int stride, int rows,
                           int write_error,
                           __global real *maps,      // out [9, rows, stride], or [2, rows, stride]
                           __global real *partial) { // out [strips, 2] sums of |x - y| and SSIM
  const int sx = get_global_id(0), sy = get_global_id(1);
  if (sx * VW >= stride || sy * STRIP >= rows) return;
  const int x0 = sx * VW, y0 = sy * STRIP;
  const size_t plane = (size_t)stride * rows, pixels = (size_t)width * height;
  real l1_sum = R(0.0), ssim_sum = R(0.0);
  for (int ch = 0; ch < 3; ch++) {
    const real background = ch == 0 ? bg_red : ch == 1 ? bg_green : bg_blue;
    realV h[5][STRIP + 2 * RADIUS], difference[STRIP];
    for (int r = 0; r < STRIP + 2 * RADIUS; r++) {
      const int y = y0 - RADIUS + r;
      real x[ROW], p[ROW], xx[ROW], pp[ROW], xp[ROW];
      render_row(image + ch * plane, stride, x0, y, width, height, x);
      photo_row(photo + ch * pixels, photo + 3 * pixels, background, x0, y, width, height, p);
      for (int k = 0; k < ROW; k++) {
        xx[k] = x[k] * x[k];
        pp[k] = p[k] * p[k];
        xp[k] = x[k] * p[k];
      }
      h[0][r] = window_row(x);
      h[1][r] = window_row(p);
      h[2][r] = window_row(xx);
      h[3][r] = window_row(pp);
      h[4][r] = window_row(xp);
      if (r >= RADIUS && r < STRIP + RADIUS)
        difference[r - RADIUS] = fabs(vload_real(0, x + RADIUS) - vload_real(0, p + RADIUS));
    }
    for (int r = 0; r < STRIP; r++) {
      const int y = y0 + r;
      if (y >= rows) break;
      realV dmx, dxx, dxy;
      const realV ssim = ssim_of(window_column(h[0] + r), window_column(h[1] + r), window_column(h[2] + r),
                                 window_column(h[3] + r), window_column(h[4] + r), &dmx, &dxx, &dxy);
      __global real *at = maps + (size_t)y * stride + x0;
      if (y < height) {
        l1_sum += inside_sum(difference[r], x0, width);
        ssim_sum += inside_sum(ssim, x0, width);
      }
      if (write_error) {
        const realV third = (realV)(R(1.0) / R(3.0)), one = (realV)(R(1.0));
        const realV e = (one - ssim) * third, l = difference[r] * third;
        vstore_real(ch == 0 ? e : vload_real(0, at) + e, 0, at);
        vstore_real(ch == 0 ? l : vload_real(0, at + plane) + l, 0, at + plane);
      } else {
        at += 3 * ch * plane;
        vstore_real(dmx, 0, at);
        vstore_real(dxx, 0, at + plane);
        vstore_real(dxy, 0, at + 2 * plane);
      }
    }
  }
  const size_t strip = (size_t)sy * ((stride + VW - 1) / VW) + sx;
  partial[2 * strip] = l1_sum;
  partial[2 * strip + 1] = ssim_sum;
}

// ROW values of a derivative map; 0 outside of the image.
static inline void map_row(__global const real *plane, int stride, int x0, int y, int width, int height,
                           real out[ROW]) {
  const int inside = y >= 0 && y < height;
  for (int k = 0; k < ROW; k++) {
    const int x = x0 - RADIUS + k;
    out[k] = inside && x >= 0 && x < width ? plane[(size_t)y * stride + x] : R(0.0);
  }
}

// Launch: as loss_forward. dL/dx, zero in the padding.
__kernel void loss_backward(__global const real *image, __global const uchar *photo, // in, as loss_forward
                            real bg_red, real bg_green, real bg_blue, int width, int height, int stride, int rows,
                            __global const real *maps,   // in [9, rows, stride]
                            real weight_l1,              // (1 - lambda) / (3 width height)
                            real weight_ssim,            // lambda / (3 width height)
                            __global real *dimage) {     // out [3, rows, stride]
  const int sx = get_global_id(0), sy = get_global_id(1);
  if (sx * VW >= stride || sy * STRIP >= rows) return;
  const int x0 = sx * VW, y0 = sy * STRIP;
  const size_t plane = (size_t)stride * rows, pixels = (size_t)width * height;
  for (int ch = 0; ch < 3; ch++) {
    const real background = ch == 0 ? bg_red : ch == 1 ? bg_green : bg_blue;
    realV h[3][STRIP + 2 * RADIUS];
    for (int r = 0; r < STRIP + 2 * RADIUS; r++)
      for (int m = 0; m < 3; m++) {
        real row[ROW];
        map_row(maps + (3 * ch + m) * plane, stride, x0, y0 - RADIUS + r, width, height, row);
        h[m][r] = window_row(row);
      }
    for (int r = 0; r < STRIP; r++) {
      const int y = y0 + r;
      if (y >= rows) break;
      real xr[ROW], pr[ROW], d[VW];
      render_row(image + ch * plane, stride, x0, y, width, height, xr);
      photo_row(photo + ch * pixels, photo + 3 * pixels, background, x0, y, width, height, pr);
      const realV x = vload_real(0, xr + RADIUS), p = vload_real(0, pr + RADIUS);
      const realV dssim = window_column(h[0] + r) +
                          fma((realV)(R(2.0)) * x, window_column(h[1] + r), p * window_column(h[2] + r));
      const realV zero = (realV)(R(0.0)), one = (realV)(R(1.0));
      const realV sign = choose(x > p, one, zero) - choose(x < p, one, zero);
      vstore_real(fma((realV)(weight_l1), sign, -(realV)(weight_ssim)*dssim), 0, d);
      for (int l = 0; l < VW; l++)
        dimage[ch * plane + (size_t)y * stride + x0 + l] = x0 + l < width && y < height ? d[l] : R(0.0);
    }
  }
}

// Launch: one work-item. Adds the strips in order. After an overflow the value means nothing; the repetition replaces it.
__kernel void loss_sum(__global const real *partial, uint strips, real scale, // in [strips, 2], 1 / (3 width height)
                       __global real *out, uint slot) { // out [slots, 2] mean |x - y| and mean SSIM
  if (get_global_id(0) != 0) return;
  real l1 = R(0.0), ssim = R(0.0);
  for (uint s = 0; s < strips; s++) {
    l1 += partial[2 * s];
    ssim += partial[2 * s + 1];
  }
  out[2 * slot] = l1 * scale;
  out[2 * slot + 1] = ssim * scale;
}
