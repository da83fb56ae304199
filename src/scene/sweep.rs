//! Points where photos agree: a plane sweep over small photos, for captures whose cameras come without points.
//!
//! For each pixel of a photo, planes at rising inverse depth map it into neighbouring photos (Collins 1996); the depth at which the
//! surroundings correlate best is taken where they correlate well, clearly better than elsewhere, and in a neighbour's own depths, too.
//! Correlation does not depend on the brightness of the photos. Sums are f32 in one order: the points are the same on every machine.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::base::error::Result;
use crate::base::rng::{Philox, Stream};
use crate::capture::{Alpha, Camera, Dataset, Photo, Points};
use crate::scene::init;

/// Pixels of a photo: some thousand points are wanted of all of them.
const PIXELS: f64 = 9216.0;

/// Planes from infinity to the nearest one, evenly spaced in inverse depth: somewhat less than a pixel apart in a neighbour.
const PLANES: usize = 96;

/// Inverse depth of the nearest plane, per local unit; the scene extent is 1.
const NEAREST: f64 = 4.0;

/// Photos that have depths: half of them, but no fewer and no more than these, evenly spread by name.
const PHOTOS: [usize; 2] = [32, 96];

/// Neighbours that a photo is compared with.
const NEIGHBOURS: usize = 4;

/// Best of them that count at a depth: the others may not see the place.
const BEST: usize = 2;

/// Distance of the best neighbour, local units; the least; and the cosine of the largest angle between the directions of view.
const BASELINE: f64 = 0.15;
const LEAST_BASELINE: f64 = 0.01;
const SAME_DIRECTION: f64 = 0.7;

/// Weight of 1 − cosine of that angle beside the ratio of distances in the choice of neighbours.
const TURNED: f64 = 2.0;

/// Half the side of the window that is correlated, pixels.
const RADIUS: usize = 2;

/// Least correlation, and least lead over planes that are not beside the best one.
const LEAST_SCORE: f32 = 0.8;
const LEAST_LEAD: f32 = 0.03;

/// Planes on either side of the best one that belong to it.
const BESIDE: usize = 2;

/// Standard deviation of the grey values in a window with texture, of the full range.
const TEXTURE: f32 = 3.0 / 255.0;

/// Variance that keeps a flat window from a correlation.
const FLAT: f32 = 1e-6;

/// Distance from the depth in a neighbour up to which both show one surface, planes.
const AGREEMENT: f64 = 1.5;

/// Share of the pixels that count which agree at least: 0.01 do by chance, in photos of wrong cameras, and 0.11 to 0.64 in eleven captures
/// (docs/results/first-gaussians.md).
const LEAST_SHARE: f64 = 0.04;

/// Share of the points wanted that are found at least: with fewer a scene is sooner filled from random places.
const LEAST_WANTED: f64 = 0.1;

/// Grey level behind transparent photos.
const BEHIND: f32 = 0.5;

/// Alpha above which a pixel counts.
const COUNTS: f32 = 0.5;

/// A photo at the size of the sweep.
struct Small {
    camera: Camera,
    width: usize,
    height: usize,
    /// Mean of the channels, over [`BEHIND`] where the photo is transparent, in \[0, 1\].
    grey: Vec<f32>,
    /// Red, green and blue, times alpha.
    colors: [Vec<f32>; 3],
    /// Alpha: opacity, or the weight of a mask; empty without either.
    alpha: Vec<f32>,
}

/// Inverse depths of a photo's pixels, per local unit; `None` where none is sure.
type Depths = Vec<Option<f32>>;

/// `most` points at which training photos agree about a surface, fewer if there are no more, chosen by the seed alone; none if photos agree in
/// so few places that it may be chance. Colours are those of the photos.
///
/// # Errors
/// A photo that cannot be read.
pub fn points(dataset: &Dataset, most: usize, seed: u64) -> Result<Points> {
    let views = &dataset.train;
    let cameras: Vec<&Camera> = views.iter().map(|view| &view.camera).collect();
    let swept = chosen(views.len(), seed);
    let all: Vec<usize> = (0..views.len()).collect();
    let near = |among: &[usize]| -> Vec<Vec<usize>> {
        let near = |view: &usize| neighbours(&cameras, *view, among);
        swept.iter().map(near).collect()
    };
    // Compared with any, and checked against those that have depths of their own.
    let [compared, checked] = [near(&all), near(&swept)];
    let mut wanted: Vec<usize> = compared.iter().flatten().chain(&swept).copied().collect();
    wanted.sort_unstable();
    wanted.dedup();
    let small = |view: &usize| {
        Ok(Small::new(
            &*views[*view].photo.load()?,
            &views[*view].camera,
        ))
    };
    let photos: Vec<Small> = wanted.par_iter().map(small).collect::<Result<_>>()?;
    let photo = |view: usize| wanted.binary_search(&view).ok().map(|at| &photos[at]);
    let depths: Vec<Depths> = swept
        .par_iter()
        .zip(&compared)
        .map(|(view, others)| {
            let others: Vec<&Small> = others.iter().filter_map(|o| photo(*o)).collect();
            photo(*view).map_or_else(Vec::new, |photo| depths(photo, &others))
        })
        .collect();
    let of = |view: usize| Some((photo(view)?, &depths[swept.binary_search(&view).ok()?]));
    let mut found = Points::default();
    for (view, others) in swept.iter().zip(&checked) {
        let Some((photo, depths)) = of(*view) else {
            continue;
        };
        let others: Vec<(&Small, &Depths)> = others.iter().filter_map(|o| of(*o)).collect();
        for (at, inverse) in depths.iter().enumerate() {
            let Some(inverse) = *inverse else { continue };
            let point = photo.point(at, inverse);
            let agree = |(other, depths): &(&Small, &Depths)| other.shows(depths, point);
            if others.iter().any(agree) {
                found.positions.push(point.as_vec3().to_array());
                found.colors.push(photo.color(at));
            }
        }
    }
    let pixels: usize = swept
        .iter()
        .filter_map(|v| photo(*v))
        .map(Small::counted)
        .sum();
    let least = (LEAST_SHARE * pixels as f64).max(LEAST_WANTED * most as f64);
    if (found.positions.len() as f64) < least {
        return Ok(Points::default());
    }
    Ok(init::subset(&found, most, seed))
}

/// Views that have depths, rising: one of each stretch of as many views, at random, because the sides of panoramas and the cameras of a rig take turns.
fn chosen(views: usize, seed: u64) -> Vec<usize> {
    let count = views.div_ceil(2).clamp(PHOTOS[0], PHOTOS[1]).min(views);
    let one = |k: usize| {
        let [first, end] = [k * views / count, (k + 1) * views / count];
        let u = Philox::uniform(seed, Stream::Subset.stream(1), k as u64)[0];
        first + ((u * (end - first) as f64) as usize).min(end - first - 1)
    };
    (0..count).map(one).collect()
}

/// Views near [`BASELINE`] away from a view and turned alike, of those given.
fn neighbours(cameras: &[&Camera], view: usize, among: &[usize]) -> Vec<usize> {
    let direction = |v: usize| cameras[v].rotation.row(2);
    let cost = |other: usize| {
        let baseline = (cameras[other].center() - cameras[view].center()).length();
        let cosine = direction(other).dot(direction(view));
        let ratio = (baseline / BASELINE).max(BASELINE / baseline);
        let good = cosine > SAME_DIRECTION && baseline > LEAST_BASELINE;
        good.then_some((ratio + TURNED * (1.0 - cosine), other))
    };
    let others = among.iter().copied().filter(|other| *other != view);
    let mut others: Vec<(f64, usize)> = others.filter_map(cost).collect();
    others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    others
        .into_iter()
        .map(|(_, o)| o)
        .take(NEIGHBOURS)
        .collect()
}

impl Small {
    /// A photo reduced to about [`PIXELS`]: each is the mean of the pixels that begin in it.
    fn new(photo: &Photo, camera: &Camera) -> Self {
        let (width, height) = (photo.width, photo.height);
        let factor = (PIXELS / (f64::from(width) * f64::from(height))).sqrt();
        let side = |s: u32| ((f64::from(s) * factor).round() as u32).clamp(1, s);
        let [w, h] = [width, height].map(side);
        let size = [w, h].map(|s| s as usize);
        let pixels = width as usize * height as usize;
        let plane = |k: usize| {
            let plane = &photo.data[k * pixels..][..pixels];
            reduced(plane, [width, height].map(|s| s as usize), size)
        };
        let colors = [0, 1, 2].map(plane);
        let alpha = match photo.alpha {
            Alpha::None => Vec::new(),
            _ => plane(3),
        };
        let behind = |i: usize| match photo.alpha {
            Alpha::Transparency => (1.0 - alpha[i]) * BEHIND,
            _ => 0.0,
        };
        let grey = |i: usize| (colors[0][i] + colors[1][i] + colors[2][i]) / 3.0 + behind(i);
        Self {
            camera: camera.scaled_to(w, h),
            width: size[0],
            height: size[1],
            grey: (0..size[0] * size[1]).map(grey).collect(),
            colors,
            alpha,
        }
    }

    fn intrinsics(&self) -> DMat3 {
        let c = &self.camera;
        let [x, y] = [DVec3::X * c.fx, DVec3::Y * c.fy];
        DMat3::from_cols(x, y, DVec3::new(c.cx, c.cy, 1.0))
    }

    /// Map of homogeneous pixel coordinates from this photo to another, of the plane at an inverse depth before this camera.
    fn homography(&self, other: &Self, inverse: f64) -> [f32; 9] {
        let rotation = other.camera.rotation * self.camera.rotation.transpose();
        let translation = other.camera.translation - rotation * self.camera.translation;
        let shift = DMat3::from_cols(DVec3::ZERO, DVec3::ZERO, translation * inverse);
        let ray = rotation * self.intrinsics().inverse();
        (other.intrinsics() * (ray + shift))
            .to_cols_array()
            .map(|v| v as f32)
    }

    /// Place of a pixel's centre at an inverse depth, local units.
    fn point(&self, at: usize, inverse: f32) -> DVec3 {
        let c = &self.camera;
        let (x, y) = (
            (at % self.width) as f64 + 0.5,
            (at / self.width) as f64 + 0.5,
        );
        let ray = DVec3::new((x - c.cx) / c.fx, (y - c.cy) / c.fy, 1.0);
        c.rotation.transpose() * (ray / f64::from(inverse) - c.translation)
    }

    /// True if this photo's depths show a surface at a point.
    fn shows(&self, depths: &Depths, point: DVec3) -> bool {
        let c = &self.camera;
        let p = c.rotation * point + c.translation;
        let (x, y) = (c.fx * p.x / p.z + c.cx, c.fy * p.y / p.z + c.cy);
        let inside = |v: f64, side: usize| v >= 0.0 && v < side as f64;
        if !(p.z > 0.0 && inside(x, self.width) && inside(y, self.height)) {
            return false;
        }
        let found = depths.get(y as usize * self.width + x as usize);
        let step = NEAREST / (PLANES - 1) as f64;
        let near = |inverse: f32| (f64::from(inverse) - 1.0 / p.z).abs() < AGREEMENT * step;
        found.copied().flatten().is_some_and(near)
    }

    /// Colour of a pixel that counts, without its alpha.
    fn color(&self, at: usize) -> [u8; 3] {
        let alpha = self.alpha.get(at).map_or(1.0, |alpha| alpha.max(COUNTS));
        [0, 1, 2].map(|c| (255.0 * self.colors[c][at] / alpha).round() as u8)
    }

    /// Number of pixels that count.
    fn counted(&self) -> usize {
        (0..self.grey.len()).filter(|at| self.counts(*at)).count()
    }

    /// True if a pixel counts.
    fn counts(&self, at: usize) -> bool {
        self.alpha.get(at).is_none_or(|alpha| *alpha > COUNTS)
    }

    /// Grey value between pixel centres, at a place at least one pixel before the last column and row.
    fn grey_at(&self, [x, y]: [f32; 2]) -> f32 {
        let (column, row) = (x as i32, y as i32);
        let (u, v) = (x - column as f32, y - row as f32);
        let at = row as usize * self.width + column as usize;
        let along = |pair: &[f32]| pair[0] * (1.0 - u) + pair[1] * u;
        let below = at + self.width;
        along(&self.grey[at..at + 2]) * (1.0 - v) + along(&self.grey[below..below + 2]) * v
    }

    /// Sums over the window around each pixel, as far as it is in the photo.
    fn windows(&self, values: &[f32]) -> Vec<f32> {
        let (w, h) = (self.width, self.height);
        let mut rows = vec![0.0; w * h];
        let mut padded = vec![0.0; w + 2 * RADIUS];
        for (row, sums) in values.chunks_exact(w).zip(rows.chunks_exact_mut(w)) {
            padded[RADIUS..RADIUS + w].copy_from_slice(row);
            for shift in 0..=2 * RADIUS {
                add(sums, &padded[shift..shift + w]);
            }
        }
        let mut out = vec![0.0; w * h];
        for (y, sums) in out.chunks_exact_mut(w).enumerate() {
            for row in y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(h) {
                add(sums, &rows[row * w..(row + 1) * w]);
            }
        }
        out
    }
}

fn add(sums: &mut [f32], values: &[f32]) {
    sums.iter_mut().zip(values).for_each(|(sum, v)| *sum += v);
}

/// Windows of a photo, and of a neighbour mapped into it.
struct Windows {
    /// Pixels of a window, by pixel.
    count: Vec<f32>,
    /// Mean and variance of the photo's grey values.
    mean: Vec<f32>,
    variance: Vec<f32>,
    /// The neighbour's grey values, where it has them.
    mapped: Vec<f32>,
    inside: Vec<bool>,
    /// Products with themselves and with the photo's.
    squares: Vec<f32>,
    products: Vec<f32>,
}

impl Windows {
    fn new(photo: &Small) -> Self {
        let n = photo.grey.len();
        let count = photo.windows(&vec![1.0; n]);
        let means = |values: &[f32]| -> Vec<f32> {
            let sums = photo.windows(values).into_iter().zip(&count);
            sums.map(|(sum, count)| sum / count).collect()
        };
        let mean = means(&photo.grey);
        let squares: Vec<f32> = photo.grey.iter().map(|v| v * v).collect();
        let variance = means(&squares).into_iter().zip(&mean);
        Self {
            variance: variance.map(|(square, m)| square - m * m).collect(),
            count,
            mean,
            mapped: vec![0.0; n],
            inside: vec![false; n],
            squares: vec![0.0; n],
            products: vec![0.0; n],
        }
    }

    /// Maps a neighbour into the photo.
    fn map(&mut self, photo: &Small, other: &Small, h: [f32; 9]) {
        let most = [other.width, other.height].map(|side| side.saturating_sub(1) as f32);
        let mut places = vec![[0.0; 2]; photo.width];
        for y in 0..photo.height {
            let row = y * photo.width..(y + 1) * photo.width;
            let v = y as f32 + 0.5;
            let start: [f32; 3] = std::array::from_fn(|k| h[3 + k] * v + h[6 + k]);
            let inside = &mut self.inside[row.clone()];
            for (x, (place, inside)) in places.iter_mut().zip(inside.iter_mut()).enumerate() {
                let u = x as f32 + 0.5;
                let [a, b, c]: [f32; 3] = std::array::from_fn(|k| h[k] * u + start[k]);
                let (px, py) = (a / c - 0.5, b / c - 0.5);
                *inside = (c > 0.0) & (px >= 0.0) & (py >= 0.0) & (px < most[0]) & (py < most[1]);
                *place = [px, py];
            }
            let values = self.mapped[row.clone()].iter_mut();
            for ((value, place), inside) in values.zip(&places).zip(inside) {
                *value = if *inside { other.grey_at(*place) } else { 0.0 };
            }
            let products = self.products[row.clone()].iter_mut();
            let squares = self.squares[row.clone()].iter_mut();
            let values = self.mapped[row.clone()].iter().zip(&photo.grey[row]);
            for ((product, square), (value, own)) in products.zip(squares).zip(values) {
                *product = value * own;
                *square = value * value;
            }
        }
    }

    /// Correlation of each pixel's window with that of the mapped neighbour, in \[−1, 1\]; −1 where that has nothing.
    fn correlations(&self, photo: &Small) -> Vec<f32> {
        let [sums, squares, products] =
            [&self.mapped, &self.squares, &self.products].map(|values| photo.windows(values));
        let n = self.count.len();
        let [sums, squares, products] = [&sums[..n], &squares[..n], &products[..n]];
        let [own_mean, own_variance] = [&self.mean[..n], &self.variance[..n]];
        let inside = &self.inside[..n];
        let score = |i: usize| {
            let scale = 1.0 / self.count[i];
            let mean = sums[i] * scale;
            let variance = squares[i] * scale - mean * mean;
            let covariance = products[i] * scale - mean * own_mean[i];
            let score = covariance / (own_variance[i].max(FLAT) * variance.max(FLAT)).sqrt();
            if inside[i] { score } else { -1.0 }
        };
        (0..n).map(score).collect()
    }
}

/// Inverse depths of a photo by its neighbours.
fn depths(photo: &Small, others: &[&Small]) -> Depths {
    let n = photo.grey.len();
    if others.is_empty() {
        return vec![None; n];
    }
    let best = BEST.min(others.len());
    let mut windows = Windows::new(photo);
    let mut scores = vec![0.0; n * PLANES];
    for (plane, scores) in scores.chunks_exact_mut(n).enumerate() {
        let inverse = NEAREST * plane as f64 / (PLANES - 1) as f64;
        let mut top = vec![[-1.0_f32; BEST]; n];
        for other in others {
            windows.map(photo, other, photo.homography(other, inverse));
            for (top, score) in top.iter_mut().zip(windows.correlations(photo)) {
                *top = [top[0].max(score), top[1].max(top[0].min(score))];
            }
        }
        for (score, top) in scores.iter_mut().zip(&top) {
            *score = top[..best].iter().sum::<f32>() / best as f32;
        }
    }
    let textured = |at: usize| windows.variance[at] > TEXTURE * TEXTURE && photo.counts(at);
    let depth = |at: usize| {
        let of = |plane: usize| scores[plane * n + at];
        textured(at).then(|| peak(of)).flatten()
    };
    (0..n).map(depth).collect()
}

/// Inverse depth at which the scores of the planes have their peak; `None` where it is low, at an end, or not the only one.
fn peak(score: impl Fn(usize) -> f32) -> Option<f32> {
    let all = || (0..PLANES).map(&score);
    let first = |best: (usize, f32), s: (usize, f32)| if s.1 > best.1 { s } else { best };
    let (plane, high) = all().enumerate().fold((0, -1.0), first);
    if !(high > LEAST_SCORE && plane > 0 && plane + 1 < PLANES) {
        return None;
    }
    let others = all()
        .enumerate()
        .filter(|(p, _)| p.abs_diff(plane) > BESIDE);
    let second = others.map(|(_, s)| s).fold(-1.0, f32::max);
    if high - second <= LEAST_LEAD {
        return None;
    }
    // The vertex of the parabola through the peak and its neighbours.
    let (before, after) = (score(plane - 1), score(plane + 1));
    let bend = before - 2.0 * high + after;
    let shift = if bend < -1e-6 {
        0.5 * (before - after) / bend
    } else {
        0.0
    };
    let step = NEAREST as f32 / (PLANES - 1) as f32;
    Some((plane as f32 + shift.clamp(-0.5, 0.5)) * step)
}

/// A plane of bytes reduced to means of the pixels that begin in each of the target's, in \[0, 1\].
fn reduced(plane: &[u8], [width, height]: [usize; 2], [w, h]: [usize; 2]) -> Vec<f32> {
    let span = |k: usize, from: usize, to: usize| k * from / to..((k + 1) * from / to);
    let mut out = Vec::with_capacity(w * h);
    for y in 0..h {
        let rows = span(y, height, h);
        for x in 0..w {
            let columns = span(x, width, w);
            let row = |row: usize| &plane[row * width..][columns.clone()];
            let sum: u32 = rows.clone().flat_map(row).map(|v| u32::from(*v)).sum();
            let count = rows.len() * columns.len();
            out.push(sum as f32 / (255 * count.max(1)) as f32);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::chosen;

    /// The six sides of a panorama and the cameras of a rig follow one another by name.
    #[test]
    fn views_that_take_turns_are_all_chosen() {
        for views in [60, 63, 64, 66, 126, 128, 192, 384, 1000] {
            let all = chosen(views, 0);
            assert!(all.is_sorted_by(|a, b| a < b) && all[all.len() - 1] < views);
            for cameras in [2, 3, 6] {
                let fair = all.len() / cameras;
                let of = |camera| all.iter().filter(|v| **v % cameras == camera).count();
                let least = (0..cameras).map(of).min().unwrap_or(0);
                assert!(
                    least * 5 >= fair * 2,
                    "{views} {cameras}: {least} of {fair}"
                );
            }
        }
        assert_eq!(chosen(3, 7), [0, 1, 2]);
    }
}
