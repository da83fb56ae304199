//! [`Footprint`]: the memory that a run is expected to take at its peak.

use crate::device::DeviceKind;
use crate::train::Trainer;

/// Bytes of the program, its compiled kernels and what every run has.
const PROCESS: f64 = 117.0 * MEBI;
/// Bytes for each byte of the photos that are held at one time: host and device have one each now and then.
const PHOTOS: f64 = 1.5;
/// Bytes for each pixel of a view.
const PIXEL: f64 = 181e-6 * MEBI;
/// Bytes of ten thousand Gaussians, pairs, host copies, files and pages included, and the power of their number by which it grows. Fitted at fourteen
/// runs of 4 to 400 thousand Gaussians and 0.01 to 6.3 megapixels, whose peaks are told within 12 % (docs/results/speed.md).
const GAUSSIANS: f64 = 54.6 * MEBI;
const GAUSSIANS_POWER: f64 = 0.85;

const MEBI: f64 = 1_048_576.0;

/// Figures that the memory of a run on a CPU depends on, beside the number of Gaussians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Footprint {
    /// Bytes of the photos that are held at one time.
    pub photos: f64,
    /// Pixels of the largest view.
    pub pixels: f64,
}

impl Footprint {
    /// That of a run; `None` on other devices than a CPU, and where ranks share the run: of these nothing was measured.
    pub fn of(trainer: &Trainer) -> Option<Self> {
        let photos = trainer.photo_stats();
        let held = photos.total_bytes.min(photos.budget_bytes);
        let alone = trainer.ranks() == 1;
        (alone && trainer.device_kind() == DeviceKind::Cpu).then(|| Self {
            photos: held as f64,
            pixels: trainer.largest_photo() as f64,
        })
    }

    /// Most bytes of memory that the process is expected to take with so many Gaussians at SH degree 3.
    pub fn peak(&self, gaussians: f64) -> f64 {
        let scene = GAUSSIANS * (gaussians / 1e4).powf(GAUSSIANS_POWER);
        PROCESS + PHOTOS * self.photos + PIXEL * self.pixels + scene
    }

    /// The same in words.
    pub fn told(&self, gaussians: f64) -> String {
        let mega = self.peak(gaussians) / 1e6;
        match mega < 995.0 {
            true => format!("about {:.0} MB of memory", (mega / 10.0).round() * 10.0),
            false => format!("about {:.1} GB of memory", mega / 1e3),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Footprint;

    /// Peaks of runs that were not fitted: budgets of three and ten minutes, and 15,000 iterations.
    #[test]
    fn peaks_are_near_what_was_measured() {
        let mebi = f64::from(1 << 20);
        for ([views, width, height], gaussians, measured) in [
            ([97.0, 640.0, 478.0], 38_724.0, 495.0),
            ([25.0, 1600.0, 1066.0], 44_393.0, 875.0),
            ([50.0, 269.0, 480.0], 45_753.0, 355.0),
            ([64.0, 480.0, 359.0], 45_173.0, 408.0),
        ] {
            let pixels = width * height;
            let run = Footprint {
                photos: 3.0 * views * pixels,
                pixels,
            };
            let ratio = run.peak(gaussians) / mebi / measured;
            assert!((0.85..1.15).contains(&ratio), "{measured} MiB: {ratio}");
        }
    }

    #[test]
    fn sizes_are_told_in_round_numbers() {
        let small = Footprint {
            photos: 0.0,
            pixels: 0.0,
        };
        assert_eq!(small.told(0.0), "about 120 MB of memory");
        let large = Footprint {
            photos: 2e9,
            ..small
        };
        assert_eq!(large.told(1e6), "about 6.0 GB of memory");
    }
}
