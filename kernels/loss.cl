// loss: L = (1 - lambda) mean|x - y| + lambda (1 - mean SSIM) and dL/dx, by two sweeps of separable 11-tap windows
// (sigma 1.5, zero padding), on CPUs one channel after the other so that the maps between the sweeps stay in cache. Both images
// are shifted by SHIFT = 1/2, padding included, which leaves variances and covariances as they are and keeps
// E[x^2] - E[x]^2 from cancelling on flat images. Columns are windowed first, then rows. On CPUs a work-item takes a strip
// of STRIP columns by LOSS_ROWS rows and has the windows in private arrays (2 RADIUS + LOSS_ROWS rows serve LOSS_ROWS sums, in
// registers); on GPUs a work-group takes two tiles side by side and has them in local memory. Windows add in the same order in both: maps
// and gradients are the same to the bit. With SKIP_BLANK vectors, or pairs of tiles, are left out whose windows see only tiles that are
// masked, or clear in the photo and without pairs in the render: render and photo are the same there, the derivatives of SSIM
// with respect to x, x^2 and x y cancel, and zeros in the maps are right for neighbours. Pixels of other tiles have the same
// gradient, to the bit. Source: [MH] Eq. 4; SSIM of Wang et al. 2004; gradient through three maps as in fused-ssim.
#include "ahead.clh"
#include "chunks.clh"
#include "lanes.clh"

#define RADIUS (TAPS / 2)
#if GROUP_STYLE
#define PART_WIDTH (2 * TILE) // columns and rows that are left out together
#define PART_HEIGHT TILE
#else
#define PART_WIDTH VW
#define PART_HEIGHT LOSS_ROWS
#endif
#define SHIFT R(0.5)
__constant real WINDOW[TAPS] = SSIM_WINDOW;

// All ones in lanes that lie inside of the image.
static inline maskV inside(int x, int width) {
  const realV at = LANES + (realV)((real)x);
  return (at >= (realV)(R(0.0))) & (at < (realV)((real)width));
}

// VW values of row y from column x on, 0 outside of the image. Vectors that stick out are loaded whole and masked,
// unless that would leave the array of `length` values; a single value never sticks out.
#if VW == 1
#define LOAD_AT(name, type, load)                                                                                  \
  static inline realV name(__global const type *image, long length, long row, int x, int width) {                \
    return x >= 0 && x < width ? (real)image[row + x] : R(0.0);                                                    \
  }
#else
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
#endif
#define REALS(p) vload_real(0, p)
LOAD_AT(reals_at, real, REALS)
LOAD_AT(bytes_at, uchar, bytes_to_real)

// A render and its photo.
typedef struct {
  __global const real *image;  // [>= 3, rows, stride]
  __global const uchar *photo; // [3 or 4, photo_rows, width]: rows of the photo from photo_first on
  long plane, pixels;
  int channel, width, height, photo_first, photo_rows, stride;
  real background;
} Images;

// v / 255 to the last bit without a division, so that a render that equals its photo has no gradient.
static inline realV over_255(realV v) {
  const realV r = (realV)(R(1.0) / R(255.0)), q = v * r;
  return fma(fma((realV)(-R(255.0)), q, v), r, q);
}

#if HAS_MASK
// How far pixels of row y from column x on count; 0 outside of the image and of the rows of the photo that there are.
static inline realV mask_at(const Images *s, int x, int y) {
  const int row = y - s->photo_first;
  if (row < 0 || row >= s->photo_rows) return (realV)(R(0.0));
  return over_255(bytes_at(s->photo, 4 * s->pixels, 3 * s->pixels + (long)row * s->width, x, s->width));
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

// The photo's counterpart: premultiplied colour plus (1 - alpha) of the background when there is an alpha plane. Rows that the array
// lacks are as those outside of the image: no gradient or sum of a band depends on them.
static inline realV photo_at(const Images *s, int x, int y) {
  const int held = y - s->photo_first;
  if (held < 0 || held >= s->photo_rows) return (realV)(-SHIFT);
  const long length = (3 + (HAS_ALPHA || HAS_MASK)) * s->pixels, row = (long)held * s->width;
  realV v = over_255(bytes_at(s->photo, length, s->channel * s->pixels + row, x, s->width));
#if HAS_ALPHA
  const realV a = over_255(bytes_at(s->photo, length, 3 * s->pixels + row, x, s->width));
  v += choose(inside(x, s->width), (realV)(R(1.0)) - a, (realV)(R(0.0))) * s->background;
#endif
  return v - SHIFT;
}

#if SKIP_BLANK
// Whether any tile within `margin` pixels of PART_WIDTH columns from x on, PART_HEIGHT rows from y on, may have a render that
// differs from the photo: one that is active or, but for masks, has pairs.
static inline int may_differ(__global const uint *active_tiles, __global const uint *tile_start, int x, int y, int margin, int stride, int rows) {
  const int across = stride / TILE, first = max(x - margin, 0) / TILE, last = min(x + PART_WIDTH - 1 + margin, stride - 1) / TILE;
  for (int ty = max(y - margin, 0) / TILE; ty <= min(y + PART_HEIGHT - 1 + margin, rows - 1) / TILE; ty++)
    for (int tile = ty * across + first; tile <= ty * across + last; tile++)
#if HAS_MASK
      if (active_tiles[tile]) return 1;
#else
      if (active_tiles[tile] || tile_start[tile + 1] != tile_start[tile]) return 1;
#endif
  return 0;
}
#endif

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

// dL/dx of VW pixels of row y from column x on, inside of the image; dmx, dxx and dxy are the maps' windows there.
static inline realV gradient_of(const Images *s, int x, int y, realV dmx, realV dxx, realV dxy, real weight_l1, real weight_ssim) {
  const realV zero = (realV)(R(0.0)), one = (realV)(R(1.0));
  const realV a = render_at(s, x, y);
  const realV b = photo_at(s, x, y);
  const realV dssim = dmx + fma((realV)(R(2.0)) * a, dxx, b * dxy);
  const realV sign = choose(a > b, one, zero) - choose(a < b, one, zero);
  const realV d = fma((realV)(weight_l1), sign, -(realV)(weight_ssim)*dssim);
#if HAS_MASK
  return mask_at(s, x, y) * d;
#else
  return d;
#endif
}

// Arguments of the kernels, of either style: render and photo, what is left out of them, and what is written.
#if SKIP_BLANK
// 1: leave out what is blank; [tiles] 0: masked or clear; [tiles + 1]
#define BLANK_ARGUMENTS int skip, __global const uint *active_tiles, __global const uint *tile_start,
#define IS_ACTIVE(part, margin) (!skip || may_differ(active_tiles, tile_start, (part).x, (part).y, margin, stride, rows))
#else
#define BLANK_ARGUMENTS
#define IS_ACTIVE(part, margin) 1
#endif
// in [>= 3, rows, stride], [3 or 4, photo_rows, width]: rows of the photo from photo_first on
#define IMAGE_ARGUMENTS                                                                                                \
  __global const real *image, __global const uchar *photo, int width, int height, int photo_first, int photo_rows,     \
      int stride, int rows, int first, real red, real green, real blue, BLANK_ARGUMENTS
// A channel of both images.
#define IMAGES(channel)                                                                                                \
  {image, photo, (long)stride * rows, (long)width * photo_rows, channel, width, height, photo_first, photo_rows, stride, BACKGROUND(channel)}
// A launch is over channel `first`, or by groups, where `first` is 0, over all along the second axis.
#if GROUP_STYLE
#define CHANNEL (first + (int)get_group_id(1))
#else
#define CHANNEL first
#endif
#define BACKGROUND(channel) ((channel) == 0 ? red : (channel) == 1 ? green : blue)
// out [3, rows, stride], or [2, rows, stride] of errors (by groups [3, 3, rows, stride]); [3, strips or parts, 2] sums of |x - y| and SSIM
#define FORWARD_ARGUMENTS IMAGE_ARGUMENTS __global real *maps, __global real *partial
// in [3, rows, stride] (by groups [3, 3, rows, stride]), (1 - lambda) / (3 width height), lambda / (3 width height); out [3, rows, stride]
#define BACKWARD_ARGUMENTS IMAGE_ARGUMENTS __global const real *maps, real weight_l1, real weight_ssim, __global real *dimage

// Adds the sums of all strips, or parts, in a fixed order, by a whole work-group or by a work-item that is a whole core.
static inline void add_strips(__global const real *partial, uint strips, real scale, // in [strips, 2], 1 / (3 width height)
                              __global real *out, uint slot                          // out [slots, 2] mean |x - y| and mean SSIM
#if GROUP_STYLE
                              , __local real2 *parts
#endif
) {
  real l1 = R(0.0), ssim = R(0.0);
  for (uint s = ITEM; s < strips; s += GROUP) {
    l1 += partial[2 * s];
    ssim += partial[2 * s + 1];
  }
  const real2 total = group_total((real2)(l1, ssim), parts);
  if (ITEM != 0) return;
  out[2 * slot] = total.x * scale;
  out[2 * slot + 1] = total.y * scale;
}

#if !GROUP_STYLE
#define REACH (LOSS_ROWS + 2 * RADIUS)    // rows that windows of LOSS_ROWS rows see
#define HALO ((RADIUS + VW - 1) / VW) // vectors that a strip needs on either side; loads stay aligned
#define VECTORS (STRIP / VW + 2 * HALO)
// Those of the strip from column x0 on: the last one of a row may be short.
#define VECTORS_OF(x0) min(VECTORS, (stride - (x0)) / VW + 2 * HALO)

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

#if SKIP_BLANK
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
#pragma unroll
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

// Launch: one work-item per strip (columns x groups of rows). With write_error the maps hold the channel means of
// 1 - SSIM (plane 0) and |x - y| (plane 1), added up from channel 0 on; otherwise the channel's derivative maps, 0 in
// the padding. Longer than a function should be, because the windows stay in registers.
CHUNK_KERNEL void loss_forward(FORWARD_ARGUMENTS, int write_error) {
  const int sx = get_global_id(0), sy = get_global_id(1);
  const int x0 = sx * STRIP, y0 = sy * LOSS_ROWS;
  if (x0 >= stride || y0 >= rows) return;
  const long plane = (long)stride * rows;
  const int channel = CHANNEL;
  const Images s = IMAGES(channel);
  const size_t columns = (stride + STRIP - 1) / STRIP, strips = columns * ((rows + LOSS_ROWS - 1) / LOSS_ROWS);
  const size_t strip = channel * strips + sy * columns + sx;
#if SKIP_BLANK
  int active[STRIP / VW];
  flag_active(skip, active_tiles, tile_start, x0, y0, RADIUS, stride, rows, active);
#endif
  realV moments[4][LOSS_ROWS][VECTORS], differences[LOSS_ROWS][VECTORS];
  const int vectors = VECTORS_OF(x0);
  for (int j = 0; j < vectors; j++) {
#if SKIP_BLANK
    if (!in_reach(active, j)) continue;
#endif
    const int x = x0 + (j - HALO) * VW;
    // Rows that the strip above has not read.
    for (int r = 2 * RADIUS; r < REACH; r++)
      ASK_FOR(image + channel * plane + (long)(y0 - RADIUS + r) * stride + x + ROW_LINES_AHEAD * (int)LINE);
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
CHUNK_KERNEL void loss_backward(BACKWARD_ARGUMENTS) {
  const int x0 = get_global_id(0) * STRIP, y0 = get_global_id(1) * LOSS_ROWS;
  if (x0 >= stride || y0 >= rows) return;
  const long plane = (long)stride * rows;
  const int channel = CHANNEL;
  const Images s = IMAGES(channel);
  dimage += channel * plane;
#if SKIP_BLANK
  int active[STRIP / VW];
  flag_active(skip, active_tiles, tile_start, x0, y0, 2 * RADIUS, stride, rows, active);
#endif
  const int vectors = VECTORS_OF(x0);
  realV windows[3][LOSS_ROWS][VECTORS];
  for (int m = 0; m < 3; m++)
    for (int j = 0; j < vectors; j++) {
#if SKIP_BLANK
      if (!in_reach(active, j)) continue;
#endif
      for (int r = 2 * RADIUS; r < REACH; r++)
        ASK_FOR(maps + m * plane + (long)(y0 - RADIUS + r) * stride + x0 + (j - HALO) * VW + ROW_LINES_AHEAD * (int)LINE);
      realV in[REACH], out[LOSS_ROWS];
      for (int r = 0; r < REACH; r++) {
        const int x = x0 + (j - HALO) * VW, y = y0 - RADIUS + r; // a vector of a padded row is in it or not
        in[r] = (realV)(R(0.0));
        if (x >= 0 && x < stride && y >= 0 && y < rows) in[r] = vload_real(0, maps + m * plane + (long)y * stride + x);
      }
      window_columns(in, out);
      for (int g = 0; g < LOSS_ROWS; g++) windows[m][g][j] = out[g];
    }
  const realV zero = (realV)(R(0.0));
  for (int g = 0; g < LOSS_ROWS && y0 + g < rows; g++)
    for (int j = 0; j * VW < STRIP && x0 + j * VW < stride; j++) {
      const int x = x0 + j * VW, y = y0 + g;
#if SKIP_BLANK
      if (!active[j]) {
        vstore_real(zero, 0, dimage + (size_t)y * stride + x);
        continue;
      }
#endif
      const realV d = gradient_of(&s, x, y, window_row(windows[0][g], j + HALO), window_row(windows[1][g], j + HALO),
                                  window_row(windows[2][g], j + HALO), weight_l1, weight_ssim);
      vstore_real(choose(inside(x, y < height ? width : 0), d, zero), 0, dimage + (size_t)y * stride + x);
    }
}

#else
#define WIDE (PART_WIDTH + 2 * RADIUS)  // columns and rows of a part with its halo
#define HIGH (PART_HEIGHT + 2 * RADIUS)
#define RUN 4                           // rows whose vertical windows a work-item makes
#define SEEN (RUN + 2 * RADIUS)         // rows that those see
#define LINES (GROUP / WIDE)             // rows with their halo that a group stages at a time; the work-items left over wait
#define PIXELS (PART_WIDTH * PART_HEIGHT / GROUP)
#define ROW_STEP (PART_HEIGHT / PIXELS) // between the rows of a work-item's pixels
// Place of the windows of a part's pixel among those of the part, which has a halo of columns.
#define WINDOW_AT(row, column) ((row) * WIDE + (column) + RADIUS)

// A work-item makes the vertical windows of RUN rows of a column; those without wait.
#define HAS_RUN (get_local_id(0) < WIDE * (PART_HEIGHT / RUN))
#define RUN_COLUMN ((int)get_local_id(0) % WIDE)
#define RUN_FIRST ((int)get_local_id(0) / WIDE * RUN)

// Vertical windows of one quantity, added in the order of window_columns in the other style.
static inline void window_run(const real v[SEEN], real out[RUN]) {
  const real weights[TAPS] = SSIM_WINDOW;
#pragma unroll
  for (int g = 0; g < RUN; g++) {
    real sum = weights[RADIUS] * v[g + RADIUS];
#pragma unroll
    for (int k = 0; k < RADIUS; k++) sum = fma(weights[k], v[g + k] + v[g + 2 * RADIUS - k], sum);
    out[g] = sum;
  }
}

// Puts a run's windows into their places, when nobody needs what was there.
static inline void put_run(const real4 sums[RUN], __local real4 *windows) {
  if (!HAS_RUN) return;
  for (int g = 0; g < RUN; g++) windows[(RUN_FIRST + g) * WIDE + RUN_COLUMN] = sums[g];
}

// Horizontal windows around at[0], four at a time; added in the order of window_row.
static inline real4 window_line(__local const real4 *at) {
  const real weights[TAPS] = SSIM_WINDOW;
  real4 sum = (real4)(weights[RADIUS]) * at[0];
#pragma unroll
  for (int k = 1; k <= RADIUS; k++) sum = fma((real4)(weights[RADIUS - k]), at[-k] + at[k], sum);
  return sum;
}

// Render and photo of a part with its halo, by the whole group.
static inline void stage_images(const Images *s, int part_x, int part_y, __local real2 *staged) {
  const int column = get_local_id(0) % WIDE, x = part_x - RADIUS + column;
  if (get_local_id(0) >= LINES * WIDE) return;
  for (int row = get_local_id(0) / WIDE; row < HIGH; row += LINES) {
    const int y = part_y - RADIUS + row;
    staged[row * WIDE + column] = (real2)(render_at(s, x, y), photo_at(s, x, y));
  }
}

// Vertical windows of x, y, x^2 + y^2 and x y, of which SSIM is made.
static inline void window_moments(__local const real2 *staged, real4 sums[RUN]) {
  if (!HAS_RUN) return;
  real a[SEEN], b[SEEN], squares[SEEN], products[SEEN], out[4][RUN];
#pragma unroll
  for (int r = 0; r < SEEN; r++) {
    const real2 pair = staged[(RUN_FIRST + r) * WIDE + RUN_COLUMN];
    a[r] = pair.x;
    b[r] = pair.y;
    squares[r] = fma(a[r], a[r], b[r] * b[r]);
    products[r] = a[r] * b[r];
  }
  window_run(a, out[0]);
  window_run(b, out[1]);
  window_run(squares, out[2]);
  window_run(products, out[3]);
  for (int g = 0; g < RUN; g++) sums[g] = (real4)(out[0][g], out[1][g], out[2][g], out[3][g]);
}

// A group's two tiles side by side, and a work-item's place in them.
typedef struct {
  uint index, of;   // among so many parts
  int x, y;         // first column and row of the part
  int column, row;  // of the work-item's first pixel in it; the others are ROW_STEP rows further each
} Part;

static inline Part own_part(int stride, int rows) {
  const uint index = get_global_id(0) / GROUP, l = get_local_id(0), across = (stride + PART_WIDTH - 1) / PART_WIDTH;
  const Part part = {index, across * (rows / PART_HEIGHT), index % across * PART_WIDTH, index / across * PART_HEIGHT, l % PART_WIDTH, l / PART_WIDTH};
  return part;
}

// |x - y| of a work-item's pixels, and in `room`, which was free, the vertical windows that SSIM is made of: everybody of the group comes
// here. Of a part that is not active nothing is written.
static inline void compare(const Images *s, const Part *part, int active, __local real4 room[PART_HEIGHT * WIDE], real difference[PIXELS]) {
  __local real2 *staged = (__local real2 *)room; // until the vertical windows are made
  real4 sums[RUN];
  if (active) stage_images(s, part->x, part->y, staged);
  barrier(CLK_LOCAL_MEM_FENCE);
  if (active) {
    for (int k = 0; k < PIXELS; k++) {
      const real2 pair = staged[WINDOW_AT(part->row + k * ROW_STEP + RADIUS, part->column)];
      difference[k] = fabs(pair.x - pair.y);
    }
    window_moments(staged, sums);
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  if (active) put_run(sums, room);
  barrier(CLK_LOCAL_MEM_FENCE);
}

// Launch: one work-group of TILE x TILE work-items per two tiles side by side and channel. Results as in the other style, but that
// `partial` has the sums of these parts, that each channel has derivative maps of its own, and that errors may be wanted beside them: a
// third of them for each channel, so that their sums over the channels are what the other style writes. Work-items of the padding and of
// parts that are left out take part in every barrier.
CHUNK_KERNEL void loss_forward(FORWARD_ARGUMENTS, __global real *errors, int wanted) { // out [3, 2, rows, stride] thirds of 1 - SSIM, |x - y|
  const int channel = CHANNEL;
  const Images s = IMAGES(channel);
  const Part part = own_part(stride, rows);
  const int active = IS_ACTIVE(part, RADIUS), x = part.x + part.column;
  __local real4 room[PART_HEIGHT * WIDE];
  real difference[PIXELS];
  compare(&s, &part, active, room, difference);
  real2 total = (real2)(R(0.0));
#pragma unroll
  for (int k = 0; k < PIXELS; k++) {
    const int y = part.y + part.row + k * ROW_STEP;
    real d = R(0.0), ssim = R(1.0), dmx = R(0.0), dxx = R(0.0), dxy = R(0.0);
    if (active) {
      const real4 m = window_line(room + WINDOW_AT(part.row + k * ROW_STEP, part.column));
      ssim = ssim_of(m.s0, m.s1, m.s2, m.s3, &dmx, &dxx, &dxy);
      d = difference[k];
    }
    if (x >= width || y >= height) d = ssim = dmx = dxx = dxy = R(0.0);
    total += (real2)(d, ssim);
    if (x >= stride) continue;
    const size_t at = (size_t)y * stride + x;
    if (wanted & LOSS_DERIVATIVES) {
      __global real *to = maps + 3 * channel * s.plane + at;
      to[0] = dmx;
      to[s.plane] = dxx;
      to[2 * s.plane] = dxy;
    }
    if (wanted & LOSS_ERRORS) {
      __global real *to = errors + 2 * channel * s.plane + at;
      to[0] = (R(1.0) - ssim) * (R(1.0) / R(3.0));
      to[s.plane] = d * (R(1.0) / R(3.0));
    }
  }
  barrier(CLK_LOCAL_MEM_FENCE); // nobody needs the windows any more: their place is free for the sums
  total = group_total(total, (__local real2 *)room);
  if (part.column == 0 && part.row == 0) vstore2(total, (size_t)channel * part.of + part.index, partial);
}

// The derivative maps of a part with its halo, by the whole group; 0 beyond the padding.
static inline void stage_maps(__global const real *maps, int part_x, int part_y, int stride, int rows, __local real *staged) {
  const int column = get_local_id(0) % WIDE, x = part_x - RADIUS + column;
  if (get_local_id(0) >= LINES * WIDE) return;
  for (int row = get_local_id(0) / WIDE; row < HIGH; row += LINES) {
    const int y = part_y - RADIUS + row, in = x >= 0 && x < stride && y >= 0 && y < rows;
    __global const real *at = maps + (long)y * stride + x;
#pragma unroll
    for (int m = 0; m < 3; m++) staged[(m * HIGH + row) * WIDE + column] = in ? at[m * (long)stride * rows] : R(0.0);
  }
}

// Their vertical windows; a fourth value pads them, so that one load fetches a pixel's.
static inline void window_maps(__local const real *staged, real4 sums[RUN]) {
  if (!HAS_RUN) return;
  real out[3][RUN];
#pragma unroll
  for (int m = 0; m < 3; m++) {
    real v[SEEN];
#pragma unroll
    for (int r = 0; r < SEEN; r++) v[r] = staged[(m * HIGH + RUN_FIRST + r) * WIDE + RUN_COLUMN];
    window_run(v, out[m]);
  }
  for (int g = 0; g < RUN; g++) sums[g] = (real4)(out[0][g], out[1][g], out[2][g], R(0.0));
}

// Launch: as loss_forward, with one part more if the loss is to be recorded: its first channel's group adds up the sums of the parts.
// dL/dx of the channel, zero in the padding.
CHUNK_KERNEL void loss_backward(BACKWARD_ARGUMENTS, __global const real *partial, real scale, __global real *losses, uint slot) { // as add_strips
  const int channel = CHANNEL;
  const Images s = IMAGES(channel);
  const Part part = own_part(stride, rows);
  // For the maps until the vertical windows are made, and then for those: the maps take more room.
  __local real4 room[(3 * HIGH * WIDE + 3) / 4];
  if (part.index == part.of) {
    if (channel == 0) add_strips(partial, 3 * part.of, scale, losses, slot, (__local real2 *)room);
    return;
  }
  const int active = IS_ACTIVE(part, 2 * RADIUS), x = part.x + part.column;
  real4 sums[RUN];
  if (active) stage_maps(maps + 3 * channel * s.plane, part.x, part.y, stride, rows, (__local real *)room);
  barrier(CLK_LOCAL_MEM_FENCE);
  if (active) window_maps((__local const real *)room, sums);
  barrier(CLK_LOCAL_MEM_FENCE);
  if (active) put_run(sums, room);
  barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
  for (int k = 0; k < PIXELS; k++) {
    const int row = part.row + k * ROW_STEP, y = part.y + row;
    real d = R(0.0);
    if (active && x < width && y < height) {
      const real4 m = window_line(room + WINDOW_AT(row, part.column));
      d = gradient_of(&s, x, y, m.s0, m.s1, m.s2, weight_l1, weight_ssim);
    }
    if (x < stride) dimage[channel * s.plane + (size_t)y * stride + x] = d;
  }
}
#endif

// Launch: one work-group of TILE x TILE work-items, or one work-item where that is a whole core. After an overflow the value means
// nothing; the repetition replaces it.
CHUNK_KERNEL void loss_sum(__global const real *partial, uint strips, real scale, __global real *out, uint slot) { // as add_strips
#if GROUP_STYLE
  PARTS;
  add_strips(partial, strips, scale, out, slot, parts);
#else
  add_strips(partial, strips, scale, out, slot);
#endif
}
