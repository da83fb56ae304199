//! Bound on the number of Gaussians by the photos.

use rustc_hash::FxHashSet;

use crate::capture::{Alpha, Dataset};
use crate::config::{Init, Sampler, TrainConfig};
use crate::train::reasons::{Decided, Why};

/// Training pixels for which there may be a Gaussian, however few the sparse points and the photos are.
const LEAST_PIXELS: f64 = 64.0;

/// Bound on the number of Gaussians: the user's, or for mh that of the photos. More Gaussians than the sparse points overfit few photos:
/// nothing tells what is wrong between them. Photos of more pixels, and more photos to compare each with, allow more; one Gaussian for
/// [`LEAST_PIXELS`] is always allowed. Measured where the first Gaussians are those of sparse points and photos are opaque
/// (docs/results/overfitting.md).
pub(super) fn most_gaussians(
    dataset: &Dataset,
    config: &TrainConfig,
    alpha: Alpha,
) -> Decided<Option<usize>> {
    let each = config.mh.pair_pixels;
    if let Some(most) = config.max_gaussians {
        return Decided::new(Some(most), Why::AtMost(most));
    }
    let points = match config.init {
        Init::Points => dataset.point_count(),
        Init::Random | Init::File(_) => 0,
    };
    let why = match alpha {
        _ if config.sampler != Sampler::Mh => Why::Criterion("the bound is of the mh sampler"),
        _ if each == 0.0 => Why::Criterion("mh.pair-pixels is 0"),
        Alpha::Transparency => Why::Transparent,
        Alpha::Mask => Why::Criterion("masks say which pixels count"),
        Alpha::None if points == 0 => Why::Criterion("the first Gaussians are not sparse points"),
        Alpha::None => {
            let cameras = dataset.train.iter().map(|view| &view.camera);
            let pixels: u64 = cameras
                .clone()
                .map(|c| u64::from(c.width) * u64::from(c.height))
                .sum();
            // The sides of a panorama have one centre, and nothing to compare.
            let places: FxHashSet<_> = cameras
                .map(|c| c.center().to_array().map(f64::to_bits))
                .collect();
            let pairs = places.len().saturating_sub(1) as f64 / 2.0;
            let by_photos = pixels as f64 * (pairs / each).max(1.0 / LEAST_PIXELS);
            let by_photos = by_photos.min(f64::from(u32::MAX)) as usize;
            // Of points that were found as many as wanted say nothing about the photos.
            return if by_photos > points || dataset.swept.is_some() {
                Decided::new(Some(by_photos), Why::OverfitBeyond(by_photos, places.len()))
            } else {
                Decided::new(Some(points), Why::AtPoints(points))
            };
        }
    };
    Decided::new(None, why)
}
