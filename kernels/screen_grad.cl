// screen_grad: how hard this iteration pulls at the projected centre of each Gaussian, added to what earlier ones did.
// Launch: one work-item per Gaussian. A Gaussian without pairs was not seen and is left as it is, as is one whose gradient
// is not finite; after a pair overflow nothing is changed: the host repeats the iteration. A Gaussian's pairs are added in
// the order of their tiles; those of a large one in the group style have been by project_grad, after which this is launched. Source:
// [3DGS] section 5.2; the gradient is that with respect to the mean in normalised device coordinates, -1 to 1 over the image, so that
// its two parts are those with respect to pixels times half of the width and height.
#include "chunks.clh"

#define TWO_LN2 R(1.3862943611198906)

__kernel void screen_grad(__global const Projected *records, uint stride, uint count, // in [stride]
                          __global const uint *isect_start,  // in [count] first emission slot
                          __global const uint *isect_counts, // in [count]
                          __global const real *sums,        // in [pairs, SUMS]
                          int width, int height,            // pixels
                          __global const uint *status,      // in S_OVERFLOW
                          __global real *statistics) { // in/out [2, stride] sum of the norms, iterations that saw the Gaussian
  const uint i = get_global_id(0);
  if (i >= count || status[S_OVERFLOW] != 0) return;
  const uint pairs = SUMMED_PAIRS(isect_counts[i]);
  if (pairs == 0) return;
  real first = R(0.0), second = R(0.0);
  __global const real *from = sums + (size_t)isect_start[i] * SUMS;
  for (uint p = 0; p < pairs; p++, from += SUMS) {
    first += from[1];
    second += from[2];
  }
  // dL/dmean = P^T diag(Syy/det, 1/Syy) (first, second) with P = [[1, -r], [0, 1]]; the record holds both factors times
  // log2(e)/2.
  const real along = TWO_LN2 * records[i].a * first;
  const real dx = R(0.5) * (real)width * along;
  const real dy = R(0.5) * (real)height * fma(-records[i].r, along, TWO_LN2 * records[i].c * second);
  const real norm = hypot(dx, dy);
  if (!(norm < R(1e18))) return;
  statistics[i] += norm;
  statistics[stride + i] += R(1.0);
}
