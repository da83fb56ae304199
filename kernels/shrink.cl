// shrink: a photo at num/den of its size.
// Launch: (SHRINK_RUN pixels of a row, rows of all planes) work-items. An output pixel is the mean of the den/num x den/num input
// pixels that it covers, each by the area that is covered, rounded to nearest (area filter, exact in integers; alpha is premultiplied,
// so that plain means are right). Rows and columns that do not fill an output pixel are left out: the camera keeps its pixel grid.

// Length that output pixel `to` covers of input pixel `from`, in 1/num of an input pixel.
int covered(int to, int from, int num, int den) {
  return min((from + 1) * num, (to + 1) * den) - max(from * num, to * den);
}

__kernel void shrink(__global const uchar *photo, // in [planes, height, width]
                     int width, int height, int planes, int num, int den,
                     __global uchar *small) { // out [planes, height * num / den, width * num / den]
  const int to_width = width * num / den, to_height = height * num / den;
  const int x0 = get_global_id(0) * SHRINK_RUN, row = get_global_id(1);
  if (x0 >= to_width || row >= planes * to_height) return;
  __global const uchar *plane = photo + (size_t)(row / to_height) * (size_t)height * (size_t)width;
  const int to_y = row % to_height, y_end = ((to_y + 1) * den + num - 1) / num;
  const uint area = den * den;
  const int end = min(x0 + SHRINK_RUN, to_width);
  for (int x = x0; x < end; x++) {
    const int x_end = ((x + 1) * den + num - 1) / num;
    uint sum = 0;
    for (int y = to_y * den / num; y < y_end; y++) {
      uint line = 0;
      for (int k = x * den / num; k < x_end; k++)
        line += covered(x, k, num, den) * plane[(size_t)y * width + (size_t)k];
      sum += covered(to_y, y, num, den) * line;
    }
    small[(size_t)row * to_width + x] = (uchar)((sum + area / 2) / area);
  }
}
