// edit: writes the rows that density control decided on. Row src is copied to dst, then position, log-scale and opacity
// are replaced and the moments of dst are zeroed. Launch: (edits, planes) work-items; the order of edits does not matter
// (no dst of one edit is the src of another, unless src == dst).

typedef struct {
  uint src, dst;
  float position[3], log_scale[3], opacity_logit;
} Edit;

__kernel void edit(__global const Edit *edits, uint count, uint stride, // in [count]
                   __global real *params, __global real *moment1, __global real *moment2) { // in/out [planes, stride]
  const uint e = get_global_id(0), plane = get_global_id(1);
  if (e >= count) return;
  const Edit row = edits[e];
  const size_t at = (size_t)plane * stride + row.dst;
  real value = params[(size_t)plane * stride + row.src];
  if (plane < P_LOG_SCALE) value = row.position[plane - P_POSITION];
  else if (plane < P_ROTATION) value = row.log_scale[plane - P_LOG_SCALE];
  else if (plane == P_OPACITY) value = row.opacity_logit;
  params[at] = value;
  moment1[at] = R(0.0);
  moment2[at] = R(0.0);
}
