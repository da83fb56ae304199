//! Scenes that every stage is checked on, and their passage through the device and the reference.

use std::sync::LazyLock;

use mhsplat::gpu::Device;
use mhsplat::gpu::tuning::Tuning;
use mhsplat::reference::chain::Passage;
use mhsplat::verify::cases::{mild, needles};
use mhsplat::verify::chain::{self, Case, Outputs};
use mhsplat::verify::twin;

/// Bound between f64 kernels and the f64 reference, relative to the largest value (architecture rule 5).
pub const EXACT: f64 = 1e-10;
/// Bound between f32 and f64 kernels on mild scenes, relative to the largest value.
pub const SINGLE: f64 = 2e-5;

/// A case with everything computed once for all tests.
pub struct Done {
    pub case: Case,
    pub reference: Passage,
    pub double: Outputs,
    pub single: Outputs,
    /// One pixel per work-item, a work-group per tile.
    pub group: Outputs,
}

fn compute(case: Case) -> Done {
    let device = Device::open(None).unwrap();
    let tuning = Tuning::for_device(device.info());
    Done {
        reference: twin::run(&case),
        double: chain::run::<f64>(&device, tuning, &case).unwrap(),
        single: chain::run::<f32>(&device, tuning, &case).unwrap(),
        group: chain::run::<f32>(&device, Tuning { chunks: 64, ..Tuning::GPU }, &case).unwrap(),
        case,
    }
}

static DONE: LazyLock<Vec<Done>> = LazyLock::new(|| {
    vec![
        compute(mild("SH 3", 300, [75, 50], 3, 7)),
        compute(mild("SH 0, 33x17", 40, [33, 17], 0, 8)),
        compute(mild("one Gaussian, SH 1", 1, [16, 16], 1, 9)),
        compute(mild("alpha photo, SH 2", 60, [40, 48], 2, 10).with_alpha()),
        compute(needles(60, [64, 48], 11)),
    ]
});

/// Every case, computed on first use.
pub fn all() -> &'static [Done] {
    &DONE
}
