// loss: L = (1 - lambda) mean|x - y| + lambda (1 - mean SSIM) and dL/dx, by two sweeps of separable 11-tap windows
// (sigma 1.5, zero padding), one channel after the other so that the maps between the sweeps stay in cache. Both images
// are shifted by SHIFT = 1/2, padding included, which leaves variances and covariances as they are and keeps
// E[x^2] - E[x]^2 from cancelling on flat images. A work-item takes a strip of STRIP columns by LOSS_ROWS rows: it windows
// columns first (2 RADIUS + LOSS_ROWS rows serve LOSS_ROWS sums, in registers), then rows; longer than a function should be, because
// the windows stay in registers. With SKIP_BLANK vectors are left out whose windows see only tiles that are masked, or clear in
// the photo and without pairs in the render: render and photo are the same there, the derivatives of SSIM with respect to x,
// x^2 and x y cancel, and zeros in the maps are right for neighbours. Pixels of other tiles have the same gradient, to the bit. Source: [MH]
// Eq. 4; SSIM of Wang et al. 2004; gradient through three maps as in fused-ssim.

#define RADIUS (TAPS / 2)
#define REACH (LOSS_ROWS + 2 * RADIUS) // rows that a group sees
#define HALO ((RADIUS + VW - 1) / VW)     // vectors that a strip needs on either side; loads stay aligned
#define VECTORS (STRIP / VW + 2 * HALO)
#define SHIFT R(0.5)
__constant real WINDOW[TAPS] = SSIM_WINDOW;

// All ones in lanes that lie inside of the image.
static inline maskV inside(int x, int width) {
  const realV at = LANES + (realV)((real)x);
  return (at >= (realV)(R(0.0))) & (at < (realV)((real)width));
}

// VW values of row y from column x on, 0 outside of the image. Vectors that stick out are loaded whole and masked,
// unless that would leave the array of `length` values.
#define LOAD_AT(name, type, load)                                                                                  \
  static inline realV name(__global const type *image, long length, long row, int x, int width) {                \
    realV v;                                                                                                       \
    if (row + x >= 0 && row + x + VW <= length) v = load(image + row + x);                                         \
    else {                                                                                                         \
      real in[VW];                                                                                                 \
      for (int l = 0; l < VW; l++) in[l] = x + l >= 0 && x + l < width ? (real)image[row + x + l] : R(0.0);        \
      v = vload_real(0, in);                                                                                       \
    }                                                                                                              \
    return x >= 0 && x + VW <= width ? v : choose(inside(x, width), v, (realV)(R(0.0)));                           \
  }
#define REALS(p) vload_real(0, p)
LOAD_AT(reals_at, real, REALS)
LOAD_AT(bytes_at, uchar, bytes_to_real)

// A render and its photo.
typedef struct {
  __global const real *image;  // [>= 3, rows, stride]
  __global const uchar *photo; // [3 or 4, height, width]
  long plane, pixels;
  int channel, width, height, stride;
  real background;
} Images;

// v / 255 to the last bit without a division, so that a render that equals its photo has no gradient.
static inline realV over_255(realV v) {
  const realV r = (realV)(R(1.0) / R(255.0)), q = v * r;
  return fma(fma((realV)(-R(255.0)), q, v), r, q);
}

#if HAS_MASK
// How far pixels of row y from column x on count; 0 outside of the image.
static inline realV mask_at(const Images *s, int x, int y) {
  if (y < 0 || y >= s->height) return (realV)(R(0.0));
  return over_255(bytes_at(s->photo, 4 * s->pixels, 3 * s->pixels + (long)y * s->width, x, s->width));
}
#endif

// VW rendered values of row y from column x on, shifted; masked as the photo is.
static inline realV render_at(const Images *s, int x, int y) {
  if (y < 0 || y >= s->height) return (realV)(-SHIFT);
  const realV v = reals_at(s->image, 3 * s->plane, s->channel * s->plane + (long)y * s->stride, x, s->width);
#if HAS_MASK
  return fma(mask_at(s, x, y), v, (realV)(-SHIFT));
#else
  return v - SHIFT;
#endif
}

// The photo's counterpart: premultiplied colour plus (1 - alpha) of the background when there is an alpha plane.
static inline realV photo_at(const Images *s, int x, int y) {
  if (y < 0 || y >= s->height) return (realV)(-SHIFT);
  const long length = (3 + (HAS_ALPHA || HAS_MASK)) * s->pixels, row = (long)y * s->width;
  realV v = over_255(bytes_at(s->photo, length, s->channel * s->pixels + row, x, s->width));
#if HAS_ALPHA
  const realV a = over_255(bytes_at(s->photo, length, 3 * s->pixels + row, x, s->width));
  v += choose(inside(x, s->width), (realV)(R(1.0)) - a, (realV)(R(0.0))) * s->background;
#endif
  return v - SHIFT;
}

#if SKIP_BLANK
// Whether any tile within `margin` pixels of VW columns from x on, LOSS_ROWS rows from y on, may have a render that differs from
// the photo: one that is active or, but for masks, has pairs.
static inline int may_differ(__global const uint *active_tiles, __global const uint *tile_start, int x, int y, int margin, int stride, int rows) {
  const int across = stride / TILE, first = max(x - margin, 0) / TILE, last = min(x + VW - 1 + margin, stride - 1) / TILE;
  for (int ty = max(y - margin, 0) / TILE; ty <= min(y + LOSS_ROWS - 1 + margin, rows - 1) / TILE; ty++)
    for (int tile = ty * across + first; tile <= ty * across + last; tile++)
#if HAS_MASK
      if (active_tiles[tile]) return 1;
#else
      if (active_tiles[tile] || tile_start[tile + 1] > tile_start[tile]) return 1;
#endif
  return 0;
}

// Flags the vectors of a strip that are not left out.
static inline void flag_active(int skip, __global const uint *active_tiles, __global const uint *tile_start, int x0, int y0, int margin, int stride,
                               int rows, int active[STRIP / VW]) {
  for (int j = 0; j < STRIP / VW; j++) {
    const int x = x0 + j * VW;
    active[j] = x < stride && (!skip || may_differ(active_tiles, tile_start, x, y0, margin, stride, rows));
  }
}

// Whether windows over the rows of any active vector see vector `at` of the strip with its halo.
static inline int in_reach(const int active[STRIP / VW], int at) {
  int any_active = 0;
  for (int j = max(at - 2 * HALO, 0); j <= min(at, STRIP / VW - 1); j++) any_active |= active[j];
  return any_active;
}
#endif

// Vertical windows of LOSS_ROWS consecutive rows, of REACH rows. The window is symmetric: 5 sums, 6 products.
static inline void window_columns(const realV r[REACH], realV out[LOSS_ROWS]) {
  const real weights[TAPS] = SSIM_WINDOW;
#pragma unroll
  for (int g = 0; g < LOSS_ROWS; g++) {
    realV sum = (realV)(weights[RADIUS]) * r[g + RADIUS];
#pragma unroll
    for (int k = 0; k < RADIUS; k++) sum = fma((realV)(weights[k]), r[g + k] + r[g + 2 * RADIUS - k], sum);
    out[g] = sum;
  }
}

// Horizontal window over the lanes of row[at], from its neighbours.
static inline realV window_row(const realV row[VECTORS], int at) {
#if VW == 16
  // Lanes shifted in registers: cheaper than loads that cross cache lines.
  const realV a = row[at - 1], b = row[at], c = row[at + 1];
  realV sum = (realV)(WINDOW[5]) * b;
  sum = fma((realV)(WINDOW[4]), NEXT_LANES(a, b, 15) + NEXT_LANES(b, c, 1), sum);
  sum = fma((realV)(WINDOW[3]), NEXT_LANES(a, b, 14) + NEXT_LANES(b, c, 2), sum);
  sum = fma((realV)(WINDOW[2]), NEXT_LANES(a, b, 13) + NEXT_LANES(b, c, 3), sum);
  sum = fma((realV)(WINDOW[1]), NEXT_LANES(a, b, 12) + NEXT_LANES(b, c, 4), sum);
  return fma((realV)(WINDOW[0]), NEXT_LANES(a, b, 11) + NEXT_LANES(b, c, 5), sum);
#else
  const real *from = (const real *)row + at * VW;
  realV sum = (realV)(WINDOW[RADIUS]) * vload_real(0, from);
  for (int k = 1; k <= RADIUS; k++)
    sum = fma((realV)(WINDOW[RADIUS - k]), vload_real(0, from - k) + vload_real(0, from + k), sum);
  return sum;
#endif
}

// Sum over the lanes.
static inline real lane_total(realV v) {
  real lane[VW], sum = R(0.0);
  vstore_real(v, 0, lane);
  for (int l = 0; l < VW; l++) sum += lane[l];
  return sum;
}

// SSIM of VW pixels from the windowed moments of the shifted images (means, E[x^2 + y^2], E[xy]), and its derivatives
// with respect to the windowed x, x^2 and x y.
static inline realV ssim_of(realV mx, realV my, realV squares, realV xy, realV *dmx, realV *dxx, realV *dxy) {
  const realV c1 = (realV)(SSIM_C1), c2 = (realV)(SSIM_C2), two = (realV)(R(2.0));
  const realV mux = mx + SHIFT, muy = my + SHIFT;
  const realV variances = squares - mx * mx - my * my, cov = xy - mx * my;
  const realV a1 = fma(two * mux, muy, c1), a2 = fma(two, cov, c2);
  const realV b1 = fma(mux, mux, fma(muy, muy, c1)), b2 = variances + c2;
  const realV inv = (realV)(R(1.0)) / (b1 * b2), ssim = a1 * a2 * inv;
  *dxx = -ssim * (b1 * inv);
  *dxy = two * a1 * inv;
  *dmx = two * (muy * a2 * inv - mux * ssim * (b2 * inv)) - two * mx * *dxx - my * *dxy;
  return ssim;
}

// Launch: one work-item per strip (columns x groups of rows). With write_error the maps hold the channel means of
// 1 - SSIM (plane 0) and |x - y| (plane 1), added up from channel 0 on; otherwise the channel's derivative maps, 0 in
// the padding.
__kernel void loss_forward(__global const real *image,  // in [>= 3, rows, stride]
                           __global const uchar *photo, // in [3 or 4, height, width]
                           int width, int height, int stride, int rows, int channel, real background,
#if SKIP_BLANK
                           int skip,                       // 1: leave out what is blank
                           __global const uint *active_tiles,       // in [tiles] 0: masked or clear
                           __global const uint *tile_start, // in [tiles + 1]
#endif
                           int write_error,
                           __global real *maps,      // out [3, rows, stride], or [2, rows, stride]
                           __global real *partial) { // out [3, strips, 2] sums of |x - y| and SSIM
  const int sx = get_global_id(0), sy = get_global_id(1);
  const int x0 = sx * STRIP, y0 = sy * LOSS_ROWS;
  if (x0 >= stride || y0 >= rows) return;
  const long plane = (long)stride * rows;
  const Images s = {image, photo, plane, (long)width * height, channel, width, height, stride, background};
  const size_t columns = (stride + STRIP - 1) / STRIP, strips = columns * ((rows + LOSS_ROWS - 1) / LOSS_ROWS);
  const size_t strip = channel * strips + sy * columns + sx;
#if SKIP_BLANK
  int active[STRIP / VW];
  flag_active(skip, active_tiles, tile_start, x0, y0, RADIUS, stride, rows, active);
#endif
  realV moments[4][LOSS_ROWS][VECTORS], differences[LOSS_ROWS][VECTORS];
  for (int j = 0; j < VECTORS; j++) {
#if SKIP_BLANK
    if (!in_reach(active, j)) continue;
#endif
    const int x = x0 + (j - HALO) * VW;
    realV a[REACH], b[REACH], squares[REACH], products[REACH], out[LOSS_ROWS];
    for (int r = 0; r < REACH; r++) {
      a[r] = render_at(&s, x, y0 - RADIUS + r);
      b[r] = photo_at(&s, x, y0 - RADIUS + r);
      squares[r] = fma(a[r], a[r], b[r] * b[r]);
      products[r] = a[r] * b[r];
    }
    for (int g = 0; g < LOSS_ROWS; g++) differences[g][j] = fabs(a[g + RADIUS] - b[g + RADIUS]);
    window_columns(a, out);
    for (int g = 0; g < LOSS_ROWS; g++) moments[0][g][j] = out[g];
    window_columns(b, out);
    for (int g = 0; g < LOSS_ROWS; g++) moments[1][g][j] = out[g];
    window_columns(squares, out);
    for (int g = 0; g < LOSS_ROWS; g++) moments[2][g][j] = out[g];
    window_columns(products, out);
    for (int g = 0; g < LOSS_ROWS; g++) moments[3][g][j] = out[g];
  }
  const realV zero = (realV)(R(0.0)), one = (realV)(R(1.0)), third = (realV)(R(1.0) / R(3.0));
  realV l1_sum = zero, ssim_sum = zero;
  for (int g = 0; g < LOSS_ROWS && y0 + g < rows; g++)
    for (int j = 0; j * VW < STRIP && x0 + j * VW < stride; j++) {
      const int x = x0 + j * VW, y = y0 + g;
      const maskV in = inside(x, y < height ? width : 0);
      realV dmx = zero, dxx = zero, dxy = zero, ssim = one, difference = zero;
#if SKIP_BLANK
      if (active[j])
#endif
      {
        ssim = ssim_of(window_row(moments[0][g], j + HALO), window_row(moments[1][g], j + HALO),
                       window_row(moments[2][g], j + HALO), window_row(moments[3][g], j + HALO), &dmx, &dxx, &dxy);
        difference = choose(in, differences[g][j + HALO], zero);
      }
      ssim = choose(in, ssim, zero);
      l1_sum += difference;
      ssim_sum += ssim;
      __global real *at = maps + (size_t)y * stride + x;
      if (write_error) {
        const realV e = (one - ssim) * third, l = difference * third;
        vstore_real(channel == 0 ? e : vload_real(0, at) + e, 0, at);
        vstore_real(channel == 0 ? l : vload_real(0, at + plane) + l, 0, at + plane);
      } else {
        vstore_real(choose(in, dmx, zero), 0, at);
        vstore_real(choose(in, dxx, zero), 0, at + plane);
        vstore_real(choose(in, dxy, zero), 0, at + 2 * plane);
      }
    }
  partial[2 * strip] = lane_total(l1_sum);
  partial[2 * strip + 1] = lane_total(ssim_sum);
}

// Launch: as loss_forward. dL/dx of the channel, zero in the padding.
__kernel void loss_backward(__global const real *image, __global const uchar *photo, // in, as loss_forward
                            int width, int height, int stride, int rows, int channel, real background,
#if SKIP_BLANK
                            int skip,                       // 1: leave out what is blank
                            __global const uint *active_tiles,       // in [tiles] 0: masked or clear
                            __global const uint *tile_start, // in [tiles + 1]
#endif
                            __global const real *maps,   // in [3, rows, stride]
                            real weight_l1,              // (1 - lambda) / (3 width height)
                            real weight_ssim,            // lambda / (3 width height)
                            __global real *dimage) {     // out [3, rows, stride]
  const int x0 = get_global_id(0) * STRIP, y0 = get_global_id(1) * LOSS_ROWS;
  if (x0 >= stride || y0 >= rows) return;
  const long plane = (long)stride * rows;
  const Images s = {image, photo, plane, (long)width * height, channel, width, height, stride, background};
  dimage += channel * plane;
#if SKIP_BLANK
  int active[STRIP / VW];
  flag_active(skip, active_tiles, tile_start, x0, y0, 2 * RADIUS, stride, rows, active);
#endif
  realV windows[3][LOSS_ROWS][VECTORS];
  for (int m = 0; m < 3; m++)
    for (int j = 0; j < VECTORS; j++) {
#if SKIP_BLANK
      if (!in_reach(active, j)) continue;
#endif
      realV in[REACH], out[LOSS_ROWS];
      for (int r = 0; r < REACH; r++) {
        const int x = x0 + (j - HALO) * VW, y = y0 - RADIUS + r; // a vector of a padded row is in it or not
        in[r] = (realV)(R(0.0));
        if (x >= 0 && x < stride && y >= 0 && y < rows) in[r] = vload_real(0, maps + m * plane + (long)y * stride + x);
      }
      window_columns(in, out);
      for (int g = 0; g < LOSS_ROWS; g++) windows[m][g][j] = out[g];
    }
  const realV zero = (realV)(R(0.0)), one = (realV)(R(1.0));
  for (int g = 0; g < LOSS_ROWS && y0 + g < rows; g++)
    for (int j = 0; j * VW < STRIP && x0 + j * VW < stride; j++) {
      const int x = x0 + j * VW, y = y0 + g;
#if SKIP_BLANK
      if (!active[j]) {
        vstore_real(zero, 0, dimage + (size_t)y * stride + x);
        continue;
      }
#endif
      const realV a = render_at(&s, x, y);
      const realV b = photo_at(&s, x, y);
      const realV dssim = window_row(windows[0][g], j + HALO) +
                          fma((realV)(R(2.0)) * a, window_row(windows[1][g], j + HALO), b * window_row(windows[2][g], j + HALO));
      const realV sign = choose(a > b, one, zero) - choose(a < b, one, zero);
#if HAS_MASK
      const realV d = mask_at(&s, x, y) * fma((realV)(weight_l1), sign, -(realV)(weight_ssim)*dssim);
#else
      const realV d = fma((realV)(weight_l1), sign, -(realV)(weight_ssim)*dssim);
#endif
      vstore_real(choose(inside(x, y < height ? width : 0), d, zero), 0, dimage + (size_t)y * stride + x);
    }
}

// Launch: one work-group of TILE x TILE work-items, or one work-item where that is a whole core. Adds the strips in a fixed order. After
// an overflow the value means nothing; the repetition replaces it.
CHUNK_KERNEL void loss_sum(__global const real *partial, uint strips, real scale, // in [strips, 2], 1 / (3 width height)
                       __global real *out, uint slot) { // out [slots, 2] mean |x - y| and mean SSIM
  const uint l = ITEM;
  real l1 = R(0.0), ssim = R(0.0);
  for (uint s = l; s < strips; s += GROUP) {
    l1 += partial[2 * s];
    ssim += partial[2 * s + 1];
  }
#if GROUP_STYLE
  __local real part[2][GROUP];
  part[0][l] = l1;
  part[1][l] = ssim;
  for (uint near = GROUP / 2; near > 0; near /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    if (l < near) {
      part[0][l] += part[0][l + near];
      part[1][l] += part[1][l + near];
    }
  }
  l1 = part[0][l];
  ssim = part[1][l];
#endif
  if (l != 0) return;
  out[2 * slot] = l1 * scale;
  out[2 * slot + 1] = ssim * scale;
}
