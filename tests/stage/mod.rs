//! One file per stage: the device against the reference on shared cases, and what is particular to the stage.

mod active_tiles;
mod adam;
mod bin;
mod edit;
mod exposure;
mod filter;
mod flip;
mod importance;
mod loss;
mod metrics;
mod morton;
mod noise;
mod peak;
mod photo_error;
mod project;
mod project_grad;
mod route;
mod scan;
mod screen_grad;
mod seen;
mod shrink;
mod sort;
mod splat;
mod splat_grad;

use std::sync::LazyLock;

use crate::device;
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Defines, Device, Kernels};
use mhsplat::lab::verify::cases::{self, Case, SINGLE};
use mhsplat::lab::verify::check::{EXACT, Row, check};
use mhsplat::lab::verify::definition::Reference;
use mhsplat::lab::verify::pass::Outcome;
use mhsplat::lab::verify::{pass, verify_case};

/// Tunings of CPUs and GPUs, and of GPUs with chunks that groups go over in several steps.
const TUNINGS: [Tuning; 3] = [
    Tuning::CPU,
    Tuning::GPU,
    Tuning {
        chunks: 3,
        ..Tuning::GPU
    },
];

fn kernels(device: &Device) -> Kernels {
    Kernels::new(device, Defines::new(Tuning::for_device(device.info())))
}

/// The cases of the stage tests; every image has parts of tiles.
fn scenes() -> Vec<Case> {
    vec![
        cases::mild("SH 3", 200, [75, 50], 3, 21),
        cases::mild("SH 2, alpha", 50, [33, 17], 2, 22).with_alpha(),
        cases::mild("SH 1, mask", 90, [170, 40], 1, 26).with_mask(),
        cases::mild("SH 1", 1, [1, 1], 1, 23),
        cases::mild("SH 0, wide", 80, [130, 20], 0, 24),
        cases::needles(40, [64, 48], 25),
        anti_aliased(),
        cases::needles(40, [64, 48], 28).anti_aliased(30),
    ]
}

fn anti_aliased() -> Case {
    cases::mild("SH 1, anti-aliased", 90, [60, 44], 1, 27).anti_aliased(1)
}

static ROWS: LazyLock<Vec<Row>> = LazyLock::new(|| {
    let device = device();
    scenes()
        .iter()
        .flat_map(|case| verify_case(&device, case).unwrap())
        .collect()
});

/// Asserts that every quantity of a stage is within its bounds, in f64, f32 and both styles.
fn agrees(stage: &str) {
    let rows: Vec<&Row> = ROWS.iter().filter(|r| r.stage == stage).collect();
    assert!(
        rows.len() >= 3 * scenes().len(),
        "{stage}: {} rows",
        rows.len()
    );
    for row in rows {
        assert!(row.pass && row.non_finite == 0, "{row:?}");
    }
}

/// A pass in f32, without a reference.
fn run(tuning: Tuning, case: &Case) -> Outcome {
    pass::run::<f32>(&device(), tuning, case, None).unwrap()
}

/// Numbers of a quantity in `n` planes.
fn planes(out: &Outcome, stage: &str, name: &str, n: usize) -> Vec<Vec<f64>> {
    let got = out.got(stage, name);
    got.chunks(got.len() / n).map(<[f64]>::to_vec).collect()
}

/// Asserts that the check of a stage rejects a quantity of 60 Gaussians that `spoil` has changed.
fn rejects(stage: &str, name: &str, spoil: impl Fn(&mut Vec<f64>)) {
    let case = cases::mild("changed", 60, [40, 30], 1, 26);
    rejects_in(stage, name, &case, spoil);
}

/// [`rejects`] with another case.
fn rejects_in(stage: &str, name: &str, case: &Case, spoil: impl Fn(&mut Vec<f64>)) {
    let (device, reference) = (device(), Reference::new(case));
    let tuning = Tuning::for_device(device.info());
    let mut out = pass::run::<f32>(&device, tuning, case, Some(&reference)).unwrap();
    let fails = |out: &Outcome| {
        let rows = check(case, out, "f32", case.bound);
        rows.iter().any(|r| r.stage == stage && !r.pass)
    };
    assert!(!fails(&out));
    let mut all = out.quantities.iter_mut();
    let quantity = all.find(|q| q.stage == stage && q.name == name).unwrap();
    spoil(&mut quantity.got);
    assert!(fails(&out), "{stage}, {name}: a wrong result went through");
}

#[test]
fn f64_bound_is_far_below_the_f32_bound() {
    const { assert!(EXACT < 1e-4 * SINGLE) };
}
