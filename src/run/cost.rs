//! Cost of an iteration by its pixels and Gaussians.

/// Cost of an iteration: p^[`PIXEL_POWER`] · g^[`GAUSSIAN_POWER`] for p times 100,000 pixels and g times 10,000 Gaussians, [`PER_PIXEL`] · p, and
/// [`PER_LAUNCH`]. Fitted at seventeen runs of eleven datasets, photos of 27 to 1600 px and 5000 to 57,000 Gaussians, and at nine cases of `bench`,
/// 400 to 1600 px and 30,000 to a million Gaussians; residuals of 7 % (root mean square; docs/results/budgets.md).
const PIXEL_POWER: f64 = 0.23;
const GAUSSIAN_POWER: f64 = 0.87;
const PER_PIXEL: f64 = 1.43;
const PER_LAUNCH: f64 = 0.28;

/// Gaussians of a run where their number is not known, or must not count.
pub(super) const TYPICAL: f64 = 30_000.0;

/// Cost of an iteration of so many pixels and Gaussians.
pub(super) fn cost(pixels: f64, gaussians: f64) -> f64 {
    let (p, g) = (pixels / 1e5, gaussians.max(1.0) / 1e4);
    p.powf(PIXEL_POWER) * g.powf(GAUSSIAN_POWER) + PER_PIXEL * p + PER_LAUNCH
}

#[cfg(test)]
mod tests {
    use super::cost;

    /// Costs grow with the photos and the Gaussians, more slowly than in proportion, and with many Gaussians nearly so.
    #[test]
    fn larger_photos_and_more_gaussians_cost_more() {
        for (from, to, least, most) in [
            ((43e3, 1e3), (43e3, 2e3), 1.05, 1.5),
            ((43e3, 3e4), (172e3, 3e4), 1.5, 3.0),
            ((6.4e5, 1e5), (2.56e6, 1e5), 2.3, 3.0),
            // Measured: 5.0.
            ((6.4e5, 1e5), (6.4e5, 1e6), 4.0, 6.0),
        ] {
            let ratio = cost(to.0, to.1) / cost(from.0, from.1);
            assert!((least..most).contains(&ratio), "{from:?} {to:?}: {ratio}");
        }
    }
}
