//! Options of the bench.

use std::path::PathBuf;

/// The cases to measure, and how long.
#[derive(Debug, Clone)]
pub struct Options {
    /// Synthetic cases: Gaussians, width and height in pixels.
    pub cases: Vec<(usize, u32)>,
    /// A trained scene to measure besides.
    pub scene: Option<PathBuf>,
    /// Samples of every figure.
    pub samples: usize,
    /// Least duration of a sample, seconds.
    pub sample_seconds: f64,
    /// Gaussians and pixels of the scene on which precisions are compared.
    pub precision: Option<(usize, u32)>,
    /// Compare the precisions of the device's own tuning and cut only, which other runs have built already.
    #[doc(hidden)]
    pub own_build_only: bool,
}

impl Default for Options {
    /// Cases that end within three minutes on two cores.
    fn default() -> Self {
        Self {
            cases: vec![
                (10_000, 400),
                (100_000, 400),
                (100_000, 800),
                (500_000, 800),
                (100_000, 1600),
            ],
            scene: None,
            samples: 7,
            sample_seconds: 0.6,
            precision: Some((2000, 160)),
            own_build_only: false,
        }
    }
}

impl Options {
    /// Every number of Gaussians at every resolution.
    #[must_use]
    pub fn full() -> Self {
        let numbers = [10_000, 100_000, 500_000, 1_000_000];
        let at_size = |size| numbers.map(|n| (n, size));
        Self {
            cases: [400, 800, 1600].map(at_size).concat(),
            ..Self::default()
        }
    }

    /// These cases in the shortest time that still fills every field; the figures mean nothing.
    #[doc(hidden)]
    #[must_use]
    pub fn brief(cases: Vec<(usize, u32)>) -> Self {
        Self {
            cases,
            samples: 3,
            sample_seconds: 0.02,
            precision: Some((60, 32)),
            own_build_only: true,
            ..Self::default()
        }
    }
}
