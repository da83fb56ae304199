//! LDR-ꟻLIP (Andersson et al. 2020): how different two pictures look when one is flipped to the other, 0 to 1 per pixel.
//!
//! Computed on the host in f64, at the last evaluation and by `mhsplat eval` only; it costs milliseconds a view.
//! Section numbers are the paper's. Its filters are sums of products of one-dimensional ones, so that filtering by rows and
//! columns is exact. Beyond the border the nearest pixel goes on, as in the authors' programs. Tests: flip.

use std::f64::consts::PI;

use rayon::prelude::*;

use crate::base::error::{Error, Result};

/// Pixels per degree of the visual field at which scores are given: a screen 0.7 m away, 0.7 m wide, of 3840 pixels.
pub const PIXELS_PER_DEGREE: f64 = 67.0;

/// XYZ of the linear sRGB primaries (columns), as the paper's supplement has them.
const TO_XYZ: [[f64; 3]; 3] = [
    [
        10_135_552.0 / 24_577_794.0,
        8_788_810.0 / 24_577_794.0,
        4_435_075.0 / 24_577_794.0,
    ],
    [
        2_613_072.0 / 12_288_897.0,
        8_788_810.0 / 12_288_897.0,
        887_015.0 / 12_288_897.0,
    ],
    [
        1_425_312.0 / 73_733_382.0,
        8_788_810.0 / 73_733_382.0,
        70_074_185.0 / 73_733_382.0,
    ],
];

/// Contrast sensitivity as sums of Gaussians a·√(π/b)·exp(−π²x²/b), x in degrees (§4.1, Table 1): achromatic, red–green,
/// blue–yellow.
const SENSITIVITY: [&[(f64, f64)]; 3] = [
    &[(1.0, 0.0047)],
    &[(1.0, 0.0053)],
    &[(34.1, 0.04), (13.5, 0.025)],
];
/// The widest b above: every filter has the radius that it needs.
const WIDEST: f64 = 0.04;
/// Exponent of the colour difference, and the point (share of the largest difference → error) at which its compression
/// becomes a straight line (§4.1.3).
const COLOR_POWER: f64 = 0.7;
const KNEE_AT: f64 = 0.4;
const KNEE_TO: f64 = 0.95;
/// Width of the feature detector in degrees, and exponent of the feature difference (§4.2).
const FEATURE_WIDTH: f64 = 0.082;
const FEATURE_POWER: f64 = 0.5;

/// Rows that are processed at a time, to bound the memory for large photos.
const STRIP: usize = 96;

type Color = [f64; 3];
/// A picture by channels, each row after row.
type Planes = [Vec<f64>; 3];

/// ꟻLIP of `test` against `reference`, both planar RGB \[3, height, width\] in [0, 1] (sRGB): the error per pixel, row after
/// row, at so many pixels per degree.
///
/// # Errors
/// [`Error::Numerics`] for lengths that do not match, a side of 0, a value that is not in [0, 1], or a resolution that is no
/// positive number.
pub fn error_map(
    reference: &[f32],
    test: &[f32],
    width: usize,
    height: usize,
    pixels_per_degree: f64,
) -> Result<Vec<f64>> {
    let wrong = |what: String| Error::numerics("flip", what);
    let n = width * height;
    if n == 0 || reference.len() != 3 * n || test.len() != 3 * n {
        let (a, b) = (reference.len(), test.len());
        return Err(wrong(format!(
            "{a} and {b} values for {width} × {height} pixels; 3 per pixel expected"
        )));
    }
    if !(pixels_per_degree.is_finite() && pixels_per_degree > 0.0) {
        return Err(wrong(format!("{pixels_per_degree} pixels per degree")));
    }
    let inside = |v: &&f32| !(0.0..=1.0).contains(*v);
    if let Some(v) = reference.iter().chain(test).find(inside) {
        return Err(wrong(format!("a value of {v}; 0 to 1 expected")));
    }
    let mut map = Vec::with_capacity(n);
    for top in (0..height).step_by(STRIP) {
        let rows = STRIP.min(height - top);
        map.extend(strip(
            [reference, test],
            [width, height],
            [top, rows],
            pixels_per_degree,
        ));
    }
    Ok(map)
}

/// The error of some rows, with only as much of the picture in f64 as their filters reach.
fn strip(
    pictures: [&[f32]; 2],
    [width, height]: [usize; 2],
    [top, rows]: [usize; 2],
    pixels_per_degree: f64,
) -> Vec<f64> {
    let reach = blur_radius(pixels_per_degree).max(feature_radius(pixels_per_degree));
    // Rows beyond the picture repeat its last one, as the filters have it.
    let row = |y: usize| (top + y).saturating_sub(reach).min(height - 1) * width;
    let cut = |planar: &[f32]| -> Vec<f32> {
        let planes = planar.chunks_exact(width * height);
        let lines = planes.flat_map(|plane| {
            (0..rows + 2 * reach).flat_map(move |y| &plane[row(y)..row(y) + width])
        });
        lines.copied().collect()
    };
    let [a, b] = pictures.map(|p| opponent(&cut(p)));
    let size = [width, rows + 2 * reach];
    let colors = color_error(&a, &b, size, pixels_per_degree);
    let features = feature_error(&a[0], &b[0], size, pixels_per_degree);
    let inside = reach * width..(reach + rows) * width;
    let both = inside.into_par_iter();
    both.map(|i| colors[i].powf(1.0 - features[i])).collect()
}

/// Mean of [`error_map`] at [`PIXELS_PER_DEGREE`], weighted by `mask` \[height, width\] unless it is empty: 0 for equal
/// pictures and for a mask of zeros.
///
/// # Errors
/// Those of [`error_map`].
pub fn flip(
    reference: &[f32],
    test: &[f32],
    width: usize,
    height: usize,
    mask: &[f32],
) -> Result<f64> {
    let map = error_map(reference, test, width, height, PIXELS_PER_DEGREE)?;
    let weight = |i: usize| mask.get(i).map_or(1.0, |m| f64::from(*m));
    let all: f64 = (0..map.len()).map(weight).sum();
    let sum: f64 = map.iter().enumerate().map(|(i, v)| weight(i) * v).sum();
    Ok(if all > 0.0 { sum / all } else { 0.0 })
}

fn transform(m: &[[f64; 3]; 3], v: Color) -> Color {
    [0, 1, 2].map(|r| m[r][0] * v[0] + m[r][1] * v[1] + m[r][2] * v[2])
}

/// XYZ of white.
fn white() -> Color {
    transform(&TO_XYZ, [1.0; 3])
}

fn linear(v: f64) -> f64 {
    if v <= 0.04045 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

/// XYZ of linear sRGB, relative to white.
fn relative_xyz(rgb: Color) -> Color {
    let (xyz, white) = (transform(&TO_XYZ, rgb), white());
    [0, 1, 2].map(|c| xyz[c] / white[c])
}

/// The linear opponent space YCxCz of an sRGB picture, in which filtering takes place.
fn opponent(planar: &[f32]) -> Planes {
    let n = planar.len() / 3;
    let pixels = (0..n).into_par_iter().map(|i| {
        let rgb = [0, 1, 2].map(|c| linear(f64::from(planar[c * n + i])));
        let [x, y, z] = relative_xyz(rgb);
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    });
    let pixels: Vec<Color> = pixels.collect();
    [0, 1, 2].map(|c| pixels.iter().map(|p| p[c]).collect())
}

/// Linear sRGB of YCxCz, clamped to what a screen can show.
fn displayed([y, cx, cz]: Color, from_xyz: &[[f64; 3]; 3]) -> Color {
    let y = (y + 16.0) / 116.0;
    let (relative, white) = ([cx / 500.0 + y, y, y - cz / 200.0], white());
    let xyz = [0, 1, 2].map(|c| relative[c] * white[c]);
    transform(from_xyz, xyz).map(|v| v.clamp(0.0, 1.0))
}

/// CIELAB of linear sRGB, a and b weakened in the dark as Hunt found (§4.1.2).
fn hunt_lab(rgb: Color) -> Color {
    const KNEE: f64 = 6.0 / 29.0;
    let [x, y, z] = relative_xyz(rgb).map(|t| {
        if t > KNEE * KNEE * KNEE {
            t.cbrt()
        } else {
            t / (3.0 * KNEE * KNEE) + 4.0 / 29.0
        }
    });
    let lightness = 116.0 * y - 16.0;
    let weight = 0.01 * lightness;
    [
        lightness,
        weight * 500.0 * (x - y),
        weight * 200.0 * (y - z),
    ]
}

/// Difference of two colours, for large ones (Abasi et al. 2020).
fn hyab(a: Color, b: Color) -> f64 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// Inverse of a matrix by its cofactors.
fn inverse(m: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let cofactor = |r: usize, c: usize| {
        let (r1, r2, c1, c2) = ((r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3);
        m[r1][c1] * m[r2][c2] - m[r1][c2] * m[r2][c1]
    };
    let determinant: f64 = (0..3).map(|c| m[0][c] * cofactor(0, c)).sum();
    [0, 1, 2].map(|r| [0, 1, 2].map(|c| cofactor(c, r) / determinant))
}

/// A filter along one axis, 2·radius + 1 weights.
fn taps(radius: usize, weight: impl Fn(f64) -> f64) -> Vec<f64> {
    let r = radius as i64;
    (-r..=r).map(|i| weight(i as f64)).collect()
}

/// `plane` filtered by rows with `across` and by columns with `down`, of equal lengths.
fn filter(plane: &[f64], size: [usize; 2], across: &[f64], down: &[f64]) -> Vec<f64> {
    let [width, height] = size;
    let radius = across.len() / 2;
    // Position of tap k at i, the nearest there is.
    let at = |i: usize, k: usize, n: usize| (i + k).saturating_sub(radius).min(n - 1);
    let mut rows = vec![0.0; plane.len()];
    rows.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        let line = &plane[y * width..(y + 1) * width];
        let line: Vec<f64> = (0..width + 2 * radius)
            .map(|i| line[at(i, 0, width)])
            .collect();
        for (k, w) in across.iter().enumerate() {
            for (v, p) in out.iter_mut().zip(&line[k..]) {
                *v += w * p;
            }
        }
    });
    let mut out = vec![0.0; plane.len()];
    out.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (k, w) in down.iter().enumerate() {
            let from = at(y, k, height) * width;
            for (v, r) in out.iter_mut().zip(&rows[from..from + width]) {
                *v += w * r;
            }
        }
    });
    out
}

/// Radius of the filters of [`SENSITIVITY`], pixels: three standard deviations of the widest.
fn blur_radius(pixels_per_degree: f64) -> usize {
    (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as usize
}

/// Standard deviation of the feature detector, pixels.
fn feature_width(pixels_per_degree: f64) -> f64 {
    0.5 * FEATURE_WIDTH * pixels_per_degree
}

fn feature_radius(pixels_per_degree: f64) -> usize {
    (3.0 * feature_width(pixels_per_degree)).ceil() as usize
}

/// The picture as the eye resolves it at this distance, as linear sRGB.
fn blurred(picture: &Planes, size: [usize; 2], pixels_per_degree: f64) -> Vec<Color> {
    let radius = blur_radius(pixels_per_degree);
    let planes: Vec<Vec<f64>> = picture
        .iter()
        .zip(SENSITIVITY)
        .map(|(plane, gaussians)| {
            let parts: Vec<(f64, Vec<f64>)> = gaussians
                .iter()
                .map(|&(a, b)| {
                    let taps = taps(radius, |i| {
                        (-(PI * i / pixels_per_degree).powi(2) / b).exp()
                    });
                    (a * (PI / b).sqrt(), taps)
                })
                .collect();
            let mass = |(a, taps): &(f64, Vec<f64>)| a * taps.iter().sum::<f64>().powi(2);
            let total: f64 = parts.iter().map(mass).sum();
            let mut sum = vec![0.0; plane.len()];
            for (a, taps) in &parts {
                let part = filter(plane, size, taps, taps);
                for (s, p) in sum.iter_mut().zip(part) {
                    *s += a / total * p;
                }
            }
            sum
        })
        .collect();
    let from_xyz = inverse(&TO_XYZ);
    (0..planes[0].len())
        .into_par_iter()
        .map(|i| displayed([planes[0][i], planes[1][i], planes[2][i]], &from_xyz))
        .collect()
}

/// The difference of colours in [0, 1] (§4.1).
fn color_error(a: &Planes, b: &Planes, size: [usize; 2], pixels_per_degree: f64) -> Vec<f64> {
    let [a, b] = [a, b].map(|p| blurred(p, size, pixels_per_degree));
    let green = hunt_lab([0.0, 1.0, 0.0]);
    let blue = hunt_lab([0.0, 0.0, 1.0]);
    let largest = hyab(green, blue).powf(COLOR_POWER);
    let knee = KNEE_AT * largest;
    let pairs = a.par_iter().zip(&b);
    pairs
        .map(|(a, b)| {
            let difference = hyab(hunt_lab(*a), hunt_lab(*b)).powf(COLOR_POWER);
            if difference < knee {
                difference * KNEE_TO / knee
            } else {
                KNEE_TO + (difference - knee) / (largest - knee) * (1.0 - KNEE_TO)
            }
        })
        .collect()
}

/// Positive weights scaled to a sum of 1, negative ones to −1.
fn balanced(mut taps: Vec<f64>) -> Vec<f64> {
    let positive: f64 = taps.iter().filter(|w| **w > 0.0).sum();
    let negative: f64 = taps.iter().filter(|w| **w < 0.0).sum();
    for w in &mut taps {
        *w /= if *w > 0.0 { positive } else { -negative };
    }
    taps
}

/// The difference of edges and points in the achromatic channel, in [0, 1] (§4.2).
fn feature_error(a: &[f64], b: &[f64], size: [usize; 2], pixels_per_degree: f64) -> Vec<f64> {
    let sd = feature_width(pixels_per_degree);
    let radius = feature_radius(pixels_per_degree);
    let gaussian = |i: f64| (-i * i / (2.0 * sd * sd)).exp();
    let mut smooth = taps(radius, gaussian);
    let mass: f64 = smooth.iter().sum();
    smooth.iter_mut().for_each(|w| *w /= mass);
    let edge = balanced(taps(radius, |i| -i * gaussian(i)));
    let point = balanced(taps(radius, |i| (i * i / (sd * sd) - 1.0) * gaussian(i)));
    // The achromatic channel from 0 to 1.
    let unit = |plane: &[f64]| -> Vec<f64> { plane.iter().map(|y| (y + 16.0) / 116.0).collect() };
    let strength = |plane: &[f64], taps: &[f64]| -> Vec<f64> {
        let across = filter(plane, size, taps, &smooth);
        let down = filter(plane, size, &smooth, taps);
        across.iter().zip(down).map(|(x, y)| x.hypot(y)).collect()
    };
    let [a, b] = [a, b].map(unit);
    let [edges_a, edges_b] = [&a, &b].map(|p| strength(p, &edge));
    let [points_a, points_b] = [&a, &b].map(|p| strength(p, &point));
    (0..a.len())
        .map(|i| {
            let edges = (edges_a[i] - edges_b[i]).abs();
            let points = (points_a[i] - points_b[i]).abs();
            (std::f64::consts::FRAC_1_SQRT_2 * edges.max(points)).powf(FEATURE_POWER)
        })
        .collect()
}
