//! The Gaussians of the page as bytes: plane after plane, in Morton order and in chunks of 256. Of each chunk of a plane the least and
//! the largest value are kept as f32, and each value as an integer of one to three bytes between them, to which it is rounded.
//!
//! Layout: \[planes\]\[chunks\]\[least, largest\] f32, then \[planes\]\[Gaussians\] integers; little endian.

use rayon::prelude::*;

use crate::base::constants::LOG_SCALE;
use crate::base::math::sigmoid;
use crate::scene::{Gaussians, Plane, morton, sh_coefficients};

/// Gaussians that share their least and largest values.
pub(super) const CHUNK: usize = 256;

/// Bytes that the Gaussians of a page may take before their conversion to text, by default: browsers open a page of a third more.
pub const MAX_BYTES: usize = 32 << 20;

/// Bytes per value of a plane: 24 bits for positions, as a chunk may hold Gaussians far from each other; 16 for shapes, opacities
/// and colours; 8 for the higher bands.
pub(super) fn width(plane: usize) -> usize {
    match plane {
        p if p < Plane::LOG_SCALE => 3,
        p if p < Plane::SH + 3 => 2,
        _ => 1,
    }
}

/// The packed Gaussians.
pub(super) struct Packed {
    pub count: usize,
    pub degree: u32,
    pub bytes: Vec<u8>,
    /// Losses to be told, in sentences.
    pub remarks: Vec<String>,
}

/// Bytes of so many Gaussians of a degree.
fn bytes(count: usize, degree: u32) -> usize {
    let planes = Plane::count(degree);
    let each: usize = (0..planes).map(width).sum();
    count * each + planes * count.div_ceil(CHUNK) * 8
}

/// Packs the Gaussians into at most `limit` bytes: with fewer SH bands if need be, without the faintest if that does not suffice.
pub(super) fn pack(splats: &Gaussians, limit: usize) -> Packed {
    let (all, own) = (splats.len(), splats.sh_degree());
    let mut remarks = Vec::new();
    let degree = (0..=own).rev().find(|&d| bytes(all, d) <= limit);
    let degree = degree.unwrap_or(0);
    if degree < own {
        remarks.push(format!(
            "The page shows SH degree {degree} of {own}, so that it is not too large for a browser; scene.ply has all."
        ));
    }
    let axis = |k: usize| splats.planes()[Plane::POSITION + k].as_slice();
    let mut order = morton::order([axis(0), axis(1), axis(2)], morton::NO_UP);
    let mut count = all;
    while bytes(count, degree) > limit && count > 0 {
        count -= (bytes(count, degree) - limit)
            .div_ceil(bytes(CHUNK, degree) / CHUNK + 1)
            .min(count);
    }
    if count < all {
        keep_largest(&mut order, count, splats);
        remarks.push(format!(
            "The page shows {count} of {all} Gaussians, without the faintest, so that it is not too large for a browser; scene.ply has all."
        ));
    }
    let planes: Vec<(Vec<u8>, Vec<u8>)> = (0..Plane::count(degree))
        .into_par_iter()
        .map(|plane| pack_plane(plane, &values(splats, &order, plane)))
        .collect();
    let (ranges, levels): (Vec<_>, Vec<_>) = planes.into_iter().unzip();
    Packed {
        count,
        degree,
        bytes: [ranges, levels].concat().concat(),
        remarks,
    }
}

/// Leaves the `count` rows of largest opacity times area, in their order.
fn keep_largest(order: &mut Vec<u32>, count: usize, splats: &Gaussians) {
    let share = |row: u32| {
        let i = row as usize;
        let [opacity] = splats.gather::<1>(Plane::OPACITY, i).map(f64::from);
        let scales = splats.gather::<3>(Plane::LOG_SCALE, i).map(f64::from);
        let least = scales.into_iter().fold(f64::INFINITY, f64::min);
        sigmoid(opacity) * (scales.iter().sum::<f64>() - least).exp()
    };
    let mut shares: Vec<(f64, usize)> = order.iter().map(|&i| share(i)).zip(0..).collect();
    shares.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<usize> = shares[..count].iter().map(|s| s.1).collect();
    kept.sort_unstable();
    *order = kept.into_iter().map(|at| order[at]).collect();
}

/// Values of a plane in an order; quaternions are normalised, log-scales within their range.
fn values(splats: &Gaussians, order: &[u32], plane: usize) -> Vec<f32> {
    let rotation = Plane::ROTATION..Plane::ROTATION + 4;
    let rows = order.iter().map(|&i| i as usize);
    if rotation.contains(&plane) {
        let part = plane - Plane::ROTATION;
        let unit = |i: usize| {
            let q = splats.gather::<4>(Plane::ROTATION, i).map(f64::from);
            let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            match norm > 0.0 {
                true => (q[part] / norm) as f32,
                false => f32::from(u8::from(part == 0)),
            }
        };
        return rows.map(unit).collect();
    }
    let values = &splats.planes()[plane];
    let [low, high] = LOG_SCALE.map(|v| v as f32);
    match (Plane::LOG_SCALE..Plane::LOG_SCALE + 3).contains(&plane) {
        true => rows.map(|i| values[i].clamp(low, high)).collect(),
        false => rows.map(|i| values[i]).collect(),
    }
}

/// Ranges and levels of a plane.
fn pack_plane(plane: usize, values: &[f32]) -> (Vec<u8>, Vec<u8>) {
    let width = width(plane);
    let highest = f64::from((1u32 << (8 * width)) - 1);
    let (mut ranges, mut levels) = (Vec::new(), Vec::with_capacity(width * values.len()));
    for chunk in values.chunks(CHUNK) {
        let low = chunk.iter().copied().fold(f32::INFINITY, f32::min);
        let high = chunk.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        ranges.extend(low.to_le_bytes());
        ranges.extend(high.to_le_bytes());
        let span = f64::from(high) - f64::from(low);
        let scale = if span > 0.0 { highest / span } else { 0.0 };
        for v in chunk {
            let level = ((f64::from(*v) - f64::from(low)) * scale).round() as u32;
            levels.extend(&level.to_le_bytes()[..width]);
        }
    }
    (ranges, levels)
}

/// Bytes per value of every plane of a degree.
pub(super) fn widths(degree: u32) -> Vec<usize> {
    (0..Plane::SH + 3 * sh_coefficients(degree))
        .map(width)
        .collect()
}
