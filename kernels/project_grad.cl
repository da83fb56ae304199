// project_grad: the nine sums of each Gaussian -> gradients of its raw parameters, regularisers included.
// Launch: one work-item per Gaussian; culled ones get the regularisers alone. A Gaussian's pairs are added in the order
// of their tiles. Source: chain rule through M = J W R S (see common.clh), [MH] Eq. 4 for the regularisers.

#define SUMS 9

// dL/d(unit quaternion) from dL/dR, then through the normalisation.
static inline void quaternion_grad(const real n[4], real inv_norm, const real d[9], real out[4]) {
  const real w = n[0], x = n[1], y = n[2], z = n[3];
  real g[4];
  g[0] = R(2.0) * (x * (d[7] - d[5]) + y * (d[2] - d[6]) + z * (d[3] - d[1]));
  g[1] = R(2.0) * (w * (d[7] - d[5]) + y * (d[1] + d[3]) + z * (d[2] + d[6]) - R(2.0) * x * (d[4] + d[8]));
  g[2] = R(2.0) * (w * (d[2] - d[6]) + x * (d[1] + d[3]) + z * (d[5] + d[7]) - R(2.0) * y * (d[0] + d[8]));
  g[3] = R(2.0) * (w * (d[3] - d[1]) + x * (d[2] + d[6]) + y * (d[5] + d[7]) - R(2.0) * z * (d[0] + d[4]));
  const real along = g[0] * w + g[1] * x + g[2] * y + g[3] * z;
  for (int k = 0; k < 4; k++) out[k] = (g[k] - along * n[k]) * inv_norm;
}

// Gradient of the SH basis, contracted with weight[k] = sum_channels dL/dcolour * coefficient.
static inline void sh_direction_grad(const real d[3], const real *weight, real out[3]) {
  out[0] = out[1] = out[2] = R(0.0);
#if SH_DEGREE > 0
  out[1] -= R(0.4886025119029199) * weight[1];
  out[2] += R(0.4886025119029199) * weight[2];
  out[0] -= R(0.4886025119029199) * weight[3];
#endif
#if SH_DEGREE > 1
  const real x = d[0], y = d[1], z = d[2];
  const real c4 = R(1.0925484305920792), c6 = R(0.31539156525252005), c8 = R(0.5462742152960396);
  out[0] += c4 * (y * weight[4] - z * weight[7]) - R(2.0) * c6 * x * weight[6] + R(2.0) * c8 * x * weight[8];
  out[1] += c4 * (x * weight[4] - z * weight[5]) - R(2.0) * c6 * y * weight[6] - R(2.0) * c8 * y * weight[8];
  out[2] += -c4 * (y * weight[5] + x * weight[7]) + R(4.0) * c6 * z * weight[6];
#endif
#if SH_DEGREE > 2
  const real xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
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

// Colour gradient -> SH coefficient gradients (written) and position gradient (added).
static inline void color_grad(__global const real *params, __global real *grads, uint stride, uint i,
                              const Camera *cam, const real x[3], const real dcolor[3], real dx[3]) {
  real dir[3], basis[SH_COUNT], weight[SH_COUNT];
  const real inv_distance = view_direction(cam, x, dir);
  sh_basis(dir, basis);
  for (int k = 0; k < SH_COUNT; k++) weight[k] = R(0.0);
  for (int ch = 0; ch < 3; ch++) {
    real sum = R(0.5);
    for (int k = 0; k < SH_COUNT; k++) sum = fma(basis[k], params[(size_t)(P_SH + 3 * k + ch) * stride + i], sum);
    const real d = sum > R(0.0) ? dcolor[ch] : R(0.0);
    for (int k = 0; k < SH_COUNT; k++) {
      const size_t at = (size_t)(P_SH + 3 * k + ch) * stride + i;
      grads[at] = d * basis[k];
      weight[k] = fma(d, params[at], weight[k]);
    }
  }
  real dd[3];
  sh_direction_grad(dir, weight, dd);
  const real along = dd[0] * dir[0] + dd[1] * dir[1] + dd[2] * dir[2];
  for (int k = 0; k < 3; k++) dx[k] = fma(dd[k] - along * dir[k], inv_distance, dx[k]);
}

// The sums' geometric part -> position, log-scale and quaternion gradients.
static inline void shape_grad(const Camera *cam, const Shape *o, const real s[SUMS], real dx[3], real dls[3],
                              real dq[4]) {
  const real ka = o->syy / o->det, kc = R(1.0) / o->syy, r = o->sxy / o->syy;
  // dL/dmean and G = K Q K with K = P^T diag(ka, kc) P, P = [[1, -r], [0, 1]]
  const real mx = ka * s[1], my = fma(-r, mx, kc * s[2]);
  const real e00 = ka * ka * s[3], e01 = ka * kc * s[4], e11 = kc * kc * s[5];
  const real g00 = e00, g01 = fma(-r, e00, e01), g11 = fma(r, fma(r, e00, -R(2.0) * e01), e11);
  real dm[6], dt[3] = {R(0.0), R(0.0), R(0.0)}, djw[6], drot[9];
  for (int k = 0; k < 3; k++) {
    dm[k] = fma(g00, o->m[k], g01 * o->m[3 + k]);
    dm[3 + k] = fma(g01, o->m[k], g11 * o->m[3 + k]);
    dls[k] = fma(dm[k], o->m[k], dm[3 + k] * o->m[3 + k]);
    dm[k] *= o->s[k]; // now dL/d(J W R)
    dm[3 + k] *= o->s[k];
  }
  for (int a = 0; a < 3; a++) {
    djw[a] = djw[3 + a] = R(0.0);
    for (int k = 0; k < 3; k++) {
      drot[3 * a + k] = fma(o->jw[a], dm[k], o->jw[3 + a] * dm[3 + k]);
      djw[a] = fma(dm[k], o->rot[3 * a + k], djw[a]);
      djw[3 + a] = fma(dm[3 + k], o->rot[3 * a + k], djw[3 + a]);
    }
  }
  quaternion_grad(o->n, o->inv_norm, drot, dq);
  // J's rows are jx (W0 - u W2) and jy (W1 - v W2) with jx = fx/z
  const real jx = cam->fx * o->iz, jy = cam->fy * o->iz;
  real d0 = R(0.0), d1 = R(0.0), du = R(0.0), dv = R(0.0);
  for (int k = 0; k < 3; k++) {
    d0 = fma(djw[k], o->jw[k], d0);
    d1 = fma(djw[3 + k], o->jw[3 + k], d1);
    du = fma(-djw[k] * jx, cam->w[6 + k], du);
    dv = fma(-djw[3 + k] * jy, cam->w[6 + k], dv);
  }
  dt[2] = -(d0 + d1) * o->iz;
  const real u = o->t[0] * o->iz, v = o->t[1] * o->iz;
  const real du_all = fma(mx, cam->fx, o->u_free ? du : R(0.0)), dv_all = fma(my, cam->fy, o->v_free ? dv : R(0.0));
  dt[0] = du_all * o->iz;
  dt[1] = dv_all * o->iz;
  dt[2] -= (du_all * u + dv_all * v) * o->iz;
  for (int k = 0; k < 3; k++)
    dx[k] = fma(cam->w[k], dt[0], fma(cam->w[3 + k], dt[1], cam->w[6 + k] * dt[2]));
}

__kernel void project_grad(__global const real *params, uint stride, uint count, // in [planes, stride]
                           const Camera cam, __global const uint *pair_start,    // in [count] first emission slot
                           __global const uint *pair_counts,                     // in [count]
                           __global const real *sums,                            // in [pairs, SUMS]
                           real weight_opacity, // lambda_o / N
                           real weight_scale,   // lambda_s / (3 N), per local unit
                           __global real *grads) { // out [planes, stride]
  const uint i = get_global_id(0);
  if (i >= count) return;
  real x[3], ls[3], q[4], dx[3] = {R(0.0), R(0.0), R(0.0)}, dls[3] = {R(0.0), R(0.0), R(0.0)};
  real dq[4] = {R(0.0), R(0.0), R(0.0), R(0.0)}, s[SUMS];
  for (int k = 0; k < SUMS; k++) s[k] = R(0.0);
  for (int k = 0; k < 3; k++) ls[k] = params[(size_t)(P_LOG_SCALE + k) * stride + i];
  const real logit = params[(size_t)P_OPACITY * stride + i];
  const uint pairs = pair_counts[i];
  if (pairs > 0) {
    __global const real *from = sums + (size_t)pair_start[i] * SUMS;
    for (uint p = 0; p < pairs; p++)
      for (int k = 0; k < SUMS; k++) s[k] += from[(size_t)p * SUMS + k];
    for (int k = 0; k < 3; k++) x[k] = params[(size_t)(P_POSITION + k) * stride + i];
    for (int k = 0; k < 4; k++) q[k] = params[(size_t)(P_ROTATION + k) * stride + i];
    Shape o;
    if (shape_of(&cam, x, ls, q, &o)) {
      shape_grad(&cam, &o, s, dx, dls, dq);
      color_grad(params, grads, stride, i, &cam, x, s + 6, dx);
    }
  } else {
    for (int k = 0; k < 3 * SH_COUNT; k++) grads[(size_t)(P_SH + k) * stride + i] = R(0.0);
  }
  for (int k = 0; k < 3; k++) {
    const int free_scale = ls[k] > (real)LOG_SCALE_MIN && ls[k] < (real)LOG_SCALE_MAX;
    grads[(size_t)(P_POSITION + k) * stride + i] = dx[k];
    grads[(size_t)(P_LOG_SCALE + k) * stride + i] =
        free_scale ? fma(weight_scale, exp(ls[k]), dls[k]) : R(0.0);
  }
  for (int k = 0; k < 4; k++) grads[(size_t)(P_ROTATION + k) * stride + i] = dq[k];
  const real o = sigmoid(logit), complement = sigmoid(-logit);
  grads[(size_t)P_OPACITY * stride + i] = fma(s[0], complement, weight_opacity * o * complement);
}
