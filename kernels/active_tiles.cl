// active_tiles: the tiles of a masked photo in which any pixel counts (the others get no pairs), or those of a transparent photo in
// which any pixel is not clear; of tiles of which the photo's array has no rows, none. Launch: one work-item per tile. Not built for
// photos that are neither.

__kernel void active_tiles(__global const uchar *photo, // in [4, photo_rows, width] from row photo_first on; plane 3 is the mask, or alpha
                           int width, int photo_first, int photo_rows, int tiles_x, int tiles,
                           __global uint *active) { // out [tiles] 0 or 1
  const int tile = get_global_id(0);
  if (tile >= tiles) return;
  const int x0 = tile % tiles_x * TILE, row0 = tile / tiles_x * TILE - photo_first;
  __global const uchar *mask = photo + (size_t)3 * width * photo_rows;
  uint any_pixel = 0;
  for (int row = max(row0, 0); row < min(row0 + TILE, photo_rows) && !any_pixel; row++)
    for (int x = x0; x < min(x0 + TILE, width); x++) any_pixel |= mask[(size_t)row * width + x];
  active[tile] = any_pixel != 0;
}
