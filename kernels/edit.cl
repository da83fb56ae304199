// edit: the set of Gaussians changes.

// Writes the rows that density control decided on. Rotation and SH coefficients of row src are copied to dst;
// position, log-scale, opacity and, if the row is coloured, the SH coefficients are replaced; the moments of dst are zeroed. Launch: (edits, planes) work-items. The
// order of edits does not matter: no dst is named twice, and a row that is a src is a dst only of its own edit, which
// writes none of the planes that others copy.

__kernel void edit(__global const Edit *edits, uint count, uint stride, // in [count]
                   __global real *params, __global real *moment1, __global real *moment2) { // in/out [planes, stride]
  const uint e = get_global_id(0), plane = get_global_id(1);
  if (e >= count) return;
  const Edit row = edits[e];
  const size_t at = (size_t)plane * stride + row.dst;
  if (plane < P_LOG_SCALE) params[at] = row.position[plane - P_POSITION];
  else if (plane < P_ROTATION) params[at] = row.log_scale[plane - P_LOG_SCALE];
  else if (plane == P_OPACITY) params[at] = row.opacity_logit;
  else if (plane >= P_SH && row.colored) params[at] = plane < P_SH + 3 ? row.color[plane - P_SH] : R(0.0);
  else if (row.src != row.dst) params[at] = params[(size_t)plane * stride + row.src];
  moment1[at] = R(0.0);
  moment2[at] = R(0.0);
}

// No opacity logit above `limit`; all moments of opacity are zeroed. Launch: one work-item per Gaussian. Source: [3DGS]
// section 5.2, the periodic reset.
__kernel void edit_limit_opacity(uint count, uint stride, real limit,
                                 __global real *params, __global real *moment1, __global real *moment2) { // in/out
  const uint i = get_global_id(0);
  if (i >= count) return;
  const size_t at = (size_t)P_OPACITY * stride + i;
  params[at] = fmin(params[at], limit);
  moment1[at] = R(0.0);
  moment2[at] = R(0.0);
}

// Rows of some planes in another order, those that `order` leaves out being gone. Launch: (stride, planes) work-items.
__kernel void edit_reorder(__global const uint *order, uint kept, uint stride, // in [kept] old row of each new one
                           uint first, __global const real *from,              // in [first + planes, stride]
                           __global real *to) {                                // out [planes, stride], 0 from `kept` on
  const uint i = get_global_id(0), plane = get_global_id(1);
  if (i >= stride) return;
  to[(size_t)plane * stride + i] = i < kept ? from[(size_t)(first + plane) * stride + order[i]] : R(0.0);
}

// The first planes of two arrays, side by side and without room between them, for one transfer. Launch: (count, planes of both)
// work-items.
__kernel void edit_pack(uint count, uint stride, uint planes, // planes of the first array
                        __global const real *params,          // in [planes, stride]
                        __global const real *statistics,      // in [rows, stride]
                        __global real *packed) {              // out [planes + rows, count]
  const uint i = get_global_id(0), plane = get_global_id(1);
  if (i >= count) return;
  packed[(size_t)plane * count + i] =
      plane < planes ? params[(size_t)plane * stride + i] : statistics[(size_t)(plane - planes) * stride + i];
}
