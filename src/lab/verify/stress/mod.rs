//! The stress suite: the same stages, compared with the reference on stiff numbers.
//!
//! A family is a series of cases along one measure of stiffness, so that the error is a curve. Every case is a row of the
//! table; a family has one bound on the f32 errors, with its reason. Kernels in f64 are within [`super::check::EXACT`] everywhere.
//!
//! | file | what |
//! |---|---|
//! | `families.rs` | families of scenes through all stages |
//! | `updates.rs` | the optimiser under extreme gradients |

mod families;
mod updates;

use crate::base::error::Result;
use crate::device::tuning::{Tuning, status};
use crate::device::{Defines, Device};
use crate::lab::verify::cases::Case;
use crate::lab::verify::check::{EXACT, Row, Verification};
use crate::lab::verify::verify_case;
use crate::pipeline::buffers::GaussianBuffers;
use crate::pipeline::forward::{RenderOptions, Renderer};
use crate::scene::Plane;

pub use families::{FAMILIES, Family};

/// Runs the stress suite on one device.
pub fn stress(device: &Device) -> Result<Verification> {
    let mut rows = Vec::new();
    for family in FAMILIES {
        rows.extend(verify_family(device, &family)?);
    }
    rows.extend(beside_scenes(device)?);
    let notes = FAMILIES.iter().map(Family::note);
    Ok(Verification {
        families: notes.chain([updates::NOTE]).collect(),
        ..Verification::new(device, "stress", rows)
    })
}

/// Rows without a scene: the count of pairs and the optimiser.
///
/// # Errors
/// Those of [`stress`].
pub fn beside_scenes(device: &Device) -> Result<Vec<Row>> {
    let mut rows = vec![more_pairs_than_24_bits(device)?];
    rows.extend(updates::rows::<f32>(device, "f32", updates::NOTE.bound)?);
    if device.info().fp64 {
        rows.extend(updates::rows::<f64>(device, "f64", EXACT)?);
    }
    Ok(rows)
}

/// Rows of every case of a family.
///
/// # Errors
/// Those of [`stress`].
pub fn verify_family(device: &Device, family: &Family) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for (index, stiffness) in family.stiffness.iter().enumerate() {
        let case = Case {
            family: family.name,
            bound: family.bound,
            ..(family.case)(index, *stiffness)
        };
        let of_case = verify_case(device, &case)?;
        rows.extend(of_case.into_iter().map(|row| Row {
            stiffness: Some(*stiffness),
            ..row
        }));
    }
    Ok(rows)
}

/// Row of an image of 18 million pairs whose first layers hide the rest: it must be the image of those layers alone.
fn more_pairs_than_24_bits(device: &Device) -> Result<Row> {
    /// Opaque Gaussians one behind the other, each over the whole image.
    const LAYERS: usize = 1100;
    /// Edge of the image, pixels: 16,384 tiles of the smallest size.
    const SIDE: u32 = 2048;
    let tuning = Tuning {
        tile: Tuning::GPU.tile,
        ..device.tuning()
    };
    let render = |n: usize| -> Result<(Vec<f32>, u32)> {
        let case = families::each("", n, [SIDE; 2], 78, |s, i| {
            s.scatter(Plane::POSITION, i, [0.0, 0.0, 1e-3 * i as f32]);
            s.scatter(Plane::LOG_SCALE, i, [5.0; 3]);
            s.scatter(Plane::OPACITY, i, [5.0]);
        });
        let defines = Defines::new(tuning);
        let mut renderer = Renderer::<f32>::new(device, defines, case.sh_degree, true)?;
        let scene = GaussianBuffers::upload(device, &case.splats, 0)?;
        let options = RenderOptions {
            sh_degree: case.sh_degree,
            background: case.background,
            ..RenderOptions::default()
        };
        let image = renderer.image(&scene, &case.camera, &options)?.rgb;
        let pairs = renderer
            .frame
            .status
            .read(status::INTERSECTIONS as usize, 1)?[0];
        Ok((image, pairs))
    };
    let ((all, pairs), (first, _)) = (render(LAYERS)?, render(30)?);
    let wanted = ((SIDE / tuning.tile) as usize).pow(2) * LAYERS;
    let largest = first.iter().fold(0.0f32, |l, v| l.max(v.abs()));
    let apart = |(a, b): (&f32, &f32)| f64::from((a - b).abs() / largest);
    let mut errors: Vec<f64> = all.iter().zip(&first).map(apart).collect();
    errors.push((pairs as usize).abs_diff(wanted) as f64);
    let names = ["more than 2^24 pairs", "image, pairs (f32)"];
    let of = ["crowds and ties", "splat"];
    Ok(Row::of_errors(of, names, wanted as f64, &errors, 0.0))
}
