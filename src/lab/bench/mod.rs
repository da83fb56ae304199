//! Time, throughput and error of every stage on a device, beside what the device can do at best.
//!
//! [`run`] measures one device: its own best multiply-add and copy rate, then whole iterations of synthetic scenes of
//! several sizes (and of a trained one), then every precision and cut-off against the f64 reference. Every figure is the
//! median of several samples with their range; a ratio is refused where there are fewer than
//! [`spread::RATIO_SAMPLES`].
//!
//! On machines that others share, CPU time is the clock to compare by: wall time and device time include the waiting.

mod case;
mod folder;
mod growth;
mod page;
mod peak;
mod precision;
pub mod record;
pub mod scene;
mod tables;
pub mod work;

pub use crate::lab::bench::folder::{csv, json, write_folder};
pub use crate::lab::bench::growth::growth;
pub use crate::lab::bench::page::page;
pub use crate::lab::bench::record::{BenchRecord, Outcome};
pub use crate::lab::bench::tables::markdown;
pub use crate::lab::stats;
pub use crate::lab::table::Table;

use std::path::{Path, PathBuf};

use crate::base::error::{Error, Result};
use crate::capture::Frame;
use crate::device::Device;
use crate::lab::bench::case::Subject;
use crate::lab::bench::record::Failure;
use crate::scene::ply::SceneFile;
use crate::scene::{Splats, orbit, ply};

/// The stages of an iteration, as they are listed.
pub const STAGES: [&str; 9] = [
    "project",
    "bin",
    "scan",
    "sort",
    "splat",
    "loss",
    "splat_grad",
    "project_grad",
    "adam",
];

/// Width and height at which a scene from a file is seen, pixels.
const SCENE_SIZE: u32 = 800;

/// What is measured.
#[derive(Debug, Clone)]
pub struct Options {
    /// Synthetic cases: Gaussians, width and height in pixels.
    pub cases: Vec<(usize, u32)>,
    /// A trained scene to measure besides.
    pub scene: Option<PathBuf>,
    /// Samples of every figure.
    pub samples: usize,
    /// A sample lasts at least this long, seconds.
    pub sample_seconds: f64,
    /// Gaussians and pixels of the scene on which precisions are compared.
    pub precision: Option<(usize, u32)>,
    /// Compare the precisions of the device's own tuning and cut only, which other runs have built already.
    #[doc(hidden)]
    pub own_build_only: bool,
}

impl Default for Options {
    /// Ends within three minutes on two cores.
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
        Self {
            cases: [400, 800, 1600]
                .iter()
                .flat_map(|size| numbers.map(|n| (n, *size)))
                .collect(),
            ..Self::default()
        }
    }

    /// Given cases in the shortest time that still fills every field; the figures mean nothing.
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

fn no_samples(stage: &str) -> Error {
    Error::Numerics {
        stage: stage.into(),
        what: "no time was measured; the driver's profiling counters or the clock do not advance"
            .into(),
    }
}

/// Measures one device; `note` is told what comes next. A case that the device cannot hold is listed among the failures.
///
/// # Errors
/// A scene file that cannot be read, a failure of the micro-benchmarks, or no case that could be measured.
pub fn run(device: &Device, options: &Options, note: &mut dyn FnMut(&str)) -> Result<BenchRecord> {
    let trained = options.scene.as_deref().map(read_scene).transpose()?;
    note("peak");
    let peak = peak::measure(device, options)?;
    let (mut cases, mut failed, mut last) = (Vec::new(), Vec::new(), None);
    let mut measure = |subject: &Subject<'_>| {
        note(&subject.title());
        match case::measure(device, &peak, subject, options) {
            Ok(case) => cases.push(case),
            Err(e) => {
                failed.push(failure(&subject.title(), &e));
                last = Some(e);
            }
        }
    };
    for (n, size) in &options.cases {
        measure(&Subject {
            name: growth::SYNTHETIC,
            splats: &scene::cloud(*n),
            dataset: scene::dataset(&scene::circle(*size)),
            anti_alias: false,
        });
    }
    if let Some((name, splats, anti_alias)) = &trained {
        measure(&Subject {
            name,
            splats,
            dataset: scene::dataset(&around(splats)),
            anti_alias: *anti_alias,
        });
    }
    if let (true, Some(error)) = (cases.is_empty(), last) {
        return Err(error);
    }
    let precision = precision::measure(device, options, note, &mut failed);
    Ok(BenchRecord {
        device: device.info().name.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        about: device.info().clone(),
        peak,
        growth: growth(&cases),
        cases,
        precision,
        failed,
    })
}

fn failure(what: &str, error: &Error) -> Failure {
    Failure {
        what: what.to_owned(),
        error: error.to_string(),
    }
}

/// Name and Gaussians of a scene, and whether its header says that it was trained with anti-aliasing.
fn read_scene(path: &Path) -> Result<(String, Splats, bool)> {
    let SceneFile {
        splats,
        anti_aliased: anti_alias,
    } = ply::read(path, &Frame::IDENTITY)?;
    if splats.is_empty() {
        let fix = "give a scene that `mhsplat train` wrote";
        return Err(Error::input(path, "holds no Gaussian", fix));
    }
    let name = path.file_name().unwrap_or(path.as_os_str());
    let with = if anti_alias {
        " with anti-aliasing"
    } else {
        ""
    };
    Ok((
        format!("{}{with}", name.to_string_lossy()),
        splats,
        anti_alias,
    ))
}

fn around(splats: &Splats) -> Vec<crate::capture::Camera> {
    let [x, y, z] = [0, 1, 2].map(|k| splats.planes()[k].as_slice());
    orbit([x, y, z], scene::VIEWS, [SCENE_SIZE; 2])
}

/// Measures several devices (name, selector for `open`), one after the other. A device that fails does not keep
/// the others from being measured.
pub fn run_all(
    devices: &[(String, Option<String>)],
    open: impl Fn(Option<&str>) -> Result<Device>,
    options: &Options,
    note: &mut dyn FnMut(&str),
) -> Vec<Outcome> {
    let measure = |(name, selector): &(String, Option<String>)| match open(selector.as_deref())
        .and_then(|device| run(&device, options, note))
    {
        Ok(record) => Outcome::Done(Box::new(record)),
        Err(error) => Outcome::Failed {
            device: name.clone(),
            error: error.to_string(),
        },
    };
    devices.iter().map(measure).collect()
}
