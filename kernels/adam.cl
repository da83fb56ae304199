// adam: the step of the optimiser with gradients that are given: those of a batch of views, and in checks. A step for every view is taken
// within project_grad.
// Launch: (Gaussians of the block / VW, active planes) work-items. Nothing is changed after a pair overflow: the host repeats the
// iteration.
#include "adam.clh"

__kernel void adam(__global const real *grads, uint grad_stride, // in [planes, grad_stride] of the block
                   uint first, uint groups,                     // block: first Gaussian, a multiple of VW; its vectors
                   real share,                                   // of each view: 1 / views that the gradients are summed over
                   __global real *params, uint stride,          // in/out [planes, stride]
                   ADAM_ARGUMENTS,                               // moments in/out [planes, stride]
                   volatile __global uint *status) {             // in S_OVERFLOW, out S_NON_FINITE
  const uint group = get_global_id(0), plane = get_global_id(1), i = first + group * VW;
  if (group >= groups || status[S_OVERFLOW] != 0) return;
  const Adam a = ADAM;
  const realV mean = share * vload_real(group, grads + (size_t)plane * grad_stride);
  Moments had;
  adam_moments(&a, plane, i, &had);
  count_bad(adam_step(&a, RATE(plane), plane, i, PLANE(params, plane), &had, mean), status);
}
