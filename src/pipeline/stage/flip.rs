//! LDR-ꟻLIP (`kernels/flip.cl`; Andersson et al. 2020): how different two pictures look when one is flipped to the other, 0 to 1 per pixel.
//!
//! Section numbers are the paper's. Its filters are sums of products of one-dimensional ones, so that filtering by rows and
//! columns is exact. Beyond the border the nearest pixel goes on, as in the authors' programs. Tests: flip, stage::flip.

use std::f64::consts::PI;

use crate::base::constants::{FLIP_KNEE, FLIP_PIXELS_PER_DEGREE, FLIP_POWER, FLIP_REACH};
use crate::base::error::Result;
use crate::device::{Array, ImageSize, Kernels, Program, Real};
use crate::pipeline::launch::Arguments;
use crate::pipeline::stage::loss::ImagePair;

/// Bytes of what lies between the launches in single precision: on CPUs few enough to stay in a cache with photos of some megapixels, on
/// GPUs enough for all of their cores.
const BETWEEN: [usize; 2] = [8 << 20, 16 << 20];
/// Fewest and most rows of a strip.
const STRIP_ROWS: [usize; 2] = [32, 256];
/// Filters of a picture.
const FILTERS: usize = 7;
/// Colour channels of both pictures.
const CHANNELS: usize = 2 * 3;
/// Weights of a filter.
const TAPS: usize = 2 * FLIP_REACH + 1;

/// The kernels and their scratch.
#[derive(Debug)]
pub struct Flip<R: Real> {
    program: Program,
    /// Rows of a strip.
    strip: usize,
    /// Filters and matrices, see `kernels/flip.cl`.
    table: Array<R>,
    opponents: Array<R>,
    filtered: Array<R>,
    errors: Array<R>,
}

/// Rows and columns of a strip with what its filters reach beyond it.
fn held(rows: usize, size: ImageSize, lanes: usize) -> [usize; 2] {
    // Whole vectors of the picture's columns see as many of the opponent space.
    let columns = size.pixels[0].next_multiple_of(lanes) + 2 * FLIP_REACH;
    [rows + 2 * FLIP_REACH, columns.next_multiple_of(lanes)]
}

impl<R: Real> Flip<R> {
    /// Builds the kernels for images of at most `largest` pixels.
    ///
    /// # Errors
    /// No room for the scratch, or the driver's.
    pub fn new(kernels: &Kernels, largest: ImageSize) -> Result<Self> {
        let (device, program) = (kernels.device(), kernels.build::<R>("flip")?);
        let each = (CHANNELS + 2 * FILTERS) * largest.padded()[0] * size_of::<f32>();
        let group_style = program.defines().tuning.group_style;
        let [fewest, most] = STRIP_ROWS;
        let strip = (BETWEEN[usize::from(group_style)] / each).clamp(fewest, most);
        let strip = strip.min(largest.pixels[1]);
        let [rows, columns] = held(strip, largest, program.lanes());
        let filtered = 2 * FILTERS * rows * largest.padded()[0];
        let values: Vec<R> = table().into_iter().map(R::of).collect();
        Ok(Self {
            table: Array::from_slice(device, "flip table", &values)?,
            opponents: Array::unset(device, "opponents", CHANNELS * rows * columns)?,
            filtered: Array::unset(device, "filtered", filtered)?,
            errors: Array::zeros(device, "flip errors", largest.pixels[1])?,
            strip,
            program,
        })
    }

    /// Sum of the errors of each row of a render, which is clamped to [0, 1], as far as its pixels count; waits.
    ///
    /// # Errors
    /// The driver's.
    pub fn rows(&self, pair: &ImagePair<'_, R>) -> Result<Vec<R>> {
        let ([width, height], [stride, _]) = (pair.size.pixels, pair.size.padded());
        for top in (0..height).step_by(self.strip) {
            let rows = self.strip.min(height - top);
            let [held, across] = held(rows, pair.size, self.program.lanes());
            let opponents = CHANNELS * held * across;
            let filtered = 2 * FILTERS * held * stride;
            pair.images(self.program.launch("flip_opponent"))
                .reals::<R>(pair.background.map(f64::from))
                .ints([top, held, across])
                .array(&self.table, self.table.len())
                .array(&self.opponents, opponents)
                .over_groups(held)?;
            self.program
                .launch("flip_rows")
                .array(&self.opponents, opponents)
                .ints([width, stride, held, across])
                .array(&self.table, self.table.len())
                .array(&self.filtered, filtered)
                .over_groups(held)?;
            self.program
                .launch("flip_columns")
                .array(&self.filtered, filtered)
                .photo(pair.photo, pair.size)
                .ints([stride, top, held])
                .array(&self.table, self.table.len())
                .array(&self.errors, height)
                .over_groups(rows)?;
        }
        self.errors.read(0, height)
    }
}

/// Filters by [`TAPS`], matrices and the largest difference, in the order that the kernels take them in.
fn table() -> Vec<f64> {
    let wide = |taps: Vec<f64>| {
        let beside = (TAPS - taps.len()) / 2;
        let zeros = vec![0.0; beside];
        [zeros.clone(), taps, zeros].concat()
    };
    let [smooth, edge, point] = features(FLIP_PIXELS_PER_DEGREE);
    let blurs = blurs(FLIP_PIXELS_PER_DEGREE).into_iter().flatten();
    // A product of two filters of half the weight's root each.
    let blurs = blurs.map(|(weight, taps)| taps.iter().map(|t| weight.sqrt() * t).collect());
    let filters = blurs.chain([smooth, edge, point]).flat_map(wide);
    let matrices = [relative_xyz_matrix(), inverse(&relative_xyz_matrix())];
    let matrices = matrices.into_iter().flatten().flatten();
    filters
        .chain(matrices)
        .chain([largest_difference()])
        .collect()
}

// Definition in f64.

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
/// Width of the feature detector in degrees, and exponent of the feature difference (§4.2).
const FEATURE_WIDTH: f64 = 0.082;
const FEATURE_POWER: f64 = 0.5;

type Color = [f64; 3];
/// A picture by channels, each row after row.
type Planes = [Vec<f64>; 3];

/// ꟻLIP of `test` against `reference`, both planar sRGB \[3, height, width\] in [0, 1]: the error per pixel, row after
/// row, at so many pixels per degree.
#[must_use]
pub fn error_map(
    reference: &[f64],
    test: &[f64],
    size: [usize; 2],
    pixels_per_degree: f64,
) -> Vec<f64> {
    let [a, b] = [reference, test].map(opponent);
    let colors = color_error(&a, &b, size, pixels_per_degree);
    let features = feature_error(&a[0], &b[0], size, pixels_per_degree);
    let both = colors.iter().zip(features);
    both.map(|(color, feature)| color.powf(1.0 - feature))
        .collect()
}

fn transform(m: &[[f64; 3]; 3], v: Color) -> Color {
    [0, 1, 2].map(|r| m[r][0] * v[0] + m[r][1] * v[1] + m[r][2] * v[2])
}

/// XYZ relative to white of linear sRGB, by columns.
fn relative_xyz_matrix() -> [[f64; 3]; 3] {
    TO_XYZ.map(|row| {
        let white: f64 = row.iter().sum();
        row.map(|v| v / white)
    })
}

fn linear(v: f64) -> f64 {
    if v <= 0.04045 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

/// The linear opponent space YCxCz of an sRGB picture, in which filtering takes place.
fn opponent(planar: &[f64]) -> Planes {
    let (n, to_relative) = (planar.len() / 3, relative_xyz_matrix());
    let pixels = (0..n).map(|i| {
        let rgb = [0, 1, 2].map(|c| linear(planar[c * n + i]));
        let [x, y, z] = transform(&to_relative, rgb);
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    });
    let pixels: Vec<Color> = pixels.collect();
    [0, 1, 2].map(|c| pixels.iter().map(|p| p[c]).collect())
}

/// Linear sRGB of YCxCz, clamped to what a screen can show.
fn displayed([y, cx, cz]: Color, from_relative: &[[f64; 3]; 3]) -> Color {
    let y = (y + 16.0) / 116.0;
    let relative = [cx / 500.0 + y, y, y - cz / 200.0];
    transform(from_relative, relative).map(|v| v.clamp(0.0, 1.0))
}

/// CIELAB of linear sRGB, a and b weakened in the dark as Hunt found (§4.1.2).
fn hunt_lab(rgb: Color) -> Color {
    const KNEE: f64 = 6.0 / 29.0;
    let [x, y, z] = transform(&relative_xyz_matrix(), rgb).map(|t| {
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

/// Largest difference of colours to [`FLIP_POWER`]: that of green and blue.
fn largest_difference() -> f64 {
    let [green, blue] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(hunt_lab);
    hyab(green, blue).powf(FLIP_POWER)
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
    let pixels = |of: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
        (0..plane.len()).map(|i| of(i % width, i / width)).collect()
    };
    // Where the weights cancel nothing is left of a plane that is the same everywhere, for a root to magnify.
    let sum = |taps: &[f64], value: &dyn Fn(usize) -> f64| -> f64 {
        let mass: f64 = taps.iter().sum();
        let center = if mass.abs() < 1e-9 {
            value(radius)
        } else {
            0.0
        };
        let each = taps.iter().enumerate();
        each.map(|(k, w)| w * (value(k) - center)).sum()
    };
    let rows = pixels(&|x, y| sum(across, &|k| plane[y * width + at(x, k, width)]));
    pixels(&|x, y| sum(down, &|k| rows[at(y, k, height) * width + x]))
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

/// Filters of each channel of the opponent space: one-dimensional ones, which are applied by rows and columns, and the weights of the
/// results. A channel that is the same everywhere stays so.
fn blurs(pixels_per_degree: f64) -> [Vec<(f64, Vec<f64>)>; 3] {
    let radius = blur_radius(pixels_per_degree);
    SENSITIVITY.map(|gaussians| {
        let parts = gaussians.iter().map(|&(a, b)| {
            let taps = taps(radius, |i| {
                (-(PI * i / pixels_per_degree).powi(2) / b).exp()
            });
            (a * (PI / b).sqrt(), taps)
        });
        let parts: Vec<(f64, Vec<f64>)> = parts.collect();
        let mass = |(a, taps): &(f64, Vec<f64>)| a * taps.iter().sum::<f64>().powi(2);
        let total: f64 = parts.iter().map(mass).sum();
        parts
            .into_iter()
            .map(|(a, taps)| (a / total, taps))
            .collect()
    })
}

/// The picture as the eye resolves it at this distance, as linear sRGB.
fn blurred(picture: &Planes, size: [usize; 2], pixels_per_degree: f64) -> Vec<Color> {
    let channels = picture.iter().zip(blurs(pixels_per_degree));
    let planes = channels.map(|(plane, parts)| {
        let mut sum = vec![0.0; plane.len()];
        for (weight, taps) in &parts {
            let part = filter(plane, size, taps, taps);
            sum.iter_mut().zip(part).for_each(|(s, p)| *s += weight * p);
        }
        sum
    });
    let planes: Vec<Vec<f64>> = planes.collect();
    let from_relative = inverse(&relative_xyz_matrix());
    let pixels = 0..planes[0].len();
    pixels
        .map(|i| displayed([planes[0][i], planes[1][i], planes[2][i]], &from_relative))
        .collect()
}

/// The difference of colours in [0, 1] (§4.1).
fn color_error(a: &Planes, b: &Planes, size: [usize; 2], pixels_per_degree: f64) -> Vec<f64> {
    let [a, b] = [a, b].map(|p| blurred(p, size, pixels_per_degree));
    let largest = largest_difference();
    let [share, error] = FLIP_KNEE;
    let knee = share * largest;
    let pairs = a.into_iter().zip(b);
    pairs
        .map(|(a, b)| {
            let difference = hyab(hunt_lab(a), hunt_lab(b)).powf(FLIP_POWER);
            if difference < knee {
                difference * error / knee
            } else {
                error + (difference - knee) / (largest - knee) * (1.0 - error)
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

/// Filters of the feature detector along one axis (§4.2): smooth, edge, point.
fn features(pixels_per_degree: f64) -> [Vec<f64>; 3] {
    let sd = feature_width(pixels_per_degree);
    let radius = feature_radius(pixels_per_degree);
    let gaussian = |i: f64| (-i * i / (2.0 * sd * sd)).exp();
    let mut smooth = taps(radius, gaussian);
    let mass: f64 = smooth.iter().sum();
    smooth.iter_mut().for_each(|w| *w /= mass);
    let edge = balanced(taps(radius, |i| -i * gaussian(i)));
    let point = balanced(taps(radius, |i| (i * i / (sd * sd) - 1.0) * gaussian(i)));
    [smooth, edge, point]
}

/// The difference of edges and points in the achromatic channel, in [0, 1] (§4.2).
fn feature_error(a: &[f64], b: &[f64], size: [usize; 2], pixels_per_degree: f64) -> Vec<f64> {
    let [smooth, edge, point] = features(pixels_per_degree);
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

#[cfg(test)]
mod tests {
    use super::{FLIP_PIXELS_PER_DEGREE, FLIP_REACH, blur_radius, feature_radius};

    #[test]
    fn the_kernels_filters_reach_as_far_as_they_need_to() {
        let ppd = FLIP_PIXELS_PER_DEGREE;
        assert_eq!(blur_radius(ppd).max(feature_radius(ppd)), FLIP_REACH);
    }
}
