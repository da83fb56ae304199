// flip: LDR-FLIP (Andersson et al. 2020; section numbers are the paper's) of a clamped render against its photo, 0 to 1 per pixel, with
// the photo's alpha and mask as in metrics. Pictures are worked on by strips of rows, which bound what lies between three launches: both
// pictures in the linear opponent space YCxCz (flip_opponent), seven filters along the rows of each (flip_rows), the same down the
// columns with the errors and their sum over each row (flip_columns). All filters are sums of products of one-dimensional ones. Beyond
// the border the nearest pixel goes on. Launch of each: one work-group per row, or one work-item where that is a whole core; the sums are
// in a fixed order. A pixel that is not finite makes sums that are not.
#include "chunks.clh"
#include "lanes.clh"

// Filters of 2 FLIP_REACH + 1 weights: Y, Cx and twice Cz as the eye resolves them (4.1), smooth, edge, point (4.2).
#define FILTERS 7
#define FLIP_TAPS (2 * FLIP_REACH + 1)
#define BLUR_Y 0
#define BLUR_CX 1
#define BLUR_CZ 2
#define BLUR_CZ_NARROW 3
#define SMOOTH 4
#define EDGE 5
#define POINT 6
// After the filters: XYZ relative to white of linear sRGB, its inverse, and the largest difference of colours to FLIP_POWER.
#define TO_RELATIVE (FILTERS * FLIP_TAPS)
#define FROM_RELATIVE (TO_RELATIVE + 9)
#define LARGEST (FROM_RELATIVE + 9)
#define TABLE_ARGUMENT __global const real *table // in [FILTERS, FLIP_TAPS], [3, 3], [3, 3], [1]

static inline void transform(__global const real *m, const realV v[3], realV out[3]) {
  for (int r = 0; r < 3; r++) out[r] = fma(V(m[3 * r]), v[0], fma(V(m[3 * r + 1]), v[1], V(m[3 * r + 2]) * v[2]));
}

// x to the power of p > 0 for x >= 0, 0 for 0; no number if either is none.
static inline realV power(realV x, realV p) {
  const realV zero = V(R(0.0));
  return choose(x <= zero, zero * p, exp2(p * log2(x)));
}

// YCxCz of sRGB in [0, 1].
static inline void opponent_of(__global const real *table, const realV srgb[3], realV out[3]) {
  realV rgb[3], xyz[3];
  for (int c = 0; c < 3; c++) {
    const realV v = srgb[c];
    rgb[c] = choose(v <= V(R(0.04045)), v / R(12.92), power((v + R(0.055)) / R(1.055), V(R(2.4))));
  }
  transform(table + TO_RELATIVE, rgb, xyz);
  out[0] = R(116.0) * xyz[1] - R(16.0);
  out[1] = R(500.0) * (xyz[0] - xyz[1]);
  out[2] = R(200.0) * (xyz[1] - xyz[2]);
}

// CIELAB of YCxCz that is clamped to what a screen can show, a and b weakened in the dark as Hunt found (4.1.2).
static inline void hunt_lab(__global const real *table, const realV opponent[3], realV lab[3]) {
  const real knee = R(6.0) / R(29.0);
  const realV y = (opponent[0] + R(16.0)) / R(116.0);
  const realV relative[3] = {opponent[1] / R(500.0) + y, y, y - opponent[2] / R(200.0)};
  realV rgb[3], t[3];
  transform(table + FROM_RELATIVE, relative, rgb);
  for (int c = 0; c < 3; c++) rgb[c] = clamp(rgb[c], V(R(0.0)), V(R(1.0)));
  transform(table + TO_RELATIVE, rgb, t);
  for (int c = 0; c < 3; c++)
    t[c] = choose(t[c] > V(knee * knee * knee), cbrt(t[c]), t[c] / (R(3.0) * knee * knee) + R(4.0) / R(29.0));
  lab[0] = R(116.0) * t[1] - R(16.0);
  const realV weight = R(0.01) * lab[0];
  lab[1] = weight * (R(500.0) * (t[0] - t[1]));
  lab[2] = weight * (R(200.0) * (t[1] - t[2]));
}

CHUNK_KERNEL void flip_opponent(__global const real *image,  // in [>= 3, rows, stride] clamped to [0, 1]
                                __global const uchar *photo, // in [3 or 4, height, width]
                                int width, int height, int stride, int rows, real bg_red, real bg_green, real bg_blue,
                                int top,              // first row of the strip
                                int held, int across, // rows and columns with FLIP_REACH more on every side
                                TABLE_ARGUMENT,
                                __global real *opponents) { // out [2, 3, held, across] render, photo
  const int row = CHUNK, y = clamp(top + row - FLIP_REACH, 0, height - 1);
  const size_t plane = (size_t)stride * rows, pixels = (size_t)width * height;
  for (int i = ITEM * VW; i < across; i += GROUP * VW) {
    real lanes[2][3][VW];
    for (int l = 0; l < VW; l++) {
      const int x = clamp(i + l - FLIP_REACH, 0, width - 1);
      const size_t at = (size_t)y * stride + x, from = (size_t)y * width + x;
#if HAS_MASK || HAS_ALPHA
      const real fourth = (real)photo[3 * pixels + from] / R(255.0);
#endif
      for (int c = 0; c < 3; c++) {
        real render = image[c * plane + at], p = (real)photo[c * pixels + from] / R(255.0);
#if HAS_MASK
        render *= fourth;
#elif HAS_ALPHA
        p += (R(1.0) - fourth) * (c == 0 ? bg_red : c == 1 ? bg_green : bg_blue);
#endif
        lanes[0][c][l] = render;
        lanes[1][c][l] = p;
      }
    }
    for (int picture = 0; picture < 2; picture++) {
      realV srgb[3], out[3];
      for (int c = 0; c < 3; c++) srgb[c] = vload_real(0, lanes[picture][c]);
      opponent_of(table, srgb, out);
      for (int c = 0; c < 3; c++)
        vstore_real(out[c], 0, opponents + ((size_t)(3 * picture + c) * held + row) * across + i);
    }
  }
}

CHUNK_KERNEL void flip_rows(__global const real *opponents, // in [2, 3, held, across]
                            int width, int stride, int held, int across,
                            TABLE_ARGUMENT,
                            __global real *filtered) { // out [2, FILTERS, held, stride]
  const int row = CHUNK;
  for (int picture = 0; picture < 2; picture++) {
    const size_t plane = (size_t)held * across;
    __global const real *from = opponents + 3 * picture * plane + (size_t)row * across;
    for (int x = ITEM * VW; x < width; x += GROUP * VW) {
      realV sums[FILTERS];
      for (int f = 0; f < FILTERS; f++) sums[f] = V(R(0.0));
      // The weights of EDGE and POINT cancel: of differences nothing is left where a picture is the same everywhere, for a root to magnify.
      const realV center = vload_real(0, from + x + FLIP_REACH);
      for (int k = 0; k < FLIP_TAPS; k++) {
        const realV y = vload_real(0, from + x + k), cx = vload_real(0, from + plane + x + k), cz = vload_real(0, from + 2 * plane + x + k);
        __global const real *tap = table + k;
        sums[BLUR_Y] = fma(V(tap[BLUR_Y * FLIP_TAPS]), y, sums[BLUR_Y]);
        sums[BLUR_CX] = fma(V(tap[BLUR_CX * FLIP_TAPS]), cx, sums[BLUR_CX]);
        sums[BLUR_CZ] = fma(V(tap[BLUR_CZ * FLIP_TAPS]), cz, sums[BLUR_CZ]);
        sums[BLUR_CZ_NARROW] = fma(V(tap[BLUR_CZ_NARROW * FLIP_TAPS]), cz, sums[BLUR_CZ_NARROW]);
        sums[SMOOTH] = fma(V(tap[SMOOTH * FLIP_TAPS]), y, sums[SMOOTH]);
        sums[EDGE] = fma(V(tap[EDGE * FLIP_TAPS]), y - center, sums[EDGE]);
        sums[POINT] = fma(V(tap[POINT * FLIP_TAPS]), y - center, sums[POINT]);
      }
      for (int f = 0; f < FILTERS; f++)
        vstore_real(sums[f], 0, filtered + ((size_t)(FILTERS * picture + f) * held + row) * stride + x);
    }
  }
}

// Colour as the eye resolves it, and strengths of edges and points, of a pixel of a row of the strip.
static inline void columns_of(__global const real *filtered, __global const real *table, int picture, int row, int x, int held, int stride,
                              realV lab[3], realV features[2]) {
  realV opponent[3], across[2], down[2];
  for (int c = 0; c < 3; c++) opponent[c] = V(R(0.0));
  for (int f = 0; f < 2; f++) across[f] = down[f] = V(R(0.0));
  const size_t plane = (size_t)held * stride;
  __global const real *from = filtered + FILTERS * picture * plane + (size_t)row * stride + x;
  const realV center = vload_real(0, from + SMOOTH * plane + FLIP_REACH * (size_t)stride);
  for (int k = 0; k < FLIP_TAPS; k++, from += stride) {
    __global const real *tap = table + k;
    const realV smoothed = vload_real(0, from + SMOOTH * plane), weight = V(tap[SMOOTH * FLIP_TAPS]);
    opponent[0] = fma(V(tap[BLUR_Y * FLIP_TAPS]), vload_real(0, from + BLUR_Y * plane), opponent[0]);
    opponent[1] = fma(V(tap[BLUR_CX * FLIP_TAPS]), vload_real(0, from + BLUR_CX * plane), opponent[1]);
    opponent[2] = fma(V(tap[BLUR_CZ * FLIP_TAPS]), vload_real(0, from + BLUR_CZ * plane), opponent[2]);
    opponent[2] = fma(V(tap[BLUR_CZ_NARROW * FLIP_TAPS]), vload_real(0, from + BLUR_CZ_NARROW * plane), opponent[2]);
    across[0] = fma(weight, vload_real(0, from + EDGE * plane), across[0]);
    across[1] = fma(weight, vload_real(0, from + POINT * plane), across[1]);
    down[0] = fma(V(tap[EDGE * FLIP_TAPS]), smoothed - center, down[0]);
    down[1] = fma(V(tap[POINT * FLIP_TAPS]), smoothed - center, down[1]);
  }
  hunt_lab(table, opponent, lab);
  // The achromatic channel from 0 to 1.
  for (int f = 0; f < 2; f++) features[f] = sqrt(fma(across[f], across[f], down[f] * down[f])) / R(116.0);
}

CHUNK_KERNEL void flip_columns(__global const real *filtered, // in [2, FILTERS, held, stride]
                               __global const uchar *photo,   // in [3 or 4, height, width]
                               int width, int height, int stride, int top, int held,
                               TABLE_ARGUMENT,
                               __global real *errors) { // out [height] sum over the row, of pixels as far as they count
  PARTS;
  const int row = CHUNK, y = top + row;
  // Compression of differences of colours (4.1.3): the point where it becomes a straight line.
  const real largest = table[LARGEST], knee = FLIP_KNEE_AT * largest;
  const real slope = FLIP_KNEE_TO / knee, beyond = (R(1.0) - FLIP_KNEE_TO) / (largest - knee);
  real sum = R(0.0);
  for (int x = ITEM * VW; x < width; x += GROUP * VW) {
    realV lab[2][3], features[2][2];
    for (int picture = 0; picture < 2; picture++)
      columns_of(filtered, table, picture, row, x, held, stride, lab[picture], features[picture]);
    // HyAB (Abasi et al. 2020).
    const realV lightness = fabs(lab[0][0] - lab[1][0]), a = lab[0][1] - lab[1][1], b = lab[0][2] - lab[1][2];
    const realV difference = power(lightness + sqrt(fma(a, a, b * b)), V(FLIP_POWER));
    const realV color = choose(difference < V(knee), difference * slope, FLIP_KNEE_TO + (difference - knee) * beyond);
    const realV edges = fabs(features[0][0] - features[1][0]), points = fabs(features[0][1] - features[1][1]);
    const realV feature = sqrt(R(0.7071067811865476) * fmax(edges, points));
    real error[VW];
    vstore_real(power(color, R(1.0) - feature), 0, error);
    for (int l = 0; l < min(VW, width - x); l++) {
#if HAS_MASK
      const real counts = (real)photo[3 * (size_t)width * height + (size_t)y * width + x + l] / R(255.0);
      sum = fma(counts, error[l], sum);
#else
      sum += error[l];
#endif
    }
  }
  const real2 total = group_total((real2)(sum, R(0.0)), parts);
  if (ITEM == 0) errors[y] = total.x;
}
