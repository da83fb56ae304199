// bin: visible Gaussians in depth order -> (tile, Gaussian) pairs, by tile and depth. Where a work-item is a whole core it is a stable
// counting sort: pairs are counted by chunk of Gaussians and tile, the sort stage turns the counts into places, and every pair goes
// straight to its own; no key of a pair is stored. Elsewhere the pairs are written in depth order, the sort stage sorts them by tile,
// and bin_ranges looks up where tiles begin.
#include "ahead.clh"
#include "chunks.clh"

// The minimum over the tile's pixel centres' rectangle of the record's quadratic form, against its reach: exact for a
// convex form, whose minimum lies at the mean or on an edge that faces the mean (StopThePop, Speedy-Splat intersect
// likewise). The minimum along the vertical line, and along the horizontal one, of the rectangle that is nearest to the mean: without
// branches, half of which would be foretold wrongly. TILE_SLACK covers f32 rounding: a pair too many costs time, a pair too few costs a pixel.
static inline int touches_tile(const Projected *g, real slope, real reach, int tx, int ty) {
  const real x0 = (real)(tx * TILE) + R(0.5) - g->x, x1 = x0 + (real)(TILE - 1);
  const real y0 = (real)(ty * TILE) + R(0.5) - g->y, y1 = y0 + (real)(TILE - 1);
  const real dx = min(max(x0, R(0.0)), x1), dy = min(max(y0, R(0.0)), y1);
  const real dy_of_line = min(max(slope * dx, y0), y1), dx_of_line = min(max(g->r * dy, x0), x1);
  const real u = fma(-g->r, dy_of_line, dx), v = fma(-g->r, dy, dx_of_line);
  return min(fma(g->a * u, u, g->c * dy_of_line * dy_of_line), fma(g->a * v, v, g->c * dy * dy)) <= reach;
}

// The tiles of a Gaussian's box, row by row. Up to MASKED of them are remembered as a mask, so that nobody decides again;
// larger boxes are walked again when they are emitted, by the same function.
#define MASKED 32

// Whether a box is small enough for a mask.
static inline int is_masked(const Projected *g) {
  const int w = BOUND_HI(g->bx) / TILE - BOUND_LO(g->bx) / TILE + 1;
  const int h = BOUND_HI(g->by) / TILE - BOUND_LO(g->by) / TILE + 1;
  return w <= MASKED && h <= MASKED && w * h <= MASKED;
}

// Photos with masks have tiles in which nothing counts; they get no pairs where `masked` says so.
#if HAS_MASK
#define ACTIVE_TILES __global const uint *active_tiles, int masked
#define MASK_ARGUMENTS ACTIVE_TILES,
#define ACTIVE_ARGUMENTS active_tiles, masked
#define IS_ACTIVE(tile) (!masked || active_tiles[tile])
#else
#define ACTIVE_TILES int unmasked
#define MASK_ARGUMENTS
#define ACTIVE_ARGUMENTS 0
#define IS_ACTIVE(tile) 1
#endif
// Arguments of the kernels that walk over the tiles of the visible Gaussians, which are in depth order; in [count], [visible], [tiles].
#define WALK_ARGUMENTS                                                                                                 \
  __global const Projected *records, __global const uint *visible, __global const uint *status, uint tiles_x, MASK_ARGUMENTS

#if GROUP_STYLE
// One Gaussian's pairs on their way to the sort by tile.
typedef struct {
  __global uint *keys, *values; // tile and slot, by slot
  __global uint *isect_owner;
  uint slot, owner;             // next slot, Gaussian
} Pairs;

static inline void add_pair(Pairs *pairs, uint tile) {
  const uint slot = pairs->slot++;
  pairs->keys[slot] = tile;
  pairs->values[slot] = slot;
  pairs->isect_owner[slot] = pairs->owner;
}
#else
// One Gaussian's pairs on their way to a chunk's counters, and to their places where `order` is given.
typedef struct {
  __global uint *counts;           // [tiles] of the chunk
  __global const uint *tile_start; // [tiles]
  __global uint *order, *isect_owner;
  uint slot, owner;                // next slot, Gaussian
} Pairs;

static inline void add_pair(Pairs *pairs, uint tile) {
  const uint before = pairs->counts[tile]++;
  if (!pairs->order) return;
  pairs->order[pairs->tile_start[tile] + before] = pairs->slot;
  pairs->isect_owner[pairs->slot++] = pairs->owner;
}
#endif

// Shape of a Gaussian's quadratic form: dy of its minimum along a vertical line, per dx; its largest value that counts.
static inline real slope_of(const Projected *g) { return g->a * g->r / fma(g->a * g->r, g->r, g->c); }
static inline real reach_of(const Projected *g) { return g->lo - (real)LOG2_ALPHA_MIN + (real)TILE_SLACK; }

// Counts the tiles touched, remembers them in *mask if they fit, and adds them to `pairs` where they are given.
static inline uint walk_tiles(const Projected *g, uint *mask, uint tiles_x, ACTIVE_TILES, Pairs *pairs) {
  const int tx0 = BOUND_LO(g->bx) / TILE, tx1 = BOUND_HI(g->bx) / TILE;
  const int ty0 = BOUND_LO(g->by) / TILE, ty1 = BOUND_HI(g->by) / TILE;
  const real slope = slope_of(g), reach = reach_of(g);
  uint n = 0, bits = 0, at = 0;
#if GROUP_STYLE
#pragma unroll 1 // gfx90a would take three times the registers
#endif
  for (int ty = ty0; ty <= ty1; ty++)
#if GROUP_STYLE
#pragma unroll 1
#endif
    for (int tx = tx0; tx <= tx1; tx++, at++)
      if (IS_ACTIVE((uint)ty * tiles_x + (uint)tx) && touches_tile(g, slope, reach, tx, ty)) {
        if (pairs) add_pair(pairs, (uint)ty * tiles_x + (uint)tx);
        bits |= 1u << (at % MASKED);
        n++;
      }
  *mask = bits;
  return n;
}

// Adds the tiles of a mask in the order in which walk_tiles sets its bits.
static inline void walk_mask(uint mask, uint tx0, uint ty0, uint width, uint tiles_x, Pairs *pairs) {
  for (uint ty = ty0; mask; ty++) {
    for (uint row = mask & (0xffffffffu >> (MASKED - width)); row; row &= row - 1)
      add_pair(pairs, ty * tiles_x + tx0 + (MASKED - 1 - clz(row & -row)));
    mask = width < MASKED ? mask >> width : 0;
  }
}

// Gaussians in the order of the whole set, in which those of equal depth are: `early` of them, from early_first on, stand behind those that
// come after them. In [count] depth bits or KEY_CULLED.
#define KEY_ARGUMENTS __global const uint *keys, uint count, uint early_first, uint early
// Place of Gaussian v of that order; where none is early, a loop over all of them is not to pay for it.
static inline uint place_of(uint v, uint early_first, uint early) {
  if (early == 0) return v;
  return v < early ? early_first + v : v < early_first + early ? v - early : v;
}
#define PLACE(v) place_of(v, early_first, early)

// Launch: over chunks of Gaussians. Counts the visible ones.
CHUNK_KERNEL void bin_visible(KEY_ARGUMENTS, uint chunks, __global uint *sums) { // out [chunks]
  SCRATCH;
  const uint c = CHUNK;
  if (c >= chunks) return;
  const uint size = chunk_size(count, chunks);
  const uint first = min(c * size, count), last = min(first + size, count);
  uint n = 0;
  for (uint v = first + ITEM; v < last; v += GROUP) n += keys[PLACE(v)] != KEY_CULLED;
  n = (uint)group_sum(n, scratch);
  if (ITEM == 0) sums[c] = n;
}

#if GROUP_STYLE
#define FIRST_PASS                                                                                                     \
  , uint bins, __global uint *histogram,     /* out [chunks, bins] lowest digits of each chunk's visible ones */       \
  __global uint *starts,                     /* out [chunks + 1] first of each chunk's visible ones, their number */     \
  uint pair_chunks, __global uint *pair_sums /* out [pair_chunks] 0, for bin_count */
#else
#define FIRST_PASS
#endif

// Launch: as bin_visible. Writes keys and indices of the visible ones, in the order of the set, and their number to the status; by groups it
// also counts for the first pass of their sort.
CHUNK_KERNEL void bin_compact(KEY_ARGUMENTS, uint chunks, __global const uint *sums, // in [chunks]
                              __global uint *visible_keys,            // out [visible]
                              __global uint *visible,                 // out [visible] Gaussian index
                              __global uint *status                   // out S_VISIBLE
                              FIRST_PASS) {
  SCRATCH;
  const uint c = CHUNK;
  if (c >= chunks) return;
  const uint size = chunk_size(count, chunks);
  const uint first = min(c * size, count), last = min(first + size, count);
#if GROUP_STYLE
  // Before the loop that has barriers.
  __local uint digits[GROUP];
  digits[ITEM] = 0;
  barrier(CLK_LOCAL_MEM_FENCE);
  for (uint v = first + ITEM; v < last; v += GROUP) {
    const uint key = keys[PLACE(v)];
    if (key != KEY_CULLED) atomic_inc(digits + digit_of(key, 0, bins)); // of integers: the same in any order
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  if (ITEM < bins) histogram[(size_t)c * bins + ITEM] = digits[ITEM];
  for (uint k = c * GROUP + ITEM; k < pair_chunks; k += chunks * GROUP) pair_sums[k] = 0;
#endif
  uint before = (uint)group_sum(sum_before(sums, c), scratch);
  if (c == chunks - 1 && ITEM == 0) status[S_VISIBLE] = before + sums[c];
#if GROUP_STYLE
  if (ITEM == 0) starts[c] = before;
  if (c == chunks - 1 && ITEM == 0) starts[chunks] = before + sums[c];
#endif
  for (uint block = first; block < last; block += GROUP) {
    const uint v = block + ITEM, i = PLACE(v), key = v < last ? keys[i] : KEY_CULLED;
    uint total;
    const uint at = before + group_scan(key != KEY_CULLED, scratch, &total);
    if (key != KEY_CULLED) {
      visible_keys[at] = key;
      visible[at] = i;
    }
    before += total;
  }
}

// Tiles and mask of a box as bin_emit takes them: first tile (12 bits, 12 bits) and width, or 0 where there is no mask.
static inline uint packed_box(const Projected *g) {
  const uint tx0 = BOUND_LO(g->bx) / TILE, ty0 = BOUND_LO(g->by) / TILE, width = BOUND_HI(g->bx) / TILE - tx0 + 1;
  return is_masked(g) ? tx0 | ty0 << 12 | width << 24 : 0;
}

// Adds the tiles of a packed box.
static inline void walk_box(uint mask, uint box, uint tiles_x, Pairs *pairs) {
  walk_mask(mask, box & 0xfffu, box >> 12 & 0xfffu, box >> 24, tiles_x, pairs);
}

#if GROUP_STYLE
// A large Gaussian's box of tiles.
typedef struct {
  Projected g;
  real slope, reach;
  uint tx0, ty0, width, tiles;
} Large;

static inline Large large_of(const Projected g) {
  const uint tx0 = BOUND_LO(g.bx) / TILE, ty0 = BOUND_LO(g.by) / TILE;
  const uint width = BOUND_HI(g.bx) / TILE - tx0 + 1, height = BOUND_HI(g.by) / TILE - ty0 + 1;
  const Large large = {g, slope_of(&g), reach_of(&g), tx0, ty0, width, width * height};
  return large;
}

// True if tile `at` of the box, row by row, is touched; its number goes to *tile.
static inline int touches_at(const Large *o, uint at, uint tiles_x, ACTIVE_TILES, uint *tile) {
  const uint tx = o->tx0 + at % o->width, ty = o->ty0 + at / o->width;
  *tile = ty * tiles_x + tx;
  return at < o->tiles && IS_ACTIVE(*tile) && touches_tile(&o->g, o->slope, o->reach, tx, ty);
}

// Launch: one work-group per `owns` Gaussians, by depth; those past the visible ones count none.
CHUNK_KERNEL void bin_count(WALK_ARGUMENTS
                            __global uint *cover,   // out [visible, 2] mask; packed box
                            __global uint *isect_counts, // out [count] tiles touched
                            uint count, __global uint *depth_counts, // out [count] the same by depth
                            uint pair_chunks, __global uint *pair_sums, // in 0, out [pair_chunks] of chunks by depth
                            uint owns) { // Gaussians of a group
  SCRATCH;
  __local uint large[GROUP], pairs[GROUP];
  const uint j = SPREAD_ITEM(ITEM);
  const int exists = ITEM < owns && j < status[S_VISIBLE];
  uint mask = 0, box = 0;
  pairs[ITEM] = 0;
  if (exists) {
    const Projected g = records[visible[j]];
    box = packed_box(&g);
    if (box) pairs[ITEM] = walk_tiles(&g, &mask, tiles_x, ACTIVE_ARGUMENTS, 0);
    cover[2 * j] = mask;
    cover[2 * j + 1] = box;
  }
  const uint n = list_large(exists && !box, large, scratch);
  for (uint k = 0; k < n; k++) {
    const Large o = large_of(records[visible[SPREAD_ITEM(large[k])]]);
    uint sum = 0, tile;
    for (uint at = ITEM; at < o.tiles; at += GROUP) sum += touches_at(&o, at, tiles_x, ACTIVE_ARGUMENTS, &tile);
    if (sum) atomic_add(pairs + large[k], sum); // of integers: the same in any order
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  if (exists) isect_counts[visible[j]] = pairs[ITEM];
  if (ITEM < owns && j < count) depth_counts[j] = pairs[ITEM];
  if (ITEM * SPREAD < owns) {
    uint sum = 0;
    for (uint k = 0; k < SPREAD; k++) sum += pairs[ITEM * SPREAD + k];
    // None has pairs beyond the visible ones.
    if (sum) atomic_add(pair_sums + SPREAD_ITEM(ITEM * SPREAD) / chunk_size(count, pair_chunks), sum); // of integers
  }
}

// Launch: as bin_count. Writes pairs in depth order, those of a Gaussian row by row of tiles; none after an overflow.
CHUNK_KERNEL void bin_emit(WALK_ARGUMENTS
                           __global const uint *cover,       // in, as bin_count wrote it
                           __global const uint *depth_start, // in [count] exclusive sums of depth_counts
                           __global uint *isect_start,       // out [count] first slot
                           __global uint *isect_owner,       // out [pairs] Gaussian index, by slot
                           __global uint *keys, __global uint *values, // out [pairs] tile and slot, by slot
                           uint owns) { // Gaussians of a group
  SCRATCH;
  __local uint large[GROUP];
  const uint j = SPREAD_ITEM(ITEM);
  const int exists = status[S_OVERFLOW] == 0 && ITEM < owns && j < status[S_VISIBLE];
  uint box = 0;
  if (exists) {
    Pairs pairs = {keys, values, isect_owner, depth_start[j], visible[j]};
    isect_start[pairs.owner] = pairs.slot;
    box = cover[2 * j + 1];
    if (box) walk_box(cover[2 * j], box, tiles_x, &pairs);
  }
  const uint n = list_large(exists && !box, large, scratch);
  for (uint k = 0; k < n; k++) {
    const uint at_depth = SPREAD_ITEM(large[k]), owner = visible[at_depth];
    const Large o = large_of(records[owner]);
    uint slot = depth_start[at_depth];
    for (uint block = 0; block < o.tiles; block += GROUP) {
      uint tile, total;
      const int touched = touches_at(&o, block + ITEM, tiles_x, ACTIVE_ARGUMENTS, &tile);
      Pairs pairs = {keys, values, isect_owner, slot + group_scan(touched, scratch, &total), owner};
      if (touched) add_pair(&pairs, tile);
      slot += total;
    }
  }
}

// Launch: one work-item per tile and one more. Looks up the first pair of each tile.
__kernel void bin_ranges(__global const uint *keys, __global const uint *status, // in [pairs] tiles in ascending order
                         uint tiles, __global uint *tile_start) {                // out [tiles + 1]
  const uint tile = get_global_id(0);
  if (tile > tiles) return;
  uint low = 0, high = status[S_INTERSECTIONS];
  while (low < high) {
    const uint middle = low + (high - low) / 2;
    if (keys[middle] < tile) low = middle + 1;
    else high = middle;
  }
  tile_start[tile] = low;
}
#else
// Adds the pairs of a chunk's Gaussians, which are contiguous in depth order; none after an overflow.
static inline void walk_chunk(uint chunk, uint chunks, __global const Projected *records, __global const uint *visible,
                              __global const uint *status, uint tiles_x, ACTIVE_TILES, __global const uint *cover,
                              __global const uint *isect_start, Pairs pairs) {
  if (status[S_OVERFLOW] != 0) return;
  const uint n = status[S_VISIBLE], size = chunk_size(n, chunks);
  const uint first = min(chunk * size, n), last = min(first + size, n);
  for (uint j = first; j < last; j++) {
    const uint box = cover[2 * j + 1];
    pairs.owner = visible[j];
    if (pairs.order) {
      pairs.slot = isect_start[pairs.owner];
      // A first slot is read to ask for its pair's place, and asked for as long before that.
      if (j + 2 * PAIRS_AHEAD < last) ASK_FOR(isect_start + visible[j + 2 * PAIRS_AHEAD]);
      if (j + PAIRS_AHEAD < last) ASK_FOR_TO_WRITE(pairs.isect_owner + isect_start[visible[j + PAIRS_AHEAD]]);
    }
    if (box) {
      walk_box(cover[2 * j], box, tiles_x, &pairs);
    } else {
      const Projected g = records[pairs.owner];
      uint mask;
      walk_tiles(&g, &mask, tiles_x, ACTIVE_ARGUMENTS, &pairs);
    }
  }
}

// The chunk of a work-item. The nearest Gaussians have the most pairs, and CPU drivers hand out ranges of work-items, half of
// them to begin with (PoCL 3.1): every second chunk comes first.
static inline uint dealt_chunk(uint id, uint chunks) {
  return 2 * id < chunks ? 2 * id : 2 * (id - (chunks + 1) / 2) + 1;
}

// Launch: one work-item per SPLAT_BATCH visible Gaussians, whose records are fetched together; those past the visible ones
// have nothing to do.
__kernel void bin_count(WALK_ARGUMENTS
                        __global uint *cover,   // out [visible, 2] mask; packed box
                        __global uint *isect_counts) { // out [count] tiles touched
  const uint first = get_global_id(0) * SPLAT_BATCH, visible_count = status[S_VISIBLE];
  if (first >= visible_count) return;
  const uint n = min((uint)SPLAT_BATCH, visible_count - first);
  Projected staged[SPLAT_BATCH];
  for (uint j = 0; j < n; j++) staged[j] = records[visible[first + j]];
  const uint ahead = first + n, last = ahead + min((uint)SPLAT_BATCH, visible_count - ahead);
  for (uint next = ahead; next < last; next++) {
    ASK_FOR_RECORD(records + visible[next]);
    ASK_FOR_TO_WRITE(isect_counts + visible[next]);
  }
  for (uint j = 0; j < n; j++) {
    const Projected *g = &staged[j];
    uint mask;
    isect_counts[visible[first + j]] = walk_tiles(g, &mask, tiles_x, ACTIVE_ARGUMENTS, 0);
    cover[2 * (first + j)] = mask;
    cover[2 * (first + j) + 1] = packed_box(g);
  }
}

// Launch: one work-item per chunk of visible Gaussians. Counts the pairs of each tile.
__kernel void bin_tiles(WALK_ARGUMENTS
                        __global const uint *cover,                               // in, as bin_count wrote it
                        uint tiles, uint chunks, __global uint *tile_counts) {    // out [chunks, tiles]
  if (get_global_id(0) >= chunks) return;
  const uint c = dealt_chunk(get_global_id(0), chunks);
  Pairs pairs = {tile_counts + (size_t)c * tiles, 0, 0, 0, 0, 0};
  for (uint t = 0; t < tiles; t++) pairs.counts[t] = 0;
  walk_chunk(c, chunks, records, visible, status, tiles_x, ACTIVE_ARGUMENTS, cover, 0, pairs);
}

// Launch: as bin_tiles. Puts pairs into their tiles in depth order; each is known by its slot, and slots are given out by
// Gaussian, so that project_grad finds a Gaussian's sums in one place and its neighbours' beside them.
__kernel void bin_emit(WALK_ARGUMENTS
                       __global const uint *cover,                          // in, as bin_count wrote it
                       uint tiles, uint chunks, __global uint *tile_counts, // in/out [chunks, tiles] pairs of the chunks before
                       __global const uint *tile_start,                     // in [tiles + 1]
                       __global const uint *isect_start,                    // in [count] exclusive sums of isect_counts
                       __global uint *order,                                // out [pairs] slot, by tile and depth
                       __global uint *isect_owner) {                        // out [pairs] Gaussian index, by slot
  if (get_global_id(0) >= chunks) return;
  const uint c = dealt_chunk(get_global_id(0), chunks);
  const Pairs pairs = {tile_counts + (size_t)c * tiles, tile_start, order, isect_owner, 0, 0};
  walk_chunk(c, chunks, records, visible, status, tiles_x, ACTIVE_ARGUMENTS, cover, isect_start, pairs);
}
#endif
