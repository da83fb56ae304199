//! [`Sizes`]: the sizes of the photos over a run, by the detail that each of the smaller ones loses.
//!
//! A smaller photo makes an iteration cheaper, and what it cannot show cannot be learnt from it. As long as the loss is larger than
//! what is lost, little is missed.

use rayon::prelude::*;

use crate::base::error::Result;
use crate::capture::{Alpha, Photo, PhotoSource};
use crate::config::WorkConfig;

/// Expected L1 loss after t of n iterations: `LOSS` · n^`LENGTH` / √t. Fitted at the smallest size of plush, fox, synth-outdoor and tankard, of
/// 400 to 640 pixels, n = 1000, 3000 and 30,000; residuals in docs/results/plan.md.
const LOSS: f64 = 0.2;
const LENGTH: f64 = 0.15;

/// Photos of which the detail is measured, evenly spread.
const SAMPLE: usize = 8;

/// Numbers of some of so many photos, evenly spread: those that stand for all.
pub(super) fn sample(photos: usize) -> impl Iterator<Item = usize> {
    let count = photos.min(SAMPLE);
    (0..count).map(move |k| k * photos / count)
}

/// Mean |p − q| of the photos, in units of the full range, where q is the mean of 2 × 2, 4 × 4, … pixels: a value for each of `halvings`.
/// Pixels count by their alpha. Never falls from one to the next.
///
/// # Errors
/// A photo that cannot be read.
pub fn detail(photos: &[&PhotoSource], halvings: u32) -> Result<Vec<f32>> {
    let chosen: Vec<usize> = sample(photos.len()).collect();
    let of_photo = |number: &usize| {
        let photo = photos[*number].load()?;
        Ok((1..=halvings).map(|h| lost(&photo, 1 << h)).collect())
    };
    let all: Vec<Vec<Lost>> = chosen.par_iter().map(of_photo).collect::<Result<_>>()?;
    let mut least = 0.0_f32;
    let mean = |h: usize| {
        let total = |of: fn(&Lost) -> f64| -> f64 { all.iter().map(|photo| of(&photo[h])).sum() };
        // Where no pixel counts nothing is known to be lost.
        least = least.max((total(|l| l.sum) / total(|l| l.weight).max(1.0)) as f32);
        least
    };
    Ok((0..halvings as usize).map(mean).collect())
}

/// Detail lost by a photo.
struct Lost {
    /// Sum of |p − q| over the values, each times its pixel's alpha: units of the full range.
    sum: f64,
    /// Sum of the alphas of the values.
    weight: f64,
}

/// Detail of a photo lost by the means of `factor` × `factor` pixels; what does not fill such a block is left out. Clear and masked
/// pixels count by their alpha: what is lost of an object does not depend on how much of the photo is empty.
fn lost(photo: &Photo, factor: usize) -> Lost {
    let [width, height] = [photo.width, photo.height].map(|s| s as usize);
    let [across, down] = [width / factor, height / factor];
    let (area, plane) = ((factor * factor) as u64, width * height);
    let alpha = (photo.alpha != Alpha::None).then(|| &photo.data[3 * plane..]);
    let (mut sum, mut weight) = (0_u64, 0_u64);
    for (channel, y) in (0..3).flat_map(|c| (0..down).map(move |y| (c, y))) {
        for x in 0..across {
            let first = y * factor * width + x * factor;
            let rows = || (0..factor).map(|row| first + row * width);
            let values = |row: usize| &photo.data[channel * plane + row..][..factor];
            let total: u64 = rows().flat_map(values).map(|v| u64::from(*v)).sum();
            for row in rows() {
                for (k, value) in values(row).iter().enumerate() {
                    let counts = alpha.map_or(255, |alpha| u64::from(alpha[row + k]));
                    // In units of 1/area, so that the sum is exact.
                    sum += counts * (u64::from(*value) * area).abs_diff(total);
                    weight += counts;
                }
            }
        }
    }
    Lost {
        sum: sum as f64 / (255 * area) as f64,
        weight: weight as f64,
    }
}

/// Sizes of the photos over a run: each smaller one until the loss is expected to be near the detail that it loses.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sizes {
    smaller: Vec<Smaller>,
}

/// End of the use of a size, for any length of the run.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Smaller {
    /// Iterations of a run of length 1.
    needed: f64,
    /// Largest share of the run.
    share: f64,
}

impl Sizes {
    /// The sizes for photos that lose so much [`detail`] by each halving.
    #[must_use]
    pub fn new(detail: &[f32], work: &WorkConfig) -> Self {
        let levels = detail.len() as f64;
        let smaller = |(k, lost): (usize, &f32)| Smaller {
            needed: (LOSS / (work.resolution_detail * f64::from(*lost)).max(1e-6)).powi(2),
            share: work.resolution_share * (k + 1) as f64 / levels,
        };
        Self {
            smaller: detail.iter().rev().enumerate().map(smaller).collect(),
        }
    }

    /// Sizes that end at shares of the run, whatever its length.
    #[must_use]
    pub fn at_shares(shares: &[f64]) -> Self {
        let smaller = |share: &f64| Smaller {
            needed: f64::INFINITY,
            share: *share,
        };
        Self {
            smaller: shares.iter().map(smaller).collect(),
        }
    }

    /// Numbers of iterations after which a run of a length leaves each of the smaller sizes, the smallest first.
    pub fn ends(&self, iterations: u32) -> impl Iterator<Item = u32> {
        let n = f64::from(iterations);
        let end = move |s: &Smaller| (s.needed * n.powf(2.0 * LENGTH)).min(s.share * n).round();
        self.smaller.iter().map(move |s| end(s) as u32)
    }

    /// Number of halvings at an iteration of a run of a length.
    #[must_use]
    pub fn halvings(&self, iteration: u32, iterations: u32) -> u32 {
        self.ends(iterations).filter(|end| iteration < *end).count() as u32
    }
}

#[cfg(test)]
mod tests {
    use super::{Sizes, detail};
    use crate::capture::{Alpha, Photo, PhotoSource};
    use crate::config::WorkConfig;
    use crate::device::PhotoScale;
    use crate::pipeline::stage::shrink::shrink;

    fn photo(value: impl Fn(u32, u32) -> u8) -> Photo {
        let (width, height) = (70, 41);
        let plane = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let plane: Vec<u8> = plane.map(|(x, y)| value(x, y)).collect();
        Photo {
            width,
            height,
            alpha: Alpha::None,
            data: plane.repeat(3),
        }
    }

    fn lost(photos: &[Photo], halvings: u32) -> Vec<f32> {
        let photos: Vec<PhotoSource> = photos.iter().cloned().map(PhotoSource::from).collect();
        let photos: Vec<&PhotoSource> = photos.iter().collect();
        detail(&photos, halvings).unwrap()
    }

    /// Mean |p − q| by the kernel's definition, whose pixels are rounded to whole grey levels.
    fn by_definition(photo: &Photo, factor: u32) -> f64 {
        let small = shrink(photo, PhotoScale::one_over(factor as usize));
        let at = |p: &Photo, x: u32, y: u32| f64::from(p.data[(y * p.width + x) as usize]);
        let (w, h) = (small.width * factor, small.height * factor);
        let pixels = (0..h).flat_map(|y| (0..w).map(move |x| (x, y)));
        let sum: f64 = pixels
            .map(|(x, y)| (at(photo, x, y) - at(&small, x / factor, y / factor)).abs())
            .sum();
        sum / (255.0 * f64::from(w * h))
    }

    #[test]
    fn detail_is_what_the_shrunk_photo_misses() {
        let textured = photo(|x, y| ((x * 37 + y * y * 11 + x * y) % 251) as u8);
        for (k, lost) in lost(std::slice::from_ref(&textured), 3).iter().enumerate() {
            let off = f64::from(*lost) - by_definition(&textured, 2 << k);
            assert!(off.abs() < 0.5 / 255.0, "{k}: {off}");
        }
        let ramp = photo(|x, _| x as u8);
        let [ramp, other] = [&[ramp.clone()][..], &[ramp, textured][..]].map(|p| lost(p, 3));
        assert!(ramp.is_sorted() && ramp[0] > 0.0, "{ramp:?}");
        assert!(other[0] > 10.0 * ramp[0], "all photos count: {other:?}");
        assert_eq!(lost(&[photo(|_, _| 200)], 2), [0.0; 2]);
        assert_eq!(lost(&[], 2), [0.0; 2]);
    }

    #[test]
    fn what_is_clear_or_masked_loses_nothing() {
        let textured = photo(|x, y| ((x * 37 + y * y * 11) % 251) as u8);
        let whole = lost(std::slice::from_ref(&textured), 2);
        for alpha in [Alpha::Transparency, Alpha::Mask] {
            let mut half = textured.clone();
            half.alpha = alpha;
            let there = |i: usize| i % 70 < 32;
            half.data
                .extend((0..70 * 41).map(|i| 255 * u8::from(there(i))));
            if alpha == Alpha::Transparency {
                let clear = (0..3 * 70 * 41).filter(|i| !there(*i));
                clear.for_each(|i| half.data[i] = 0);
            }
            let half = lost(&[half], 2);
            for (half, whole) in half.iter().zip(&whole) {
                assert!(
                    (half / whole - 1.0).abs() < 0.1,
                    "{alpha:?}: {half} {whole}"
                );
            }
        }
    }

    #[test]
    fn the_less_a_size_loses_the_longer_it_is_kept() {
        let work = WorkConfig::default();
        let ends =
            |detail: &[f32], n: u32| -> Vec<u32> { Sizes::new(detail, &work).ends(n).collect() };
        let rich = ends(&[0.0145, 0.0245, 0.0376], 30_000);
        let blurred = ends(&[0.0074, 0.0129, 0.0203], 30_000);
        assert!(rich.is_sorted() && rich[0] > 0, "{rich:?}");
        assert!(
            rich.iter().zip(&blurred).all(|(a, b)| a < b),
            "{rich:?} {blurred:?}"
        );
        // In a short run learning rates are higher, and the loss falls sooner; no more than a share of it is for smaller photos.
        let short = ends(&[0.0145, 0.0245, 0.0376], 1000);
        assert!(short.iter().zip(&rich).all(|(a, b)| a < b), "{short:?}");
        assert_eq!(ends(&[0.0, 0.0, 0.0], 1000), [250, 500, 750]);
        assert_eq!(ends(&[], 1000), [] as [u32; 0]);
        let sizes = Sizes::new(&[0.0, 0.0, 0.0], &work);
        let halvings = [0, 249, 250, 749, 750].map(|at| sizes.halvings(at, 1000));
        assert_eq!(halvings, [3, 3, 2, 1, 0]);
    }
}
