//! Every stage on a device against the f64 reference: error and time.
//!
//! Each case goes through the reference, through the kernels in f64 (where the device has it; this finds wrong formulas)
//! and through the kernels in f32 (rounding alone).

pub mod cases;
pub mod check;
pub mod definition;
mod optimise;
mod outcome;
pub mod page;
pub mod pass;
pub mod stress;

use crate::base::error::Result;
use crate::device::tuning::Tuning;
use crate::device::{Device, DeviceInfo, DeviceKind};
use crate::lab::verify::cases::{Case, mild, needles};
use crate::lab::verify::check::{EXACT, Row, check};
use crate::lab::verify::definition::Reference;
use crate::scene::Plane;

pub use check::{FamilyNote, Verification};

/// Bound on f32 kernels, 1 − SSIM of the tiny suite's masked photo. Half of it is black in render and photo alike: variances of
/// black cancel, as the images are shifted by a half (1.8e-5 was measured; in larger masked photos such values are few enough
/// to be counted as flips).
const SINGLE_MASKED_MAP: f64 = 1e-4;

/// Runs the quick suite: a few small scenes, both precisions, the device's own style and [`other_style`].
pub fn quick(device: &Device) -> Result<Verification> {
    let mut filtered_needles = needles(60, [64, 48], 13).anti_aliased(30);
    filtered_needles.name = "anti-aliased needles 1000:1".into();
    let filtered = "anti-aliased, 200 Gaussians, 75x50, SH 1";
    let cases = [
        mild("300 Gaussians, 75x50, SH 3", 300, [75, 50], 3, 7),
        mild("40 Gaussians, 33x17, SH 0", 40, [33, 17], 0, 8),
        mild("1 Gaussian, 16x16, SH 1", 1, [16, 16], 1, 9),
        mild("60 Gaussians, 40x48, SH 2", 60, [40, 48], 2, 10).with_alpha(),
        mild("60 Gaussians, 200x40, SH 1, mask", 60, [200, 40], 1, 12).with_mask(),
        needles(60, [64, 48], 11),
        mild(filtered, 200, [75, 50], 1, 12).anti_aliased(1),
        filtered_needles,
    ];
    suite(device, "quick", &cases)
}

/// Runs the tiny suite, for interpreters such as oclgrind: every stage of three scenes of two tiles or three, both precisions, the device's styles.
pub fn tiny(device: &Device) -> Result<Verification> {
    let mild = |name, sh_degree, seed| mild(name, 12, [36, 10], sh_degree, seed);
    let alpha = mild("12 Gaussians, 36x10, SH 2, alpha", 2, 31).with_alpha();
    let mut filtered = mild("12 Gaussians, 36x10, SH 1, anti-aliased", 1, 32).anti_aliased(1);
    // Behind the camera: it takes the largest filter of the others.
    let behind = [0.0, 0.0, -8.0];
    filtered.splats.scatter(Plane::POSITION, 5, behind);
    let mut masked = mild("12 Gaussians, 36x10, SH 0, mask", 0, 33).with_mask();
    masked.error_map_bound = Some(SINGLE_MASKED_MAP);
    suite(device, "tiny", &[alpha, filtered, masked])
}

fn suite(device: &Device, name: &'static str, cases: &[Case]) -> Result<Verification> {
    let rows = cases.iter().map(|case| verify_case(device, case));
    let rows = rows.collect::<Result<Vec<_>>>()?.concat();
    Ok(Verification::new(device, name, rows))
}

/// The style that a device is checked in beside its own. A GPU is not asked for that of CPUs, whose vectors and private arrays take tens
/// of kilobytes for each of its work-items: it may refuse them though it trains well. `MHSPLAT_TUNING` asks for it.
#[must_use]
pub fn other_style(own: Tuning, info: &DeviceInfo) -> Option<Tuning> {
    let other = match (own.group_style, info.kind) {
        (false, _) => Tuning {
            chunks: 64,
            ..Tuning::GPU
        },
        (true, DeviceKind::Cpu) => Tuning::CPU,
        (true, _) => return None,
    };
    other.fault(info).is_none().then_some(other)
}

/// Rows of every stage of one case: f64 and f32 in the device's style, f32 in the other style if the device is to have it.
pub fn verify_case(device: &Device, case: &Case) -> Result<Vec<Row>> {
    let own = device.tuning();
    let other = other_style(own, device.info()).map(|other| (other, "f32, other style"));
    let reference = Reference::new(case);
    let mut rows = Vec::new();
    if device.info().fp64 {
        let out = pass::run::<f64>(device, own, case, Some(&reference))?;
        rows.extend(check(case, &out, "f64", EXACT));
    }
    for (tuning, name) in [(own, "f32")].into_iter().chain(other) {
        let out = pass::run::<f32>(device, tuning, case, Some(&reference))?;
        rows.extend(check(case, &out, name, case.bound));
    }
    Ok(rows)
}
