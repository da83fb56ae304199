// adam: all parameter groups in one pass over a block of Gaussians.
// Launch: (Gaussians of the block / VW, active planes) work-items. A non-finite gradient counts as zero and is counted;
// a step that would make a parameter non-finite is not taken. Nothing is changed after a pair overflow: the host repeats
// the iteration. Source: Kingma and Ba 2015, epsilon outside of the bias correction's root as in 3DGS.

__kernel void adam(__global const real *grads, uint grad_stride, // in [planes, grad_stride] of the block
                   uint first, uint groups,                     // block: first Gaussian, a multiple of VW; its vectors
                   uint stride,
                   real lr_position, real lr_scale, real lr_rotation, real lr_opacity, real lr_sh0, real lr_sh,
                   real beta1, real beta2, real epsilon,
                   real correction1, real correction2,                // 1 / (1 - beta1^t), 1 / sqrt(1 - beta2^t)
                   __global real *params, __global real *moment1, __global real *moment2, // in/out [planes, stride]
                   volatile __global uint *status) {     // in S_OVERFLOW, out S_NON_FINITE
  const uint group = get_global_id(0), plane = get_global_id(1);
  if (group >= groups || status[S_OVERFLOW] != 0) return;
  const real lr = plane < P_LOG_SCALE  ? lr_position
                  : plane < P_ROTATION ? lr_scale
                  : plane < P_OPACITY  ? lr_rotation
                  : plane < P_SH       ? lr_opacity
                  : plane < P_SH + 3   ? lr_sh0
                                       : lr_sh;
  const size_t base = (size_t)plane * stride + first;
  const realV zero = (realV)(R(0.0)), raw = vload_real(group, grads + (size_t)plane * grad_stride);
  const maskV good = fabs(raw) < (realV)(R(1e18)); // squares stay finite; NaN fails
  const realV g = choose(good, raw, zero);
  const realV m = fma((realV)(beta1), vload_real(group, moment1 + base), (realV)(R(1.0) - beta1) * g);
  const realV v = fma((realV)(beta2), vload_real(group, moment2 + base), (realV)(R(1.0) - beta2) * g * g);
  const realV old = vload_real(group, params + base);
  const realV step = (lr * correction1) * m / fma(sqrt(v), (realV)(correction2), (realV)(epsilon));
  const realV next = old - step;
  vstore_real(choose(isfinite(next), next, old), group, params + base);
  vstore_real(m, group, moment1 + base);
  vstore_real(v, group, moment2 + base);
  if (!all_lanes(good)) {
    real lane[VW];
    vstore_real(choose(good, zero, (realV)(R(1.0))), 0, lane);
    uint bad = 0;
    for (int l = 0; l < VW; l++) bad += lane[l] > R(0.0);
    atomic_add(status + S_NON_FINITE, bad); // an integer count: order does not matter
  }
}
