//! Initial Gaussians: one per point, or random ones.

use crate::base::error::{Error, Result};
use crate::base::math::logit;
use crate::base::rng::{Philox, Stream};
use crate::capture::{Dataset, Points};
use crate::scene::gaussians::{Gaussians, Plane};
use crate::scene::knn::mean_squared_distances;
use crate::scene::sh::C0;

/// Opacity of a new Gaussian (3DGS §5.1).
const OPACITY: f64 = 0.1;

/// Smallest initial scale, local units (the scene extent is 1). 3DGS clamps the squared distance at 1e-7 in whatever
/// units the dataset has, against duplicates, whose distance 0 has no logarithm. Relative to the extent that would cost
/// detail in large scenes; 1e-5 is below a hundredth of a pixel for a camera at the scene's distance, and so is no limit
/// to anything that photos resolve.
const MIN_SCALE: f64 = 1e-5;

/// Scale of a Gaussian without neighbours, local units.
const LONE_SCALE: f64 = 0.01;

/// Share of the longest side to which thinner sides of the cameras' box are widened.
const THINNEST_SIDE: f64 = 0.1;

/// One Gaussian per point (method §2): isotropic scale, the root of the mean squared distance to the 3 nearest neighbours
/// (as many as there are, for fewer than 4 points; at least 1e-5 of the extent); opacity 0.1; identity
/// rotation; the point's colour in SH band 0, the other bands 0.
///
/// # Errors
/// [`Error::Numerics`] for no points, another number of colours, or positions that are not finite;
/// [`Error::Config`] for an SH degree above 3.
pub fn from_points(points: &Points, sh_degree: u32) -> Result<Gaussians> {
    let (n, colors) = (points.positions.len(), points.colors.len());
    if n != colors {
        let what = format!("{n} points with {colors} colours; one each expected");
        return Err(numerics(what));
    }
    let unit = |c: &[u8; 3]| c.map(|v| f64::from(v) / 255.0);
    let colors: Vec<[f64; 3]> = points.colors.iter().map(unit).collect();
    build(&points.positions, &colors, sh_degree)
}

/// At most `most` of the points, chosen by the seed alone, in their order.
#[must_use]
pub fn subset(points: &Points, most: usize, seed: u64) -> Points {
    let n = points.positions.len();
    if n <= most {
        return points.clone();
    }
    let key = |i: &usize| Philox::uniform(seed, Stream::Subset.stream(0), *i as u64)[0].to_bits();
    let mut rows: Vec<usize> = (0..n).collect();
    rows.sort_by_key(key);
    rows.truncate(most);
    rows.sort_unstable();
    Points {
        positions: rows.iter().map(|i| points.positions[*i]).collect(),
        colors: rows.iter().map(|i| points.colors[*i]).collect(),
    }
}

/// `count` Gaussians uniform in the bounding box of all camera centres, sides thinner than a tenth of the longest widened
/// to that (a single camera: 1 to each side); colours uniform within 0.5 ± 0.25, so that nothing starts saturated; the
/// rest as [`from_points`] does.
///
/// # Errors
/// [`Error::Config`] for `count` 0 or an SH degree above 3; [`Error::Numerics`] for a dataset without views.
pub fn random(dataset: &Dataset, count: usize, sh_degree: u32, seed: u64) -> Result<Gaussians> {
    if count == 0 {
        let what = "0 random points; at least 1 expected";
        return Err(Error::config("init", what));
    }
    let centers = dataset.views().map(|v| v.camera.center().to_array());
    let centers: Vec<[f64; 3]> = centers.collect();
    let (middle, half) = camera_box(&centers).ok_or_else(|| numerics("no views".into()))?;
    let draw = |i: u64| Philox::uniform(seed, Stream::Init.stream(0), i);
    let (positions, colors): (Vec<[f32; 3]>, Vec<[f64; 3]>) = (0..count as u64)
        .map(|i| {
            let (u, c) = (draw(2 * i), draw(2 * i + 1));
            let place = |k: usize| (middle[k] + half[k] * (2.0 * u[k] - 1.0)) as f32;
            let position = std::array::from_fn(place);
            (position, std::array::from_fn(|k| 0.25 + 0.5 * c[k]))
        })
        .unzip();
    build(&positions, &colors, sh_degree)
}

/// Middle and half sides of the (widened) box around points; `None` without any.
fn camera_box(centers: &[[f64; 3]]) -> Option<([f64; 3], [f64; 3])> {
    let first = *centers.first()?;
    let (mut low, mut high) = (first, first);
    for c in centers {
        for k in 0..3 {
            low[k] = low[k].min(c[k]);
            high[k] = high[k].max(c[k]);
        }
    }
    let middle = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
    let half: [f64; 3] = std::array::from_fn(|k| 0.5 * (high[k] - low[k]));
    let longest = half.into_iter().fold(0.0, f64::max);
    let least = if longest > 1e-9 {
        THINNEST_SIDE * longest
    } else {
        1.0
    };
    Some((middle, half.map(|h| h.max(least))))
}

/// Gaussians at positions (local units) with colours (RGB in [0, 1]).
fn build(positions: &[[f32; 3]], colors: &[[f64; 3]], sh_degree: u32) -> Result<Gaussians> {
    if sh_degree > 3 {
        let what = format!("{sh_degree}; 0 to 3 expected");
        return Err(Error::config("sh-degree", what));
    }
    let n = positions.len();
    if n == 0 || u32::try_from(n).is_err() {
        return Err(numerics(format!("{n} points; 1 to 4294967295 expected")));
    }
    let astray = |p: &[f32; 3]| p.iter().any(|v| !v.is_finite());
    if let Some(i) = positions.iter().position(astray) {
        return Err(numerics(format!("point {i} lies at {:?}", positions[i])));
    }
    let mut splats = Gaussians::zeros(sh_degree, positions.len());
    splats.plane_mut(Plane::OPACITY).fill(logit(OPACITY) as f32);
    let distances = mean_squared_distances::<3>(positions);
    for (i, ((&p, c), d)) in positions.iter().zip(colors).zip(distances).enumerate() {
        let scale = if d.is_nan() {
            LONE_SCALE
        } else {
            d.sqrt().max(MIN_SCALE)
        };
        splats.scatter(Plane::POSITION, i, p);
        splats.scatter(Plane::LOG_SCALE, i, [scale.ln() as f32; 3]);
        splats.scatter(Plane::SH, i, c.map(|v| ((v - 0.5) / C0) as f32));
    }
    Ok(splats)
}

fn numerics(what: String) -> Error {
    Error::numerics("initialisation", what)
}
