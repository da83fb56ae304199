//! The stress suite: families of scenes, the optimiser, world frames, density control.

use crate::base::constants::TILE;
use crate::base::error::Result;
use crate::device::tuning::status;
use crate::device::{CameraArg, Defines, Device};
use crate::lab::verify::cases::Case;
use crate::lab::verify::check::Row;
use crate::lab::verify::stress::family::{Family, Stiff, host_row};
use crate::lab::verify::stress::{frames, sampling, scenes, updates};
use crate::lab::verify::suite::verify_case;
use crate::lab::verify::verification::{FamilyNote, Verification};
use crate::pipeline::buffers::GaussianBuffers;
use crate::pipeline::forward::{Quantity, RenderOptions, Renderer};

/// Runs the stress suite on one device.
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

/// Rows and families without a scene: the count of pairs, the optimiser, world frames, density control.
///
/// # Errors
/// Those of [`stress`].
pub fn beside_scenes(device: &Device) -> Result<(Vec<Row>, Vec<FamilyNote>)> {
    let mut rows = vec![more_pairs_than_24_bits(device)?];
    rows.extend(updates::all(device)?);
    rows.extend(frames::rows());
    rows.extend(sampling::rows()?);
    Ok((rows, vec![updates::NOTE, frames::NOTE, sampling::NOTE]))
}

/// Rows of every case of a family.
///
/// # Errors
/// Those of [`stress`].
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

/// Row of an image of 18 million pairs whose first layers hide the rest: it must be the image of those layers alone.
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
    let tiles = (scenes::MANY_SIDE as usize / TILE as usize).pow(2);
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
    let camera = CameraArg::<f32>::new(&case.camera);
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
