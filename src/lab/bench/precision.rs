//! Error against time of every way to build the kernels, on a scene small enough for the f64 reference.
//!
//! The reference of the precisions, widths and styles has the same alpha cut as the kernels, so that their error is
//! rounding; that of the cuts has none to speak of, so that theirs is what is cut off.

use crate::base::constants::ALPHA_MIN;
use crate::base::error::{Error, Result};
use crate::device::tuning::Tuning;
use crate::device::{Device, DeviceKind, Real};
use crate::lab::bench::options::Options;
use crate::lab::bench::record::{Failure, Precision, spread};
use crate::lab::bench::scene;
use crate::lab::error::measure as error;
use crate::lab::verify::cases::Case;
use crate::lab::verify::definition::Reference;
use crate::lab::verify::pass;
use crate::lab::verify::pass::Outcome;

/// Stages and the quantities of them that are compared. Stages that run more than once in a pass are left out.
const COMPARED: [(&str, &str); 4] = [
    ("project", "quadratic form"),
    ("splat", "image"),
    ("splat_grad", "sums"),
    ("project_grad", "position"),
];
/// Stages that the alpha cut reaches.
const CUT: [&str; 2] = ["splat", "splat_grad"];
/// The cut that stands for none: 10⁵ contributions of this alpha are below f32's resolution.
const NO_CUT: f64 = 1e-13;
/// Vector widths, with the width of their blocks of pixels.
const WIDTHS: [(u32, u32); 4] = [(1, 1), (4, 2), (8, 4), (16, 4)];
/// Alpha cuts: 3DGS's and the default here, a coarse one, and one as good as none.
const CUTS: [(&str, f64); 3] = [
    ("cut 1/255", ALPHA_MIN),
    ("cut 1e-3", 1e-3),
    ("cut 1e-7", 1e-7),
];

/// A way to build the kernels.
#[derive(Debug, Clone, PartialEq)]
struct Variant {
    name: String,
    tuning: Tuning,
    double: bool,
    /// Alpha cut.
    alpha_min: f64,
    /// True if the cut is what is compared: with the reference that cuts nothing, instead of the one with the same cut.
    cut: bool,
}

/// On CPUs every vector width in their style; the style of GPUs, f64 as the device would have it, and every cut: as far as the
/// device supports them. Compilers of GPUs take minutes for the widths, with which nobody runs there.
fn variants(device: &Device) -> Vec<Variant> {
    let (info, own) = (device.info(), device.tuning());
    let single = |name: String, tuning: Tuning| Variant {
        name,
        tuning,
        double: false,
        alpha_min: ALPHA_MIN,
        cut: false,
    };
    let by_width = |(vector_width, block_width): (u32, u32)| {
        let tuning = Tuning {
            vector_width,
            block_width,
            ..Tuning::CPU
        };
        single(format!("f32 × {vector_width}"), tuning)
    };
    let widths = WIDTHS.into_iter().filter(|_| info.kind == DeviceKind::Cpu);
    let mut all: Vec<Variant> = widths.map(by_width).collect();
    if info.max_work_group >= Tuning::GPU.tile_pixels() {
        let chunks = own.chunks;
        let group = Tuning {
            chunks,
            ..Tuning::GPU
        };
        all.push(single("f32, group per tile".into(), group));
    }
    if info.fp64 {
        all.push(Variant {
            double: true,
            ..single("f64".into(), own)
        });
    }
    all.extend(CUTS.map(|(name, alpha_min)| Variant {
        alpha_min,
        cut: true,
        ..single(name.into(), own)
    }));
    all
}

/// Runs every variant; one that fails is listed among the failures.
pub(super) fn measure(
    device: &Device,
    options: &Options,
    note: &mut dyn FnMut(&str),
    failed: &mut Vec<Failure>,
) -> Vec<Precision> {
    let Some((gaussians, size)) = options.precision else {
        return Vec::new();
    };
    let mut all = variants(device);
    if options.own_build_only {
        let own = device.tuning();
        all.retain(|v| v.tuning == own && v.alpha_min == ALPHA_MIN);
    }
    let case = |alpha_min: f64| scene::case(gaussians, size, alpha_min);
    let [same_cut, no_cut] = [ALPHA_MIN, NO_CUT].map(|cut| Reference::new(&case(cut)));
    let mut rows = Vec::new();
    for v in all {
        let what = format!("precision: {}", v.name);
        note(&what);
        let case = case(v.alpha_min);
        let reference = if v.cut { &no_cut } else { &same_cut };
        let runs = match v.double {
            true => passes::<f64>(device, v.tuning, &case, reference, options.samples),
            false => passes::<f32>(device, v.tuning, &case, reference, options.samples),
        };
        let stages = COMPARED.iter().filter(|(s, _)| !v.cut || CUT.contains(s));
        let of_variant = runs.and_then(|runs| {
            let row =
                |(stage, quantity): &(&'static str, &str)| row(stage, quantity, &v.name, &runs);
            stages.map(row).collect::<Result<Vec<_>>>()
        });
        match of_variant {
            Ok(of_variant) => rows.extend(of_variant),
            Err(e) => failed.push(Failure::new(&what, &e)),
        }
    }
    rows
}

/// Passes through all stages, the first of them with the reference; an earlier one, which may wait for the compiler, is left out.
fn passes<R: Real>(
    device: &Device,
    tuning: Tuning,
    case: &Case,
    reference: &Reference,
    samples: usize,
) -> Result<Vec<Outcome>> {
    pass::run::<R>(device, tuning, case, None)?;
    (0..samples.max(1))
        .map(|k| pass::run::<R>(device, tuning, case, (k == 0).then_some(reference)))
        .collect()
}

fn row(stage: &'static str, quantity: &str, variant: &str, runs: &[Outcome]) -> Result<Precision> {
    let mut all = runs.iter().flat_map(|r| &r.quantities);
    let found = all.find(|q| q.stage == stage && q.name == quantity);
    let (got, want) = found.map_or((&[][..], &[][..]), |q| (&q.got, &q.want));
    let report = error(got, want, f64::INFINITY, 0.0);
    if report.non_finite > 0 || got.len() != want.len() || got.is_empty() {
        let (n, wanted, bad) = (got.len(), want.len(), report.non_finite);
        let what =
            format!("{n} values of which {bad} are not finite; {wanted} finite ones expected");
        return Err(Error::numerics(stage, what));
    }
    let times = runs.iter().flat_map(|r| &r.seconds);
    let times = times.filter(|(name, _)| *name == stage);
    Ok(Precision {
        stage,
        variant: variant.to_owned(),
        ms: spread(stage, times.map(|(_, seconds)| 1e3 * seconds))?,
        max_rel_error: report.max,
        median_rel_error: report.median,
    })
}
