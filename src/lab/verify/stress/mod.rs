//! The stress suite: the same stages, held against the reference where numbers are stiff.
//!
//! A family is a series of cases along one measure of stiffness, so that the error is a curve. Every case has its place in the
//! table; a family has one bound on the f32 errors, with its reason. Kernels in f64 are within [`super::check::EXACT`] everywhere.
//!
//! | file | what |
//! |---|---|
//! | `scenes.rs`, `shapes.rs`, `places.rs` | families of scenes through all stages |
//! | `updates.rs` | the optimiser under extreme gradients |
//! | `frames.rs` | datasets far from the origin or in extreme units |
//! | `sampling.rs` | density control on the host at its extremes |

mod frames;
mod places;
mod sampling;
pub mod scenes;
mod shapes;
mod updates;

use serde::Serialize;

use crate::base::constants::NEAR;
use crate::base::error::Result;
use crate::device::tuning::status;
use crate::device::{CameraArg, Defines, Device};
use crate::lab::verify::chain::Case;
use crate::lab::verify::check::Row;
use crate::lab::verify::{Verification, verify_case};
use crate::pipeline::buffers::GaussianBuffers;
use crate::pipeline::forward::{Quantity, RenderOptions, Renderer};

/// A case and how stiff it is.
#[derive(Debug, Clone)]
pub struct Stiff {
    /// In the unit of the family's axis, > 0.
    pub stiffness: f64,
    /// The case.
    pub case: Case,
}

/// What a family is about.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FamilyNote {
    /// Name.
    pub name: &'static str,
    /// What the stiffness is.
    pub axis: &'static str,
    /// Bound on the f32 errors, relative to the largest value of a quantity.
    pub bound: f64,
    /// Why that bound.
    pub reason: &'static str,
}

/// Cases along one measure of stiffness.
#[derive(Debug, Clone)]
pub struct Family {
    /// What it is about.
    pub note: FamilyNote,
    /// Rising in stiffness.
    pub cases: Vec<Stiff>,
}

/// The whole suite on one device.
pub fn stress(device: &Device) -> Result<Verification> {
    let (mut rows, mut notes) = (Vec::new(), Vec::new());
    for family in scenes::families() {
        rows.extend(verify_family(device, &family)?);
        notes.push(family.note);
    }
    let others = beside_scenes(device)?;
    rows.extend(others.0);
    notes.extend(others.1);
    Ok(Verification {
        families: notes,
        ..Verification::of(device, "stress", rows)
    })
}

/// What is no scene: the count of pairs, the optimiser, world frames, density control.
///
/// # Errors
/// See [`stress`].
pub fn beside_scenes(device: &Device) -> Result<(Vec<Row>, Vec<FamilyNote>)> {
    let mut rows = vec![more_pairs_than_24_bits(device)?];
    rows.extend(updates::all(device)?);
    rows.extend(frames::rows());
    rows.extend(sampling::rows()?);
    Ok((rows, vec![updates::NOTE, frames::NOTE, sampling::NOTE]))
}

/// Every case of a family.
///
/// # Errors
/// See [`stress`].
pub fn verify_family(device: &Device, family: &Family) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for Stiff { stiffness, case } in &family.cases {
        let of_case = verify_case(device, family.note.name, case, family.note.bound)?;
        rows.extend(of_case.into_iter().map(|row| Row {
            stiffness: Some(*stiffness),
            ..row
        }));
    }
    Ok(rows)
}

/// A picture of 18 million pairs, of which the first layers hide the rest: it is that of those layers alone.
fn more_pairs_than_24_bits(device: &Device) -> Result<Row> {
    const LAYERS: [usize; 2] = [1100, 30];
    let mut images = Vec::new();
    let mut pairs = 0;
    for n in LAYERS {
        let case = scenes::many_pairs(n);
        let (image, count) = forward(device, &case)?;
        pairs = pairs.max(count);
        images.push(image);
    }
    let tiles = (scenes::MANY_SIDE as usize / crate::base::constants::TILE as usize).pow(2);
    let largest = images[1].iter().fold(0.0f32, |l, v| l.max(v.abs()));
    let mut errors: Vec<f64> = images[0]
        .iter()
        .zip(&images[1])
        .map(|(a, b)| f64::from((a - b).abs() / largest))
        .collect();
    errors.push(pairs.abs_diff(tiles * LAYERS[0]) as f64);
    let stiffness = (tiles * LAYERS[0]) as f64;
    let (family, case) = ("crowds and ties", "more than 2^24 pairs");
    Ok(host_row(
        family,
        case,
        "splat",
        "image, pairs (f32)",
        stiffness,
        &errors,
        0.0,
    ))
}

/// Image and number of pairs.
fn forward(device: &Device, case: &Case) -> Result<(Vec<f32>, usize)> {
    let defines = Defines::new(device.tuning());
    let mut renderer = Renderer::<f32>::new(device, defines, case.sh_degree, true)?;
    let scene = GaussianBuffers::<f32>::upload(device, &case.splats, 0)?;
    let camera = CameraArg::<f32>::new(&case.camera, NEAR);
    let options = RenderOptions {
        sh_degree: case.sh_degree,
        background: case.background,
        quantity: Quantity::Color,
        active_only: false,
    };
    renderer.render(&scene, &camera, &options)?;
    let pairs = renderer
        .frame
        .status
        .read(status::INTERSECTIONS as usize, 1)?[0];
    Ok((renderer.read_image(&camera)?.rgb, pairs as usize))
}

/// A row of numbers that were compared on the host: `errors` are relative already.
pub(super) fn host_row(
    family: &str,
    case: &str,
    stage: &'static str,
    quantity: &str,
    stiffness: f64,
    errors: &[f64],
    bound: f64,
) -> Row {
    let non_finite = errors.iter().filter(|e| !e.is_finite()).count();
    let mut finite: Vec<f64> = errors.iter().copied().filter(|e| e.is_finite()).collect();
    finite.sort_by(f64::total_cmp);
    let max = finite.last().copied().unwrap_or(0.0);
    Row {
        family: family.into(),
        case: case.into(),
        stage,
        quantity: quantity.into(),
        stiffness: Some(stiffness),
        max_rel_error: max,
        median_rel_error: finite.get(finite.len() / 2).copied().unwrap_or(0.0),
        bound,
        non_finite,
        flips: 0,
        pass: non_finite == 0 && !errors.is_empty() && max <= bound,
    }
}
