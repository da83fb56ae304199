//! Numbers of Gaussian centres per voxel: the c(v) of the sparsity prior (\[MH\] Eq. 7).
//!
//! The grid is only ever counted, so the store is a hash table of the occupied voxels with exact lattice keys, in 64 bits but for a
//! few far ones. It is split into shards by hash: each shard is filled by one task, and counts do not depend on the order of
//! counting, so the result is the same for any number of threads.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use crate::config::MhConfig;
use crate::density::mh::progress::lerp;

/// Number of shards, a power of two: enough tasks for any desktop, and each table of a million points
/// fits a first or second-level cache.
const SHARDS: usize = 256;
/// Number of points per task when keys are computed; a constant, so that the work does not depend on the number of threads.
const CHUNK: usize = 16_384;

/// Level of a voxel's edge and its lattice coordinates ⌊x/s⌋.
type Key = [i32; 4];

/// Greatest level: edges are doubled this often at most.
const MAX_LEVEL: i32 = 30;

/// Bits of a lattice coordinate in a packed key; ±1300 scene extents at the finest edge of the paper.
const BITS: u32 = 19;

/// A key in 64 bits; 0, which is none, if a coordinate is too large or no number.
#[inline]
fn pack(level: i32, lattice: [f64; 3]) -> u64 {
    const HALF: f64 = (1 << (BITS - 1)) as f64;
    // From 2⁵² on a number has no fraction: the lowest bits of the sum are those of the integer next to v, plus 2¹⁸. `f64::floor` is a
    // library call on baseline x86-64, and there are three per Gaussian.
    const ROUNDING: f64 = 1.5 * (1u64 << 52) as f64 + HALF;
    let (mut near, mut packed) = (true, 1 << 6 | level as u64);
    for v in lattice {
        near &= (-HALF..HALF).contains(&v);
        let sum = v + ROUNDING;
        let above = u32::from(sum - ROUNDING > v);
        packed = packed << BITS | u64::from((sum.to_bits() as u32).wrapping_sub(above));
    }
    if near { packed } else { 0 }
}

/// Division of space into voxels: cubes whose edge is the same everywhere, or grows with the distance from the cameras.
///
/// At distance d from the nearest camera centre the edge is s·2^l with l = ⌊log2(d/d₀)⌋, 0 for d < 2·d₀: the distance at
/// which two Gaussians can be distinguished grows with their depth, and a lattice of one edge s gives the far background
/// as many voxels per pixel as there are edges to a pixel's footprint. Powers of two keep counting a look-up by (l, ⌊x/s⌋).
#[derive(Debug, Clone, PartialEq)]
pub struct Lattice<'a> {
    edge: f64,
    /// 1/d₀², or 0 for one edge everywhere.
    growth: f64,
    centres: &'a [[f32; 3]],
}

impl<'a> Lattice<'a> {
    /// The lattice of one edge everywhere (\[MH\] Eq. 7), above 0, local units.
    #[must_use]
    pub fn uniform(edge: f64) -> Self {
        Self::growing(edge, 0.0, &[])
    }

    /// The lattice whose edge grows from distance `from` (d₀, local units) on; 0 or no camera centre means one edge everywhere.
    #[must_use]
    pub fn growing(edge: f64, from: f64, centres: &'a [[f32; 3]]) -> Self {
        let grows = from > 0.0 && !centres.is_empty();
        Self {
            edge,
            growth: if grows { 1.0 / (from * from) } else { 0.0 },
            centres,
        }
    }

    /// The lattice of density control at progress η, for these camera centres.
    #[must_use]
    pub fn at(config: &MhConfig, eta: f64, centres: &'a [[f32; 3]]) -> Self {
        let edge = lerp(config.voxel_edge, eta);
        Self::growing(edge, config.voxel_growth_from, centres)
    }

    /// Number of doublings of the edge at a position.
    #[must_use]
    pub fn level(&self, position: [f64; 3]) -> i32 {
        if self.growth == 0.0 {
            return 0;
        }
        let squared = |centre: &[f32; 3]| -> f64 {
            let along = |k: usize| position[k] - f64::from(centre[k]);
            (0..3).map(|k| along(k) * along(k)).sum()
        };
        let nearest = self.centres.iter().map(squared).fold(f64::MAX, f64::min);
        // ⌊log2(d/d₀)⌋ is half of the exponent of (d/d₀)², rounded down: no logarithm, and exact.
        let ratio = nearest * self.growth;
        let exponent = ((ratio.to_bits() >> 52) & 0x7FF) as i32 - 1023;
        exponent.div_euclid(2).clamp(0, MAX_LEVEL)
    }

    /// The level of a position and its coordinates x/s.
    #[inline]
    fn place(&self, position: [f64; 3]) -> (i32, [f64; 3]) {
        let level = self.level(position);
        let edge = self.edge * f64::from(1u32 << level);
        (level, position.map(|x| x / edge))
    }

    /// The key of the voxel around a place, however far; `None` at a non-finite one.
    fn key((level, lattice): (i32, [f64; 3])) -> Option<Key> {
        // Casts saturate; NaN and ±∞ are turned away first.
        let finite = lattice.iter().all(|v| v.is_finite());
        let [x, y, z] = lattice.map(|v| v.floor() as i32);
        finite.then_some([level, x, y, z])
    }
}

/// Occupied voxels of a cubic lattice and their counts.
#[derive(Debug, Clone)]
pub struct VoxelCounts<'a> {
    lattice: Lattice<'a>,
    shards: Vec<Shard>,
    /// Counts of the voxels whose keys cannot be packed.
    far: FxHashMap<Key, u32>,
}

impl<'a> VoxelCounts<'a> {
    /// Counts positions (x, y, z planes of equal length, local units) in voxels of edge `edge` (same unit, above 0).
    ///
    /// Lattice coordinates are ⌊x/edge⌋ in f64, saturated to 32 bits: beyond 2³¹ edges from the origin (10⁷ scene
    /// extents at the finest edge of the paper) voxels merge into the outermost one. Non-finite positions are in no voxel.
    #[must_use]
    pub fn count(positions: [&[f32]; 3], edge: f64) -> Self {
        Self::count_where(positions, Lattice::uniform(edge), |_| true)
    }

    /// [`VoxelCounts::count`] on any lattice, over the rows for which `keep` is true.
    #[must_use]
    pub fn count_where(
        positions: [&[f32]; 3],
        lattice: Lattice<'a>,
        keep: impl Fn(usize) -> bool + Sync,
    ) -> Self {
        let n = positions.iter().map(|p| p.len()).min().unwrap_or(0);
        let chunks: Vec<Chunk> = (0..n.div_ceil(CHUNK))
            .into_par_iter()
            .map_init(
                || vec![(0, 0); CHUNK],
                |found, c| {
                    let range = c * CHUNK..n.min((c + 1) * CHUNK);
                    Chunk::new(positions, &lattice, range, &keep, found)
                },
            )
            .collect();
        let shards = (0..SHARDS)
            .into_par_iter()
            .map(|s| {
                let points = chunks.iter().map(|c| c.shard(s).len()).sum();
                let mut shard = Shard::with_points(points);
                for chunk in &chunks {
                    for &key in chunk.shard(s) {
                        shard.add(key, hash(key));
                    }
                }
                shard
            })
            .collect();
        let mut counts = Self {
            lattice,
            shards,
            far: FxHashMap::default(),
        };
        for &key in chunks.iter().flat_map(|chunk| &chunk.far) {
            counts.add_far(Some(key));
        }
        counts
    }

    /// Number of centres in the voxel around a position; 0 at a non-finite one.
    #[must_use]
    pub fn get(&self, position: [f64; 3]) -> u32 {
        let place = self.lattice.place(position);
        match pack(place.0, place.1) {
            0 => {
                let far = Lattice::key(place).and_then(|key| self.far.get(&key));
                far.copied().unwrap_or(0)
            }
            key => {
                let hash = hash(key);
                self.shards[shard_of(hash)].get(key, hash)
            }
        }
    }

    /// Counts one more centre; a non-finite one is not counted.
    pub fn add(&mut self, position: [f64; 3]) {
        let place = self.lattice.place(position);
        match pack(place.0, place.1) {
            0 => self.add_far(Lattice::key(place)),
            key => {
                let hash = hash(key);
                self.shards[shard_of(hash)].add(key, hash);
            }
        }
    }

    /// Counts one centre less, which is one of those that were counted; a non-finite one was not.
    pub fn remove(&mut self, position: [f64; 3]) {
        let place = self.lattice.place(position);
        match pack(place.0, place.1) {
            0 => {
                let Some(key) = Lattice::key(place) else {
                    return;
                };
                if let Some(count) = self.far.get_mut(&key) {
                    *count = count.saturating_sub(1);
                    if *count == 0 {
                        self.far.remove(&key);
                    }
                }
            }
            key => {
                let hash = hash(key);
                self.shards[shard_of(hash)].remove(key, hash);
            }
        }
    }

    fn add_far(&mut self, key: Option<Key>) {
        if let Some(key) = key {
            let count = self.far.entry(key).or_insert(0);
            *count = count.saturating_add(1);
        }
    }

    /// Number of voxels that hold a centre.
    #[must_use]
    pub fn occupied(&self) -> usize {
        let held = |shard: &Shard| shard.taken - shard.emptied;
        self.shards.iter().map(held).sum::<usize>() + self.far.len()
    }
}

/// Multiply and fold (wyhash's mixing step): every key bit reaches both the upper bits (shard) and the lower (slot).
#[inline]
fn hash(key: u64) -> u64 {
    let fold = |a: u64, b: u64| {
        let p = u128::from(a) * u128::from(b);
        (p as u64) ^ ((p >> 64) as u64)
    };
    fold(
        fold(key ^ 0x9E37_79B9_7F4A_7C15, 0xD6E8_FEB8_6659_FD93),
        0xE703_7ED1_A0B4_28DB,
    )
}

/// The shard that holds a key with this hash.
fn shard_of(hash: u64) -> usize {
    (hash >> 56) as usize & (SHARDS - 1)
}

/// Keys of a range of points, sorted by shard.
struct Chunk {
    keys: Vec<u64>,
    /// `starts[s]..starts[s + 1]` are the keys of shard s.
    starts: [usize; SHARDS + 1],
    /// Keys that cannot be packed.
    far: Vec<Key>,
}

impl Chunk {
    /// Keys of the rows of `range` for which `keep` is true; `found` is scratch space for so many, kept between chunks.
    fn new(
        positions: [&[f32]; 3],
        lattice: &Lattice<'_>,
        range: std::ops::Range<usize>,
        keep: &(impl Fn(usize) -> bool + Sync),
        found: &mut [(u8, u64)],
    ) -> Self {
        let (mut starts, mut far, mut len) = ([0; SHARDS + 1], Vec::new(), 0);
        for i in range {
            let place = lattice.place(positions.map(|p| f64::from(p[i])));
            let (counts, key) = (keep(i), pack(place.0, place.1));
            if key == 0 && counts {
                far.extend(Lattice::key(place));
            }
            // Without branches: which rows count is not to be predicted.
            let key = if counts { key } else { 0 };
            let shard = shard_of(hash(key));
            starts[shard + 1] += usize::from(key != 0);
            found[len] = (shard as u8, key);
            len += usize::from(key != 0);
        }
        for s in 0..SHARDS {
            starts[s + 1] += starts[s];
        }
        let mut next = starts;
        let mut keys = vec![0; len];
        for &(shard, key) in &found[..len] {
            let slot = &mut next[usize::from(shard)];
            keys[*slot] = key;
            *slot += 1;
        }
        Self { keys, starts, far }
    }

    fn shard(&self, s: usize) -> &[u64] {
        &self.keys[self.starts[s]..self.starts[s + 1]]
    }
}

/// Open addressing with linear probing; a key of 0 marks a free slot. A key stays when its voxel is emptied.
#[derive(Debug, Clone)]
struct Shard {
    keys: Vec<u64>,
    counts: Vec<u32>,
    /// Slots with a key.
    taken: usize,
    /// Slots with a key and a count of 0.
    emptied: usize,
}

impl Shard {
    /// An empty table with so many slots.
    fn with_slots(slots: usize) -> Self {
        Self {
            keys: vec![0; slots],
            counts: vec![0; slots],
            taken: 0,
            emptied: 0,
        }
    }

    /// An empty table with room for so many points if no two share a voxel.
    fn with_points(points: usize) -> Self {
        Self::with_slots(points + points / 4 + 16)
    }

    /// Index of the key's slot, or of the free slot it would take. Ends because a slot is always free.
    fn find(&self, key: u64, hash: u64) -> usize {
        // The lower half of the hash scaled to the table (Lemire 2019): no power of two, no division.
        let home = (hash & 0xFFFF_FFFF) * self.keys.len() as u64;
        let mut i = (home >> 32) as usize;
        while self.keys[i] != 0 && self.keys[i] != key {
            i += 1;
            if i == self.keys.len() {
                i = 0;
            }
        }
        i
    }

    fn get(&self, key: u64, hash: u64) -> u32 {
        self.counts[self.find(key, hash)]
    }

    fn add(&mut self, key: u64, hash: u64) {
        let mut i = self.find(key, hash);
        if self.keys[i] == 0 {
            if (self.taken + 1) * 8 > self.keys.len() * 7 {
                self.grow();
                i = self.find(key, hash);
            }
            self.taken += 1;
            self.keys[i] = key;
        } else if self.counts[i] == 0 {
            self.emptied -= 1;
        }
        self.counts[i] = self.counts[i].saturating_add(1);
    }

    fn remove(&mut self, key: u64, hash: u64) {
        let i = self.find(key, hash);
        if self.counts[i] > 0 {
            self.counts[i] -= 1;
            self.emptied += usize::from(self.counts[i] == 0);
        }
    }

    fn grow(&mut self) {
        let larger = Self {
            taken: self.taken,
            emptied: self.emptied,
            ..Self::with_slots(self.keys.len() * 2)
        };
        let old = std::mem::replace(self, larger);
        for (key, count) in old.keys.into_iter().zip(old.counts) {
            if key != 0 {
                let i = self.find(key, hash(key));
                (self.keys[i], self.counts[i]) = (key, count);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{BITS, pack};

    #[test]
    fn packed_keys_are_those_of_the_floor() {
        let half = f64::from(1 << (BITS - 1));
        let mut values = vec![0.0, -0.0, 5e-324, -5e-324, 0.1, -0.1];
        for k in [-half, -3.0, -1.0, 1.0, 2.0, 77.0, half - 1.0, half] {
            for v in [k - 0.5, k, k + 0.5] {
                values.extend([v.next_down(), v, v.next_up()]);
            }
        }
        for (level, v) in values.iter().flat_map(|v| [(0, *v), (30, *v)]) {
            let floor = v.floor();
            let near = (-half..half).contains(&floor);
            let digits = [(floor + half) as u64, 1 << (BITS - 1), 0];
            let mark = 1 << 6 | level as u64;
            let wanted = digits.iter().fold(mark, |key, digit| key << BITS | digit);
            let key = pack(level, [v, 0.0, -half]);
            assert_eq!(key, if near { wanted } else { 0 }, "{v:e}");
        }
        for v in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
            assert_eq!(pack(0, [0.0, v, 0.0]), 0);
        }
    }
}
