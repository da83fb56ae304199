// exposure: an affine colour transform per training image, x' = A x + b, between the render and the loss, with its
// derivatives and its own Adam step. A and b are a row-major 3 x 4 matrix [A | b], the identity at the start. It takes up
// what a camera's automatic exposure and white balance change from photo to photo. Source: [3DGS], as later releases have
// it (per-image exposure): one Adam over the transforms of all views, those not rendered having a gradient of 0.
// A change of all transforms that the scene undoes changes no picture; here their mean over the views is kept at the
// identity, so that the scene keeps the colours of the average photo and can be shown without a transform.
// Images are taken as flat planes, padding included: dL/dx' is 0 there, so that it adds nothing to the sums.
#include "chunks.clh"
#include "lanes.clh"

// The vectors of a plane that a work-item takes: neighbours on CPUs; on GPUs, where neighbouring work-items then read neighbouring
// pixels, a group takes every chunks-th run of them.
#if GROUP_STYLE
#define EACH_VECTOR(v) for (uint v = chunk * GROUP + ITEM; v < vectors; v += chunks * GROUP)
#else
#define EACH_VECTOR(v)                                   \
  const uint each = (vectors + chunks - 1) / chunks;     \
  for (uint v = chunk * each; v < min(chunk * each + each, vectors); v++)
#endif

// Launch: `chunks` work-groups, or work-items where each is a whole core. Any values are taken as they are.
CHUNK_KERNEL void exposure_apply(__global const real *image, // in [>= 3, rows, stride] colour
                                 uint plane, uint chunks,    // pixels of a padded plane, a multiple of VW
                                 __global const real *exposures, uint view, // in [views, 12]
                                 __global real *corrected) {                // out [3, rows, stride] colour
  const uint chunk = CHUNK, vectors = plane / VW;
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

// Launch: as exposure_apply. dL/dx = A^T dL/dx' takes the place of dL/dx'; every chunk leaves its sums of dL/dx'_r * (x, 1)_c,
// which exposure_step adds in order.
CHUNK_KERNEL void exposure_backward(__global const real *image, // in [>= 3, rows, stride] colour before the transform
                                    uint plane, uint chunks,    // as exposure_apply
                                    __global const real *exposures, uint view, // in [views, 12]
                                    __global real *dimage,    // in/out [3, rows, stride] loss per colour, 0 in the padding
                                    __global real *partial) { // out [12, chunks] loss per entry of [A | b]
  PARTS;
  const uint chunk = CHUNK, vectors = plane / VW;
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
  for (int k = 0; k < 12; k += 2) {
    real2 sum = (real2)(R(0.0));
    real lane[2][VW];
    vstore_real(sums[k], 0, lane[0]);
    vstore_real(sums[k + 1], 0, lane[1]);
    for (int l = 0; l < VW; l++) sum += (real2)(lane[0][l], lane[1][l]);
#if GROUP_STYLE
    barrier(CLK_LOCAL_MEM_FENCE);
#endif
    sum = group_total(sum, parts);
    if (ITEM == 0) {
      partial[k * (size_t)chunks + chunk] = sum.x;
      partial[(k + 1) * (size_t)chunks + chunk] = sum.y;
    }
  }
}

// Sum over the group, for every work-item of it.
#if GROUP_STYLE
static inline real whole(real value, __local real2 *parts) {
  group_total((real2)(value, R(0.0)), parts);
  barrier(CLK_LOCAL_MEM_FENCE);
  return parts[0].x;
}
#else
#define whole(value, parts) (value)
#endif

// Launch: 12 work-groups, one for each entry, or work-items where each is a whole core. Adds the sums of the view that was rendered in a
// fixed order, takes one step of Adam for every view, and takes the mean deviation from the identity off the transforms. A non-finite
// gradient counts as zero and is counted, a step that would make an entry non-finite is not taken. Nothing is changed after a pair
// overflow: the host repeats the iteration.
CHUNK_KERNEL void exposure_step(__global const real *partial, uint chunks, // in [12, chunks]
                                uint view, uint views,
                                real lr, real beta1, real beta2, real epsilon,
                                real correction1, real correction2, // 1 / (1 - beta1^t), 1 / sqrt(1 - beta2^t)
                                __global real *exposures, __global real *moment1, __global real *moment2, // in/out [views, 12]
                                __global real *grads,             // out [12] loss per entry of the view rendered
                                volatile __global uint *status) { // in S_OVERFLOW, out S_NON_FINITE
  PARTS;
  const uint k = CHUNK, stepped = status[S_OVERFLOW] != 0 ? 0 : views;
  real sum = R(0.0);
  for (uint c = ITEM; c < chunks; c += GROUP) sum += partial[k * (size_t)chunks + c];
  const real total = whole(sum, parts);
  const int good = fabs(total) < R(1e18); // squares stay finite
  if (ITEM == 0 && stepped > 0) {
    if (!good) atomic_inc(status + S_NON_FINITE); // an integer count: order does not matter
    grads[k] = good ? total : R(0.0);
  }
  const real identity = k % 5 == 0 ? R(1.0) : R(0.0);
  real deviation = R(0.0);
  for (uint of = ITEM; of < stepped; of += GROUP) {
    const size_t at = 12 * (size_t)of + k;
    const real g = of == view && good ? total : R(0.0);
    const real m = fma(beta1, moment1[at], (R(1.0) - beta1) * g);
    const real v = fma(beta2, moment2[at], (R(1.0) - beta2) * g * g);
    const real next = exposures[at] - (lr * correction1) * m / fma(sqrt(v), correction2, epsilon);
    if (isfinite(next)) exposures[at] = next;
    deviation += exposures[at] - identity;
    moment1[at] = m;
    moment2[at] = v;
  }
#if GROUP_STYLE
  barrier(CLK_LOCAL_MEM_FENCE); // everybody has read the first sum
#endif
  const real mean = whole(deviation, parts) / (real)views;
  for (uint of = ITEM; of < stepped; of += GROUP) exposures[12 * (size_t)of + k] -= mean;
}
