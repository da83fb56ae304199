// filter: standard deviation of each Gaussian's 3D smoothing filter: sqrt(FILTER_VARIANCE) times the finest distance
// between samples that any training view takes at its centre, z/f. What no view sees gets the largest of the others; if no
// Gaussian is seen at all, none is filtered.
// Launch: filter_views and filter_unseen a work-item per VW Gaussians, filter_largest one per chunk, FILTER_CHUNKS of them
// (a work-group of TILE x TILE where that shares a chunk).
// A view sees a centre beyond the near plane whose projection lies in the image, widened by FILTER_MARGIN of its width and
// height on each side; a non-finite centre is seen by none. Least and largest do not depend on the order of anything.
// Nothing is changed after a pair overflow: the host repeats the iteration. Source: Yu et al., Mip-Splatting, CVPR 2024,
// Eq. 6 to 8; margin and what is unseen as in the released implementation.
#include "chunks.clh"
#include "gaussians.clh"

__kernel void filter_views(__global const real *params, uint stride, uint count, // in [planes, stride]
                           __global const Camera *cameras, uint views,           // in [views] of the training views
                           __global const uint *status,                          // in S_OVERFLOW
                           __global real *filter) { // out [stride] local units; 0: seen by no view
  const uint i = get_global_id(0) * VW;
  if (i >= count || status[S_OVERFLOW] != 0) return;
  const realV far = V(R(1e30));
  realV x[3], t[3], least = far;
  for (int k = 0; k < 3; k++) x[k] = PLANE(params, P_POSITION + k);
  for (uint v = 0; v < views; v++) {
    const Camera cam = cameras[v];
    to_camera(&cam, x, t);
    const real width = (real)cam.width, height = (real)cam.height;
    const realV px = fma(V(cam.fx), t[0] / t[2], V(cam.cx)), py = fma(V(cam.fy), t[1] / t[2], V(cam.cy));
    const maskV seen = (t[2] > V(cam.near)) & (px >= V(-(real)FILTER_MARGIN * width)) &
                       (px <= V((R(1.0) + (real)FILTER_MARGIN) * width)) & (py >= V(-(real)FILTER_MARGIN * height)) &
                       (py <= V((R(1.0) + (real)FILTER_MARGIN) * height));
    least = choose(seen, fmin(least, t[2] / V(fmax(cam.fx, cam.fy))), least);
  }
  vstore_real(choose(least < far, sqrt((real)FILTER_VARIANCE) * least, V(R(0.0))), 0, filter + i);
}

CHUNK_KERNEL void filter_largest(uint count, __global const uint *status, // in S_OVERFLOW
                                 __global const real *filter,             // in [stride]
                                 __global real *largest) {                // out [FILTER_CHUNKS] of each chunk
  const uint chunk = CHUNK;
  if (chunk >= FILTER_CHUNKS || status[S_OVERFLOW] != 0) return;
  const uint length = (count + FILTER_CHUNKS - 1) / FILTER_CHUNKS;
  const uint end = min(count, (chunk + 1) * length);
  real most = R(0.0);
  for (uint i = chunk * length + ITEM; i < end; i += GROUP) most = fmax(most, filter[i]);
#if GROUP_STYLE
  __local real found[GROUP];
  found[ITEM] = most;
  for (uint near = GROUP / 2; near > 0; near /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    if (ITEM < near) found[ITEM] = fmax(found[ITEM], found[ITEM + near]);
  }
  most = found[0]; // as work-item 0 left it
#endif
  if (ITEM == 0) largest[chunk] = most;
}

__kernel void filter_unseen(uint count, __global const uint *status, // in S_OVERFLOW
                            __global real *filter,                   // in/out [stride]
                            __global const real *largest) {          // in [FILTER_CHUNKS]
  const uint i = get_global_id(0) * VW;
  if (i >= count || status[S_OVERFLOW] != 0) return;
  const realV own = vload_real(0, filter + i);
  const maskV seen = own > V(R(0.0));
  if (all_lanes(seen)) return;
  real most = R(0.0);
  for (uint k = 0; k < FILTER_CHUNKS; k++) most = fmax(most, largest[k]);
  vstore_real(choose(seen, own, V(most)), 0, filter + i);
}
