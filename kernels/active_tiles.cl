// active_tiles: the tiles of a masked photo in which any pixel counts (the others get no pairs), or those of a transparent photo in
// which any pixel is not clear. Launch: one work-item per tile. Not built for photos that are neither.

__kernel void active_tiles(__global const uchar *photo, // in [4, height, width], plane 3 is the mask, or alpha
                           int width, int height, int tiles_x, int tiles,
                           __global uint *active) { // out [tiles] 0 or 1
  const int tile = get_global_id(0);
  if (tile >= tiles) return;
  const int x0 = tile % tiles_x * TILE, y0 = tile / tiles_x * TILE;
  __global const uchar *mask = photo + (size_t)3 * width * height;
  uint any_pixel = 0;
  for (int y = y0; y < min(y0 + TILE, height) && !any_pixel; y++)
    for (int x = x0; x < min(x0 + TILE, width); x++) any_pixel |= mask[(size_t)y * width + x];
  active[tile] = any_pixel != 0;
}
