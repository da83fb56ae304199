// peak: what the device can do at best, for the shares that `mhsplat bench` prints. Two kernels that do nothing but
// fused multiply-adds in registers, and nothing but moving vectors through memory. Not part of an iteration.
#include "lanes.clh"

// Launch: any number of work-items. Every lane of each of CHAINS independent chains c goes x -> a x + b, `steps` times from c + 1, and the
// chains' sum is written so that nothing can be left out. 2 * CHAINS * VW * steps FLOP per work-item.
__kernel void peak_fma(uint items, uint steps, real a, real b,
                       __global real *out) { // out [items, VW]
  const uint i = get_global_id(0);
  if (i >= items) return;
  const realV factor = (realV)(a), term = (realV)(b);
  realV x[CHAINS], sum = (realV)(R(0.0));
  for (int c = 0; c < CHAINS; c++) x[c] = (realV)((real)(c + 1));
  for (uint k = 0; k < steps; k++) {
#pragma unroll
    for (int c = 0; c < CHAINS; c++) x[c] = fma(x[c], factor, term);
  }
  for (int c = 0; c < CHAINS; c++) sum += x[c];
  vstore_real(sum, i, out);
}

// Launch: one work-item per vector. Moves 2 * VW * sizeof(real) bytes (read and written).
__kernel void peak_copy(__global const real *in, uint vectors, // in [vectors, VW]
                        __global real *out) {                  // out [vectors, VW]
  const uint i = get_global_id(0);
  if (i >= vectors) return;
  vstore_real(vload_real(i, in), i, out);
}
