// project_grad: the nine sums of each Gaussian -> gradients of its raw parameters, regularisers included.
// Without TAKE_STEP they are written, for a block of Gaussians, or added to those of the views before in a batch; with it they go into a
// step of the optimiser at once, and none of them is stored. A Gaussian's pairs are added in the order of their tiles,
// those of large ones in the group style by large_sums. Source: chain rule through M = J W R S (see projection.clh),
// [MH] Eq. 4 for the regularisers.
#include "adam.clh"
#include "ahead.clh"
#include "chunks.clh"
#include "projection.clh"

// Destination of the gradients of VW Gaussians: an array, or, where a work-item takes no more of them at a time, the step itself.
#if TAKE_STEP && UPDATE_RUN == VW
typedef struct {
  const Adam *adam;
  uint i, *bad; // first Gaussian; gradients that are not finite
} Out;

// Fetched for several planes before the first is put: a GPU waits for memory once then, not once for each.
#define FETCH(plane, had) adam_moments(out->adam, plane, out->i, had)
#define PUT(lr, plane, old, had, gradient) *out->bad += adam_step(out->adam, out->adam->lr, plane, out->i, old, had, gradient)
#define PUT_SH(k, channel, old, had, gradient)                                                                         \
  *out->bad += adam_step(out->adam, (k) == 0 ? out->adam->lr_sh0 : out->adam->lr_sh, P_SH + 3 * (k) + (channel), out->i, \
                         old, had, gradient)
#else
#if TAKE_STEP
#define GRADS // in private memory
#else
#define GRADS __global
#endif
typedef struct {
  GRADS real *grads; // [planes, stride]
  uint stride, at, adds;
} Out;

static inline void put(const Out *out, uint plane, realV gradient) {
  GRADS real *to = out->grads + (size_t)plane * out->stride + out->at;
  if (out->adds) gradient += vload_real(0, to);
  vstore_real(gradient, 0, to);
}

#define FETCH(plane, had)
#define PUT(lr, plane, old, had, gradient) put(out, plane, gradient)
#define PUT_SH(k, channel, old, had, gradient) PUT(lr_sh, P_SH + 3 * (k) + (channel), old, had, gradient)
#endif

// SH coefficients of a channel that are fetched together: of a vector of Gaussians one.
#define SH_BATCH (VW > 1 || SH_DEGREE == 0 ? 1 : SH_DEGREE == 2 ? 3 : 4)

// dL/d(unit quaternion) from dL/dR, then through the normalisation.
static inline void quaternion_grad(const realV n[4], realV inv_norm, const realV d[9], realV out[4]) {
  const realV w = n[0], x = n[1], y = n[2], z = n[3];
  realV g[4];
  g[0] = R(2.0) * (x * (d[7] - d[5]) + y * (d[2] - d[6]) + z * (d[3] - d[1]));
  g[1] = R(2.0) * (w * (d[7] - d[5]) + y * (d[1] + d[3]) + z * (d[2] + d[6]) - R(2.0) * x * (d[4] + d[8]));
  g[2] = R(2.0) * (w * (d[2] - d[6]) + x * (d[1] + d[3]) + z * (d[5] + d[7]) - R(2.0) * y * (d[0] + d[8]));
  g[3] = R(2.0) * (w * (d[3] - d[1]) + x * (d[2] + d[6]) + y * (d[5] + d[7]) - R(2.0) * z * (d[0] + d[4]));
  const realV along = g[0] * w + g[1] * x + g[2] * y + g[3] * z;
  for (int k = 0; k < 4; k++) out[k] = (g[k] - along * n[k]) * inv_norm;
}

// Gradient of the SH basis, contracted with weight[k] = sum_channels dL/dcolour * coefficient.
static inline void sh_direction_grad(const realV d[3], const realV *weight, realV out[3]) {
  out[0] = out[1] = out[2] = V(R(0.0));
#if SH_DEGREE > 0
  out[1] -= R(0.4886025119029199) * weight[1];
  out[2] += R(0.4886025119029199) * weight[2];
  out[0] -= R(0.4886025119029199) * weight[3];
#endif
#if SH_DEGREE > 1
  const realV x = d[0], y = d[1], z = d[2];
  const real c4 = R(1.0925484305920792), c6 = R(0.31539156525252005), c8 = R(0.5462742152960396);
  out[0] += c4 * (y * weight[4] - z * weight[7]) - R(2.0) * c6 * x * weight[6] + R(2.0) * c8 * x * weight[8];
  out[1] += c4 * (x * weight[4] - z * weight[5]) - R(2.0) * c6 * y * weight[6] - R(2.0) * c8 * y * weight[8];
  out[2] += -c4 * (y * weight[5] + x * weight[7]) + R(4.0) * c6 * z * weight[6];
#endif
#if SH_DEGREE > 2
  const realV xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
  const real a = R(0.5900435899266435), b = R(2.890611442640554), c = R(0.4570457994644658);
  const real e = R(0.3731763325901154), f = R(1.445305721320277);
  out[0] += -R(6.0) * a * xy * weight[9] + b * yz * weight[10] + R(2.0) * c * xy * weight[11] -
            R(6.0) * e * xz * weight[12] - c * (R(4.0) * zz - R(3.0) * xx - yy) * weight[13] +
            R(2.0) * f * xz * weight[14] - R(3.0) * a * (xx - yy) * weight[15];
  out[1] += -R(3.0) * a * (xx - yy) * weight[9] + b * xz * weight[10] -
            c * (R(4.0) * zz - xx - R(3.0) * yy) * weight[11] - R(6.0) * e * yz * weight[12] +
            R(2.0) * c * xy * weight[13] - R(2.0) * f * yz * weight[14] + R(6.0) * a * xy * weight[15];
  out[2] += b * xy * weight[10] - R(8.0) * c * yz * weight[11] + e * (R(6.0) * zz - R(3.0) * (xx + yy)) * weight[12] -
            R(8.0) * c * xz * weight[13] + f * (xx - yy) * weight[14];
#endif
}

// Colour gradient -> d, where the colour is not clamped and `active` is on, else 0; the SH basis, by which d is that of the
// coefficients; position gradient (added).
static inline void color_grad(__global const real *params, uint stride, uint i, const Camera *cam, maskV active, const realV x[3],
                              const realV dcolor[3], realV d[3], realV basis[SH_COUNT], realV dx[3]) {
  const realV zero = V(R(0.0));
  realV dir[3], weight[SH_COUNT];
  const realV inv_distance = view_direction(cam, x, dir);
  for (int k = 0; k < 3; k++) dir[k] = choose(active, dir[k], zero);
  sh_basis(dir, basis);
  for (int k = 0; k < SH_COUNT; k++) weight[k] = zero;
  for (int ch = 0; ch < 3; ch++) {
    realV sum = V(R(0.5));
    for (int k = 0; k < SH_COUNT; k++) sum = fma(basis[k], PLANE(params, P_SH + 3 * k + ch), sum);
    d[ch] = choose(active & (sum > zero), dcolor[ch], zero);
    for (int k = 0; k < SH_COUNT; k++) weight[k] = fma(d[ch], PLANE(params, P_SH + 3 * k + ch), weight[k]);
  }
  realV dd[3];
  sh_direction_grad(dir, weight, dd);
  const realV along = dot3(dd, dir);
  for (int k = 0; k < 3; k++) dx[k] = fma(dd[k] - along * dir[k], inv_distance, dx[k]);
}

// Gradients of the SH coefficients.
static inline void put_colors(__global const real *params, uint stride, uint i, const Out *out, const realV d[3],
                              const realV basis[SH_COUNT]) {
  for (int k = 0; k < SH_COUNT; k += SH_BATCH)
    for (int ch = 0; ch < 3; ch++) {
      realV old[SH_BATCH];
      Moments had[SH_BATCH];
#pragma unroll
      for (int j = 0; j < SH_BATCH; j++) {
        old[j] = PLANE(params, P_SH + 3 * (k + j) + ch);
        FETCH(P_SH + 3 * (k + j) + ch, &had[j]);
      }
#pragma unroll
      for (int j = 0; j < SH_BATCH; j++) PUT_SH(k + j, ch, old[j], &had[j], d[ch] * basis[k + j]);
    }
}

#if ANTI_ALIAS
// What the filters do to the opacity, added to dL/d(J W R) and the log-scales; dlog is dL/d(log opacity). With w = 1 -
// det0/det, a sum of positive terms over det, d log sqrt(det0/det) = w d log sqrt(det0) - BLUR/det (M . dM); the second
// term is in the caller's G. In cofactors d log sqrt(det0) by the log-scale of axis k is the share of the other two
// components of c, and by the rows of J W R their cross products with c / det0: nothing cancels and nothing grows with the
// length of a needle. 1 / det0 stays finite: a Gaussian that has pairs was above the cut with its opacity times
// sqrt(det0/det), so that det0 is at least (BLUR times the cut) squared.
static inline void area_grad(const Shape *o, realV dlog, realV dm[6], realV dls[3]) {
  const realV area = R(1.0) / o->det0;
  const realV w = ((real)BLUR * (dot3(o->m, o->m) + dot3(o->m + 3, o->m + 3)) + (real)BLUR * (real)BLUR) / o->det;
  const realV weight = dlog * w, *a = o->jwr, *b = o->jwr + 3;
  realV p[3];
  for (int k = 0; k < 3; k++) {
    const int l = k == 2 ? 0 : k + 1, m = k == 0 ? 2 : k - 1;
    p[k] = weight * (o->c[k] * area) * (o->s[l] * o->s[m]);
    const realV share = (o->c[l] * o->c[l] + o->c[m] * o->c[m]) * area;
    const realV wide = fma(weight, share, dls[k]); // by the log of the filtered scale
    dls[k] = fma(o->kept[k], wide, dlog * (R(1.0) - o->kept[k]));
  }
  for (int k = 0; k < 3; k++) {
    const int l = k == 2 ? 0 : k + 1, m = k == 0 ? 2 : k - 1;
    dm[k] += b[l] * p[m] - b[m] * p[l];
    dm[3 + k] += p[l] * a[m] - p[m] * a[l];
  }
}
#endif

// The sums' geometric part -> position, log-scale and quaternion gradients.
static inline void shape_grad(const Camera *cam, const Shape *o, const realV s[SUMS], realV dx[3], realV dls[3],
                              realV dq[4]) {
  const realV zero = V(R(0.0));
  const realV ka = o->syy / o->det, kc = R(1.0) / o->syy, r = o->sxy / o->syy;
  // dL/dmean and G = K Q K with K = P^T diag(ka, kc) P, P = [[1, -r], [0, 1]]
  const realV mx = ka * s[1], my = fma(-r, mx, kc * s[2]);
  const realV e00 = ka * ka * s[3], e01 = ka * kc * s[4], e11 = kc * kc * s[5];
  realV g00 = e00, g01 = fma(-r, e00, e01), g11 = fma(r, fma(r, e00, -R(2.0) * e01), e11);
  realV dm[6], dt[3], djw[6], drot[9];
#if ANTI_ALIAS
  const realV thin = s[0] * ((real)BLUR / o->det);
  g00 -= thin;
  g11 -= thin;
#endif
  for (int k = 0; k < 3; k++) {
    dm[k] = fma(g00, o->m[k], g01 * o->m[3 + k]);
    dm[3 + k] = fma(g01, o->m[k], g11 * o->m[3 + k]);
    dls[k] = fma(dm[k], o->m[k], dm[3 + k] * o->m[3 + k]);
    dm[k] *= o->s[k]; // now dL/d(J W R)
    dm[3 + k] *= o->s[k];
  }
#if ANTI_ALIAS
  area_grad(o, s[0], dm, dls);
#endif
  for (int a = 0; a < 3; a++) {
    djw[a] = djw[3 + a] = zero;
    for (int k = 0; k < 3; k++) {
      drot[3 * a + k] = fma(o->jw[a], dm[k], o->jw[3 + a] * dm[3 + k]);
      djw[a] = fma(dm[k], o->rot[3 * a + k], djw[a]);
      djw[3 + a] = fma(dm[3 + k], o->rot[3 * a + k], djw[3 + a]);
    }
  }
  quaternion_grad(o->n, o->inv_norm, drot, dq);
  // J's rows are jx (W0 - u W2) and jy (W1 - v W2) with jx = fx/z
  const realV jx = cam->fx * o->iz, jy = cam->fy * o->iz;
  realV d0 = zero, d1 = zero, du = zero, dv = zero;
  for (int k = 0; k < 3; k++) {
    d0 = fma(djw[k], o->jw[k], d0);
    d1 = fma(djw[3 + k], o->jw[3 + k], d1);
    du = fma(-djw[k] * jx, V(cam->w[6 + k]), du);
    dv = fma(-djw[3 + k] * jy, V(cam->w[6 + k]), dv);
  }
  dt[2] = -(d0 + d1) * o->iz;
  const realV u = o->t[0] * o->iz, v = o->t[1] * o->iz;
  const realV du_all = fma(mx, V(cam->fx), choose(o->u_free, du, zero));
  const realV dv_all = fma(my, V(cam->fy), choose(o->v_free, dv, zero));
  dt[0] = du_all * o->iz;
  dt[1] = dv_all * o->iz;
  dt[2] -= (du_all * u + dv_all * v) * o->iz;
  for (int k = 0; k < 3; k++)
    dx[k] = fma(V(cam->w[k]), dt[0], fma(V(cam->w[3 + k]), dt[1], cam->w[6 + k] * dt[2]));
}

#if GROUP_STYLE
// Launch: one work-group per `owns` Gaussians. Leaves the sums of one with more than LARGE_PAIRS pairs in its first slot and 0 in the others,
// again where it has been before: the work-item of a Gaussian that fills the image would add thousands one after the other. Each
// work-item of the group adds every GROUP-th pair, then sums are added by halves. Nothing is changed after a pair overflow.
CHUNK_KERNEL void large_sums(uint count, __global const uint *isect_start,  // in [count] first emission slot
                             __global const uint *isect_counts,             // in [count]
                             __global const uint *status,                   // in S_OVERFLOW
                             __global real *sums, // in/out [pairs, SUMS]
                             uint owns) {          // Gaussians of a group
  SCRATCH;
  __local uint large[GROUP];
  __local real parts[SUMS * GROUP];
  const uint own = SPREAD_ITEM(ITEM);
  const int exists = status[S_OVERFLOW] == 0 && ITEM < owns && own < count;
  const uint n = list_large(exists && isect_counts[own] > LARGE_PAIRS, large, scratch);
  for (uint k = 0; k < n; k++) {
    const uint i = SPREAD_ITEM(large[k]), pairs = isect_counts[i];
    __global real *of = sums + (size_t)isect_start[i] * SUMS;
    real sum[SUMS];
    for (int q = 0; q < SUMS; q++) sum[q] = R(0.0);
    // All are read before any is written: a GPU need not wait for one to read the next.
    for (uint p = ITEM; p < pairs; p += GROUP)
      for (int q = 0; q < SUMS; q++) sum[q] += of[p * SUMS + q];
    for (uint p = ITEM; p < pairs; p += GROUP)
      for (int q = 0; q < SUMS; q++) of[p * SUMS + q] = R(0.0);
    for (int q = 0; q < SUMS; q++) parts[q * GROUP + ITEM] = sum[q];
    for (uint near = GROUP / 2; near > 0; near /= 2) {
      barrier(CLK_LOCAL_MEM_FENCE);
      if (ITEM < near)
        for (int q = 0; q < SUMS; q++) parts[q * GROUP + ITEM] += parts[q * GROUP + ITEM + near];
    }
    if (ITEM == 0)
      for (int q = 0; q < SUMS; q++) of[q] = parts[q * GROUP];
    barrier(CLK_LOCAL_MEM_FENCE); // before parts are written again
  }
}
#endif

// Inputs of the gradients of all Gaussians.
typedef struct {
  __global const real *params; // [planes, stride]
  uint stride, count;
#if ANTI_ALIAS
  __global const real *filter; // [stride] see project
#endif
  Camera cam;
  __global const uint *isect_start, *isect_counts; // [count]
  __global const real *sums;                       // [pairs, SUMS]
  real weight_opacity, weight_scale;
} In;

// The nine sums of VW Gaussians from i on over their pairs, and how many of them have any: 1 or 0 for each.
static inline void sum_pairs(const In *in, uint i, real lane[VW][SUMS], real paired[VW]) {
  for (uint l = 0; l < VW; l++) {
    const uint pairs = i + l < in->count ? SUMMED_PAIRS(in->isect_counts[i + l]) : 0;
    paired[l] = pairs > 0 ? R(1.0) : R(0.0);
    real8 eight = (real8)(R(0.0)); // in registers over the pairs
    real ninth = R(0.0);
    if (pairs > 0) {
      __global const real *from = in->sums + (size_t)in->isect_start[i + l] * SUMS;
      for (uint p = 0; p < pairs; p++, from += SUMS) {
        eight += vload8(0, from);
        ninth += from[8];
      }
    }
    vstore8(eight, 0, lane[l]);
    lane[l][8] = ninth;
  }
}

// Gradients of VW Gaussians from i on. Culled ones get the regularisers alone, rows beyond the last Gaussian zero.
static inline void gaussian_grads(const In *in, uint i, const Out *out) {
  __global const real *params = in->params;
  const uint stride = in->stride;
  const realV zero = V(R(0.0));
  real lane[VW][SUMS], paired[VW], row[VW];
  sum_pairs(in, i, lane, paired);
  for (uint l = 0; l < VW; l++) row[l] = i + l < in->count ? R(1.0) : R(0.0);
  const maskV exists = vload_real(0, row) > zero;
  realV x[3], ls[3], q[4], s[SUMS], dx[3], dls[3], dq[4], d[3], basis[SH_COUNT];
  for (int k = 0; k < 3; k++) x[k] = PLANE(params, P_POSITION + k);
  for (int k = 0; k < 3; k++) ls[k] = PLANE(params, P_LOG_SCALE + k);
  for (int k = 0; k < 4; k++) q[k] = PLANE(params, P_ROTATION + k);
  maskV active = vload_real(0, paired) > zero;
  if (!CULL_CHUNKS || any_lane(active)) {
    for (int k = 0; k < SUMS; k++) {
      real of_lane[VW];
      for (int l = 0; l < VW; l++) of_lane[l] = lane[l][k];
      s[k] = vload_real(0, of_lane);
    }
    Shape o;
#if ANTI_ALIAS
    o.sigma = vload_real(0, in->filter + i);
#endif
    active &= shape_of(&in->cam, x, ls, q, &o);
    shape_grad(&in->cam, &o, s, dx, dls, dq);
    color_grad(params, stride, i, &in->cam, active, x, s + 6, d, basis, dx);
  } else { // neighbours that no pixel saw
    s[0] = dx[0] = dx[1] = dx[2] = dls[0] = dls[1] = dls[2] = dq[0] = dq[1] = dq[2] = dq[3] = d[0] = d[1] = d[2] = zero;
    for (int k = 0; k < SH_COUNT; k++) basis[k] = zero;
  }
  const realV logit = PLANE(params, P_OPACITY), complement = sigmoid(-logit);
  Moments had[P_SH];
#pragma unroll
  for (int k = 0; k < P_SH; k++) FETCH(k, &had[k]);
#pragma unroll
  for (int k = 0; k < 3; k++) {
    const maskV free_scale = exists & (ls[k] > V(LOG_SCALE_MIN)) & (ls[k] < V(LOG_SCALE_MAX));
    const realV regular = fma(V(in->weight_scale), exp(ls[k]), choose(active, dls[k], zero));
    PUT(lr_position, P_POSITION + k, x[k], &had[P_POSITION + k], choose(active, dx[k], zero));
    PUT(lr_scale, P_LOG_SCALE + k, ls[k], &had[P_LOG_SCALE + k], choose(free_scale, regular, zero));
  }
#pragma unroll
  for (int k = 0; k < 4; k++)
    PUT(lr_rotation, P_ROTATION + k, q[k], &had[P_ROTATION + k], choose(active, dq[k], zero));
  const realV dlogit = fma(s[0], complement, in->weight_opacity * sigmoid(logit) * complement);
  PUT(lr_opacity, P_OPACITY, logit, &had[P_OPACITY], choose(exists & (logit == logit), dlogit, zero));
  put_colors(params, stride, i, out, d, basis);
}

#if ANTI_ALIAS
#define FILTER __global const real *filter, // in [stride] see project
#define FILTER_ARGUMENT filter,
#else
#define FILTER
#define FILTER_ARGUMENT
#endif
#define IN {params, stride, count, FILTER_ARGUMENT cam, isect_start, isect_counts, sums, weight_opacity, weight_scale}

#if TAKE_STEP && UPDATE_RUN != VW
// Asks for the moments of one plane of UPDATE_RUN Gaussians.
static inline void ask_for_moments(const Adam *adam, uint plane, uint first) {
  for (uint at = 0; at < UPDATE_RUN; at += LINE) {
    const size_t i = (size_t)plane * adam->stride + first + at;
    ASK_FOR_TO_WRITE(adam->moment1 + i);
    ASK_FOR_TO_WRITE(adam->moment2 + i);
  }
}
#endif

#if TAKE_STEP
// Launch: one work-item per UPDATE_RUN Gaussians: VW where a work-item is one of many, more of them where it is a whole core, which
// reads a plane after the other then, along cache lines. Nothing is changed after a pair overflow: the host repeats the iteration.
__kernel void project_step(__global real *params, uint stride, uint count, // in/out [planes, stride]
                           FILTER
                           const Camera cam, __global const uint *isect_start, // in [count] first emission slot
                           __global const uint *isect_counts,                  // in [count]
                           __global const real *sums,                          // in [pairs, SUMS]
                           real weight_opacity, // lambda_o / N
                           real weight_scale,   // lambda_s / (3 N), per local unit
                           ADAM_ARGUMENTS,      // moments in/out [planes, stride]
                           volatile __global uint *status) { // in S_OVERFLOW, out S_NON_FINITE
  const uint first = get_global_id(0) * UPDATE_RUN;
  if (first >= count || status[S_OVERFLOW] != 0) return;
  const In in = IN;
  const Adam adam = ADAM;
  uint bad = 0;
#if UPDATE_RUN == VW
  const Out out = {&adam, first, &bad};
  gaussian_grads(&in, first, &out);
#else
  for (uint plane = 0; plane < PLANES_AHEAD; plane++) ask_for_moments(&adam, plane, first);
  real grads[(P_SH + 3 * SH_COUNT) * UPDATE_RUN];
  for (uint at = 0; at < UPDATE_RUN; at += VW) {
    const Out out = {grads, UPDATE_RUN, at, 0};
    gaussian_grads(&in, first + at, &out);
  }
  for (uint plane = 0; plane < P_SH + 3 * SH_COUNT; plane++) {
    if (plane + PLANES_AHEAD < P_SH + 3 * SH_COUNT) ask_for_moments(&adam, plane + PLANES_AHEAD, first);
    for (uint at = 0; at < UPDATE_RUN; at += LINE) ASK_FOR(params + (size_t)plane * stride + first + UPDATE_RUN + at); // of the next run
    for (uint at = 0; at < UPDATE_RUN; at += VW) {
      const uint i = first + at;
      Moments had;
      adam_moments(&adam, plane, i, &had);
      bad += adam_step(&adam, RATE(plane), plane, i, PLANE(params, plane), &had, vload_real(0, grads + plane * UPDATE_RUN + at));
    }
  }
#endif
  count_bad(bad, status);
}
#else
// Launch: one work-item per VW Gaussians of a block. Nothing is written after a pair overflow.
__kernel void project_grad(__global const real *params, uint stride, uint count, // in [planes, stride]
                           FILTER
                           uint first, uint grad_stride,                         // block: first Gaussian, room
                           uint adds,                                            // to what grads has, or writes over it
                           const Camera cam, __global const uint *isect_start,    // in [count] first emission slot
                           __global const uint *isect_counts,                     // in [count]; counted only
                           __global const uint *status,                          // in S_OVERFLOW
                           __global const real *sums,                            // in [pairs, SUMS]
                           real weight_opacity, // lambda_o / N
                           real weight_scale,   // lambda_s / (3 N), per local unit
                           __global real *grads) { // in/out [planes, grad_stride] of the block
  const uint at = get_global_id(0) * VW, i = first + at;
  if (at >= grad_stride || i >= count || status[S_OVERFLOW] != 0) return;
  const In in = IN;
  const Out out = {grads, grad_stride, at, adds};
  gaussian_grads(&in, i, &out);
}
#endif
