// noise: a random step of every position after the optimiser's: x += rate * Sigma * xi * sigmoid(-steepness * (o - x0)),
// xi ~ N(0, I), so that Gaussians that hardly show explore along their own shape and opaque ones stay.
// Launch: one work-item per VW Gaussians. Numbers are keyed by (seed, stream, index) like the host's (src/base/rng.rs), whatever
// the launch; a step to a non-finite position is not taken. Nothing is changed after a pair overflow: the host repeats
// the iteration. Source: [MCMC] Eq. 8; Philox4x32-10 of Salmon et al., SC 2011; Box and Muller 1958.
#include "gaussians.clh"

#if VW == 1
#define TO_REALV(u) ((real)(u))
#else
#define TO_REALV(u) CAT(convert_, CAT(REAL_NAME, VW))(u)
#endif

#define UNIT_32 R(2.3283064365386963e-10) // 2^-32

static inline void philox(uintV c[4], uint key0, uint key1) {
  for (int round = 0; round < 10; round++, key0 += 0x9E3779B9u, key1 += 0xBB67AE85u) {
    const uintV m0 = (uintV)(0xD2511F53u), m1 = (uintV)(0xCD9E8D57u);
    const uintV lo0 = m0 * c[0], hi0 = mul_hi(m0, c[0]), lo1 = m1 * c[2], hi1 = mul_hi(m1, c[2]);
    c[0] = hi1 ^ c[1] ^ (uintV)(key0);
    c[1] = lo1;
    c[2] = hi0 ^ c[3] ^ (uintV)(key1);
    c[3] = lo0;
  }
}

// Two standard normal numbers from two words. -ln((a + 1) / 2^32) by whichever of log and log1p has no cancellation.
static inline void normal_pair(uintV a, uintV b, realV *x, realV *y) {
  const realV from_zero = (TO_REALV(a) + R(1.0)) * UNIT_32, from_one = TO_REALV(~a) * UNIT_32;
  const realV minus_ln = choose(from_one < V(R(0.5)), -log1p(-from_one), -log(from_zero));
  const realV radius = sqrt(R(2.0) * minus_ln), half_turns = TO_REALV(b) * (R(2.0) * UNIT_32);
  *x = radius * cospi(half_turns);
  *y = radius * sinpi(half_turns);
}

__kernel void noise(uint stride, uint count,
                    uint first_row,                    // row of the first in the whole set
                    uint seed_low, uint seed_high,     // of the run
                    uint stream_low, uint stream_high, // purpose and iteration
                    real rate,                         // times the position's learning rate, local units
                    real steepness, real x0,           // of the gate over opacity
                    __global const uint *status,       // in S_OVERFLOW: then nothing is changed
                    __global real *params) {           // in/out [planes, stride]; positions are written
  const uint i = get_global_id(0) * VW;
  if (i >= count || status[S_OVERFLOW] != 0) return;
  uint index[VW];
  real row[VW];
  for (uint l = 0; l < VW; l++) {
    index[l] = first_row + i + l;
    row[l] = i + l < count ? R(1.0) : R(0.0);
  }
#if VW == 1
  uintV words[4] = {index[0], 0u, stream_low, stream_high};
#else
  uintV words[4] = {CAT(vload, VW)(0, index), (uintV)(0u), (uintV)(stream_low), (uintV)(stream_high)};
#endif
  philox(words, seed_low, seed_high);
  realV xi[4], q[4], n[4], rot[9], inv_norm;
  normal_pair(words[0], words[1], xi, xi + 1);
  normal_pair(words[2], words[3], xi + 2, xi + 3); // the fourth is not used
  for (int k = 0; k < 4; k++) q[k] = PLANE(params, P_ROTATION + k);
  unit_quaternion(q, n, &inv_norm);
  rotation_matrix(n, rot);
  realV own[3]; // S^2 R^T xi
  for (int k = 0; k < 3; k++) {
    const realV s = exp(clamp(PLANE(params, P_LOG_SCALE + k), V(LOG_SCALE_MIN), V(LOG_SCALE_MAX)));
    own[k] = s * s * fma(rot[k], xi[0], fma(rot[3 + k], xi[1], rot[6 + k] * xi[2]));
  }
  const realV o = sigmoid(PLANE(params, P_OPACITY));
  const realV gate = rate * sigmoid(-steepness * (o - V(x0)));
  const maskV exists = vload_real(0, row) > V(R(0.0));
  for (int k = 0; k < 3; k++) {
    const realV old = PLANE(params, P_POSITION + k), next = fma(gate, dot3(rot + 3 * k, own), old);
    vstore_real(choose(exists & isfinite(next), next, old), 0, params + (size_t)(P_POSITION + k) * stride + i);
  }
}
