// exposure: an affine colour transform per training image, x' = A x + b, between the render and the loss, with its
// derivatives and its own Adam step. A and b are a row-major 3 x 4 matrix [A | b], the identity at the start. It takes up
// what a camera's automatic exposure and white balance change from photo to photo. Source: [3DGS], as later releases have
// it (per-image exposure): one Adam over the transforms of all views, those not rendered having a gradient of 0.
// A change of all transforms that the scene undoes changes no picture; here their mean over the views is kept at the
// identity, so that the scene keeps the colours of the average photo and can be shown without a transform.
// Images are taken as flat planes, padding included: dL/dx' is 0 there, so that it adds nothing to the sums.

// The vectors of a plane that a work-item takes: neighbours on CPUs, every chunks-th on GPUs, where neighbouring work-items
// then read neighbouring pixels.
#if GROUP_STYLE
#define EACH_VECTOR(v) for (uint v = chunk; v < vectors; v += chunks)
#else
#define EACH_VECTOR(v)                                   \
  const uint each = (vectors + chunks - 1) / chunks;     \
  for (uint v = chunk * each; v < min(chunk * each + each, vectors); v++)
#endif

// Launch: `chunks` work-items. Any values are taken as they are.
__kernel void exposure_apply(__global const real *image, // in [>= 3, rows, stride] colour
                             uint plane, uint chunks,    // pixels of a padded plane, a multiple of VW
                             __global const real *exposures, uint view, // in [views, 12]
                             __global real *corrected) {                // out [3, rows, stride] colour
  const uint chunk = get_global_id(0), vectors = plane / VW;
  if (chunk >= chunks) return;
  real e[12];
  for (int k = 0; k < 12; k++) e[k] = exposures[12 * view + k];
  EACH_VECTOR(v) {
    const realV red = vload_real(v, image), green = vload_real(v, image + plane),
                blue = vload_real(v, image + 2 * (size_t)plane);
    for (int r = 0; r < 3; r++) {
      const realV sum = fma(V(e[4 * r]), red, fma(V(e[4 * r + 1]), green, fma(V(e[4 * r + 2]), blue, V(e[4 * r + 3]))));
      vstore_real(sum, v, corrected + r * (size_t)plane);
    }
  }
}

// Launch: `chunks` work-items. dL/dx = A^T dL/dx' takes the place of dL/dx'; every work-item leaves its sums of
// dL/dx'_r * (x, 1)_c, which exposure_step adds in order.
__kernel void exposure_backward(__global const real *image, // in [>= 3, rows, stride] colour before the transform
                                uint plane, uint chunks,    // as exposure_apply
                                __global const real *exposures, uint view, // in [views, 12]
                                __global real *dimage,    // in/out [3, rows, stride] loss per colour, 0 in the padding
                                __global real *partial) { // out [12, chunks] loss per entry of [A | b]
  const uint chunk = get_global_id(0), vectors = plane / VW;
  if (chunk >= chunks) return;
  real e[12];
  realV sums[12];
  for (int k = 0; k < 12; k++) {
    e[k] = exposures[12 * view + k];
    sums[k] = V(R(0.0));
  }
  EACH_VECTOR(v) {
    realV x[3], d[3];
    for (int c = 0; c < 3; c++) {
      x[c] = vload_real(v, image + c * (size_t)plane);
      d[c] = vload_real(v, dimage + c * (size_t)plane);
    }
    for (int r = 0; r < 3; r++) {
      for (int c = 0; c < 3; c++) sums[4 * r + c] = fma(d[r], x[c], sums[4 * r + c]);
      sums[4 * r + 3] += d[r];
    }
    for (int c = 0; c < 3; c++)
      vstore_real(fma(V(e[c]), d[0], fma(V(e[4 + c]), d[1], V(e[8 + c]) * d[2])), v, dimage + c * (size_t)plane);
  }
  for (int k = 0; k < 12; k++) {
    real lane[VW], sum = R(0.0);
    vstore_real(sums[k], 0, lane);
    for (int l = 0; l < VW; l++) sum += lane[l];
    partial[k * (size_t)chunks + chunk] = sum;
  }
}

// Launch: (12, views) work-items. Adds the sums of the view that was rendered in a fixed order and takes one step of Adam
// for every view. A non-finite gradient counts as zero and is counted, a step that would make an entry non-finite is not taken.
// Nothing is changed after a pair overflow: the host repeats the iteration.
__kernel void exposure_step(__global const real *partial, uint chunks, // in [12, chunks]
                            uint view, uint views,
                            real lr, real beta1, real beta2, real epsilon,
                            real correction1, real correction2, // 1 / (1 - beta1^t), 1 / sqrt(1 - beta2^t)
                            __global real *exposures, __global real *moment1, __global real *moment2, // in/out [views, 12]
                            __global real *grads,             // out [12] loss per entry of the view rendered
                            volatile __global uint *status) { // in S_OVERFLOW, out S_NON_FINITE
  const uint k = get_global_id(0), of = get_global_id(1);
  if (k >= 12 || of >= views || status[S_OVERFLOW] != 0) return;
  real g = R(0.0);
  if (of == view) {
    for (uint c = 0; c < chunks; c++) g += partial[k * (size_t)chunks + c];
    if (!(fabs(g) < R(1e18))) { // squares stay finite
      g = R(0.0);
      atomic_inc(status + S_NON_FINITE); // an integer count: order does not matter
    }
    grads[k] = g;
  }
  const size_t at = 12 * (size_t)of + k;
  const real m = fma(beta1, moment1[at], (R(1.0) - beta1) * g);
  const real v = fma(beta2, moment2[at], (R(1.0) - beta2) * g * g);
  const real next = exposures[at] - (lr * correction1) * m / fma(sqrt(v), correction2, epsilon);
  if (isfinite(next)) exposures[at] = next;
  moment1[at] = m;
  moment2[at] = v;
}

// Launch: 12 work-items, after exposure_step. Takes the mean deviation from the identity off the transforms, in the order of
// the views.
__kernel void exposure_center(uint views,
                              __global real *exposures,        // in/out [views, 12]
                              __global const uint *status) {   // in S_OVERFLOW
  const uint k = get_global_id(0);
  if (k >= 12 || status[S_OVERFLOW] != 0) return;
  const real identity = k % 5 == 0 ? R(1.0) : R(0.0);
  real sum = R(0.0);
  for (uint of = 0; of < views; of++) sum += exposures[12 * (size_t)of + k] - identity;
  const real mean = sum / (real)views;
  for (uint of = 0; of < views; of++) exposures[12 * (size_t)of + k] -= mean;
}
