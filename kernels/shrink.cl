// shrink: a photo at a 1/factor of its size, for the early part of a run.
// Launch: (SHRINK_RUN pixels of a row, rows of all planes) work-items. Every output pixel is the mean of factor x factor
// input pixels, rounded to nearest (area filter; alpha is premultiplied, so that plain means are right). Rows and columns
// that do not fill an output pixel are left out: the camera keeps its pixel grid.

__kernel void shrink(__global const uchar *photo, // in [planes, height, width]
                     int width, int height, int planes, int factor,
                     __global uchar *small) { // out [planes, height / factor, width / factor]
  const int to_width = width / factor, to_height = height / factor;
  const int x0 = get_global_id(0) * SHRINK_RUN, row = get_global_id(1);
  if (x0 >= to_width || row >= planes * to_height) return;
  __global const uchar *from =
      photo + ((size_t)(row / to_height) * (size_t)height + (size_t)(row % to_height * factor)) * (size_t)width;
  const uint area = factor * factor;
  const int end = min(x0 + SHRINK_RUN, to_width);
  for (int x = x0; x < end; x++) {
    uint sum = 0;
    for (int y = 0; y < factor; y++)
      for (int k = 0; k < factor; k++) sum += from[(size_t)y * width + (size_t)(x * factor + k)];
    small[(size_t)row * to_width + x] = (uchar)((sum + area / 2) / area);
  }
}
