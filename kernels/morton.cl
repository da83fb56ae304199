// morton: the order of the Gaussians by layers from the top, and in each along the Z curve over the bounding box of all, without those that are
// to be removed. Codes of 61 bits: the layer, and 18 bits an axis; a cell is trunc((x - low) * (cells / extent)) in f64, whose roundings are made
// here with integers: many GPUs have no f64, and the same scene has the same order on every device. Source: Morton 1966.
// A pass is morton_box, morton_cells, morton_keys, morton_remove, a sort of the low halves, morton_high, a sort of the high halves.
#include "chunks.clh"

#define CELLS ((1ul << MORTON_BITS) - 1)
// Numbers of the grid are four to an axis: bits of the lowest coordinate; high and low half of the significand of cells per unit, 0
// for an axis without extent; its exponent.

// A number that is not negative: significand times 2^exponent, the significand 0 or of 53 bits, as f64 has it.
typedef struct {
  ulong significand;
  int exponent;
} Float64;

// Right shift whose lowest bit tells of any bit that was lost: rounding goes on to be right.
static inline ulong shift_right(ulong v, uint by) {
  if (by == 0) return v;
  if (by > 63) return v != 0;
  return (v >> by) | ((v << (64 - by)) != 0);
}

// v times 2^exponent, rounded to nearest, ties to even.
static inline Float64 rounded(ulong v, int exponent) {
  Float64 r = {0, 0};
  if (v == 0) return r;
  const int zeros = (int)clz(v);
  v <<= zeros;
  const ulong lost = v & 0x7ff;
  v >>= 11;
  v += lost > 0x400 || (lost == 0x400 && (v & 1));
  const uint carry = (uint)(v >> 53);
  r.significand = v >> carry;
  r.exponent = exponent - zeros + 11 + (int)carry;
  return r;
}

// Significand and exponent of a finite f32.
static inline ulong parts_of(uint bits, int *exponent) {
  const int e = (int)(bits >> 23 & 0xff);
  *exponent = max(e, 1) - 150;
  return (bits & 0x7fffff) | (e == 0 ? 0 : 0x800000);
}

// a - b of two finite f32 with a >= b, given by their bits.
static inline Float64 difference(uint a, uint b) {
  int ea, eb;
  const ulong ma = parts_of(a, &ea) << 38, mb = parts_of(b, &eb) << 38; // 62 bits
  const int e = max(ea, eb);
  const ulong x = shift_right(ma, (uint)(e - ea)), y = shift_right(mb, (uint)(e - eb));
  const int negative_a = a >> 31, negative_b = b >> 31;
  const ulong sum = negative_a == negative_b ? (negative_a ? y - x : x - y) : x + y;
  return rounded(sum, e - 38);
}

// Product.
static inline Float64 times(Float64 a, Float64 b) {
  const ulong x = a.significand << 10, y = b.significand << 11;
  return rounded(mul_hi(x, y) | (x * y != 0), a.exponent + b.exponent + 43);
}

// CELLS over a number above 0.
static inline Float64 cells_over(Float64 extent) {
  ulong rest = CELLS << (53 - MORTON_BITS), quotient = 0;
  const int turns = 57;
  for (int k = 0; k < turns; k++) {
    const ulong fits = rest >= extent.significand;
    quotient = quotient << 1 | fits;
    rest = (rest - (fits ? extent.significand : 0)) << 1;
  }
  return rounded(quotient << 1 | (rest != 0), MORTON_BITS - 53 - extent.exponent - turns);
}

// Cell of a coordinate. -inf and NaN are in the first, inf in the last; all are in the first of an axis without extent.
static inline uint cell_of(float x, const __global uint *grid) {
  const Float64 scale = {(ulong)grid[1] << 32 | grid[2], (int)grid[3]};
  if (scale.significand == 0 || !(x > -INFINITY)) return 0;
  if (isinf(x)) return (uint)CELLS;
  const Float64 cell = times(difference(as_uint(x), grid[0]), scale);
  return cell.exponent > 0 || cell.exponent < -63 ? 0 : (uint)(cell.significand >> -cell.exponent) & (uint)CELLS;
}

// Number of the layer of a position, the topmost 0: the bits of a float are a logarithm that is a straight line between powers of two. Every step
// is rounded once, in the same way everywhere; heights that some devices flush to 0 are in the layer of 0.
static inline uint layer_of(const float x[3], float up_x, float up_y, float up_z) {
  const uint half_of = 1u << (LAYER_BITS - 1);
  const float height = fma(x[0], up_x, fma(x[1], up_y, x[2] * up_z));
  const float stretched = 1.0f + 2.0f * fabs(height);
  const uint logarithm = (as_uint(stretched) - as_uint(1.0f)) >> (23 - OCTAVE_BITS);
  const uint away = stretched < INFINITY ? min(logarithm, half_of - 1) : half_of - 1;
  return height >= FLT_MIN ? half_of - 1 - away : half_of + away;
}

// The low bits with two zeros between neighbours; there is room for 21.
static inline ulong spread(ulong v) {
  v = (v | v << 32) & 0x001f00000000fffful;
  v = (v | v << 16) & 0x001f0000ff0000fful;
  v = (v | v << 8) & 0x100f00f00f00f00ful;
  v = (v | v << 4) & 0x10c30c30c30c30c3ul;
  return (v | v << 2) & 0x1249249249249249ul;
}

// Launch: over chunks. Lowest and highest finite coordinate of each chunk; inf and -inf where there is none.
CHUNK_KERNEL void morton_box(__global const real *params, uint stride, uint count, // in [3, stride], local units
                             uint chunks, __global float *boxes) {                 // out [chunks, 3, 2]
  const uint c = CHUNK;
  if (c >= chunks) return;
  const uint size = chunk_size(count, chunks), first = min(c * size, count), last = min(first + size, count);
  float low[3], high[3];
  for (int k = 0; k < 3; k++) {
    low[k] = INFINITY;
    high[k] = -INFINITY;
    for (uint i = first + ITEM; i < last; i += GROUP) {
      const float x = (float)params[(size_t)(P_POSITION + k) * stride + i];
      const int finite = fabs(x) < INFINITY;
      low[k] = finite ? fmin(low[k], x) : low[k];
      high[k] = finite ? fmax(high[k], x) : high[k];
    }
  }
#if GROUP_STYLE
  __local float bounds[6][GROUP];
  for (int k = 0; k < 3; k++) {
    bounds[2 * k][ITEM] = low[k];
    bounds[2 * k + 1][ITEM] = high[k];
  }
  for (uint width = GROUP / 2; width > 0; width /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    if (ITEM < width)
      for (int k = 0; k < 3; k++) {
        bounds[2 * k][ITEM] = fmin(bounds[2 * k][ITEM], bounds[2 * k][ITEM + width]);
        bounds[2 * k + 1][ITEM] = fmax(bounds[2 * k + 1][ITEM], bounds[2 * k + 1][ITEM + width]);
      }
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  if (ITEM < 6) boxes[c * 6 + ITEM] = bounds[ITEM][0];
#else
  for (int k = 0; k < 3; k++) {
    boxes[c * 6 + 2 * k] = low[k];
    boxes[c * 6 + 2 * k + 1] = high[k];
  }
#endif
}

// Launch: one work-group per axis, or work-item where that is a whole core. Cells per unit from the boxes of all chunks.
CHUNK_KERNEL void morton_cells(__global const float *boxes, uint chunks, // in [chunks, 3, 2]
                               __global uint *grid) {                    // out [3, MORTON_GRID]
  const uint k = CHUNK;
  if (k >= 3) return;
  float low = INFINITY, high = -INFINITY;
  for (uint c = ITEM; c < chunks; c += GROUP) {
    low = fmin(low, boxes[c * 6 + 2 * k]);
    high = fmax(high, boxes[c * 6 + 2 * k + 1]);
  }
#if GROUP_STYLE
  __local float bounds[2][GROUP];
  bounds[0][ITEM] = low;
  bounds[1][ITEM] = high;
  for (uint width = GROUP / 2; width > 0; width /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    if (ITEM < width) {
      bounds[0][ITEM] = fmin(bounds[0][ITEM], bounds[0][ITEM + width]);
      bounds[1][ITEM] = fmax(bounds[1][ITEM], bounds[1][ITEM + width]);
    }
  }
  if (ITEM != 0) return;
  low = bounds[0][0];
  high = bounds[1][0];
#endif
  Float64 scale = {0, 0};
  if (high > low) scale = cells_over(difference(as_uint(high), as_uint(low)));
  grid[k * MORTON_GRID] = as_uint(low);
  grid[k * MORTON_GRID + 1] = (uint)(scale.significand >> 32);
  grid[k * MORTON_GRID + 2] = (uint)scale.significand;
  grid[k * MORTON_GRID + 3] = (uint)scale.exponent;
}

// Launch: one work-item per Gaussian. Codes as two halves, the number of rows, and rows as they are.
__kernel void morton_keys(__global const real *params, uint stride, uint count, // in [3, stride], local units
                          float up_x, float up_y, float up_z,                   // direction that is up
                          __global const uint *grid, int ordered,               // in [3, MORTON_GRID]; 0: all codes are 0
                          __global uint *low, __global uint *high,              // out [count] 32 bits; 29 bits
                          __global uint *rows,                                  // out [count]
                          __global uint *status) {                              // out S_VISIBLE: count
  const uint i = get_global_id(0);
  if (i >= count) return;
  ulong code = 0;
  if (ordered) {
    float x[3];
    for (int k = 0; k < 3; k++) x[k] = (float)params[(size_t)(P_POSITION + k) * stride + i];
    code = (ulong)layer_of(x, up_x, up_y, up_z) << (3 * MORTON_BITS);
    for (int k = 0; k < 3; k++) code |= spread(cell_of(x[k], grid + k * MORTON_GRID)) << k;
  }
  low[i] = (uint)code;
  high[i] = (uint)(code >> 32);
  rows[i] = i;
  if (i == 0) status[S_VISIBLE] = count;
}

// Launch: one work-item per Gaussian that is to be removed. Its key is above all others.
__kernel void morton_remove(__global const uint *removed, uint count, // in [count]
                            __global uint *high) {                    // out
  const uint i = get_global_id(0);
  if (i < count) high[removed[i]] = 0xffffffffu;
}

// Launch: one work-item per Gaussian. High halves in the order of the low ones.
__kernel void morton_high(__global const uint *high, uint count, // in [count]
                          __global const uint *rows,             // in [count]
                          __global uint *keys) {                 // out [count]
  const uint i = get_global_id(0);
  if (i < count) keys[i] = high[rows[i]];
}
