// weight: the most that any of several views shows of each Gaussian: the sum over a view's pixels of alpha T, what the
// Gaussian adds to a pixel per unit of its colour. It is sum 6 of splat_grad where dL/dC is 1 in red.
// Launch: one work-item per Gaussian, after splat_grad of each view. A Gaussian without pairs was not seen and is left as it
// is; a weight that is not finite counts as the largest number, so that what is broken is not taken for unseen. A
// Gaussian's pairs are added in the order of their tiles. Source: compositing as in splat.cl.

__kernel void weight(uint count, __global const uint *pair_start, // in [count] first emission slot
                     __global const uint *pair_counts,            // in [count]
                     __global const real *sums,                   // in [pairs, SUMS]
                     __global real *most) {                       // in/out [count] pixels
  const uint i = get_global_id(0);
  if (i >= count) return;
  const uint pairs = pair_counts[i];
  if (pairs == 0) return;
  real sum = R(0.0);
  __global const real *from = sums + (size_t)pair_start[i] * SUMS;
  for (uint p = 0; p < pairs; p++, from += SUMS) sum += from[6];
  most[i] = fmax(most[i], sum < R(1e30) ? sum : R(1e30));
}
