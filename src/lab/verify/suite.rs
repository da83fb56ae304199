//! The suites "quick" and "tiny": cases through every stage in all precisions and styles.

use crate::base::error::Result;
use crate::device::Device;
use crate::device::tuning::Tuning;
use crate::lab::verify::cases::{self, Case};
use crate::lab::verify::check::{
    EXACT, Row, SINGLE, SINGLE_MASKED_MAP, SINGLE_NEEDLES, Verification, check,
};
use crate::lab::verify::definition::Reference;
use crate::lab::verify::pass;
use crate::scene::Plane;

/// Runs the quick suite: a few small scenes, both precisions, the device's own style and the other one.
pub fn quick(device: &Device) -> Result<Verification> {
    suite(device, "quick", quick_cases())
}

/// Runs the tiny suite, for interpreters such as oclgrind: every stage of three scenes of two tiles, both precisions, both styles.
pub fn tiny(device: &Device) -> Result<Verification> {
    let mild = |name, sh_degree, seed| cases::mild(name, 12, [20, 10], sh_degree, seed);
    let alpha = mild("12 Gaussians, 20x10, SH 2, alpha", 2, 31).with_alpha();
    let mut filtered = mild("12 Gaussians, 20x10, SH 1, anti-aliased", 1, 32).anti_aliased(1);
    // Behind the camera: it takes the largest filter of the others.
    let behind = [0.0, 0.0, -8.0];
    filtered.splats.scatter(Plane::POSITION, 5, behind);
    let mut masked = mild("12 Gaussians, 20x10, SH 0, mask", 0, 33).with_mask();
    masked.error_map_bound = Some(SINGLE_MASKED_MAP);
    let cases = [
        ("alpha", alpha, SINGLE),
        ("anti-aliasing", filtered, SINGLE),
        ("mask", masked, SINGLE),
    ];
    suite(device, "tiny", cases)
}

fn suite(
    device: &Device,
    name: &'static str,
    cases: impl IntoIterator<Item = (&'static str, Case, f64)>,
) -> Result<Verification> {
    let mut rows = Vec::new();
    for (family, case, bound) in cases {
        rows.extend(verify_case(device, family, &case, bound)?);
    }
    Ok(Verification::new(device, name, rows))
}

fn quick_cases() -> Vec<(&'static str, Case, f64)> {
    vec![
        (
            "mild",
            cases::mild("300 Gaussians, 75x50, SH 3", 300, [75, 50], 3, 7),
            SINGLE,
        ),
        (
            "mild",
            cases::mild("40 Gaussians, 33x17, SH 0", 40, [33, 17], 0, 8),
            SINGLE,
        ),
        (
            "mild",
            cases::mild("1 Gaussian, 16x16, SH 1", 1, [16, 16], 1, 9),
            SINGLE,
        ),
        (
            "alpha",
            cases::mild("60 Gaussians, 40x48, SH 2", 60, [40, 48], 2, 10).with_alpha(),
            SINGLE,
        ),
        (
            "mask",
            cases::mild("60 Gaussians, 200x40, SH 1, mask", 60, [200, 40], 1, 12).with_mask(),
            SINGLE,
        ),
        ("needles", cases::needles(60, [64, 48], 11), SINGLE_NEEDLES),
        (
            "anti-aliasing",
            cases::mild(
                "anti-aliased, 200 Gaussians, 75x50, SH 1",
                200,
                [75, 50],
                1,
                12,
            )
            .anti_aliased(1),
            SINGLE,
        ),
        (
            "anti-aliasing",
            Case {
                name: "anti-aliased needles 1000:1".into(),
                ..cases::needles(60, [64, 48], 13).anti_aliased(30)
            },
            SINGLE_NEEDLES,
        ),
    ]
}

/// Rows of every stage of one case: f64 and f32 in the device's style, f32 in the other style.
pub fn verify_case(device: &Device, family: &str, case: &Case, bound: f64) -> Result<Vec<Row>> {
    let own = device.tuning();
    let other = if own.group_style {
        Tuning::CPU
    } else {
        Tuning {
            chunks: 64,
            ..Tuning::GPU
        }
    };
    let reference = Reference::new(case);
    let mut rows = Vec::new();
    if device.info().fp64 {
        let out = pass::run::<f64>(device, own, case, Some(&reference))?;
        rows.extend(check(family, case, &out, "f64", EXACT));
    }
    for (tuning, name) in [(own, "f32"), (other, "f32, other style")] {
        let out = pass::run::<f32>(device, tuning, case, Some(&reference))?;
        rows.extend(check(family, case, &out, name, bound));
    }
    Ok(rows)
}
