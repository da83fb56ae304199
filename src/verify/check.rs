//! Stage by stage, quantity by quantity: device against reference.

use std::collections::HashSet;

use serde::Serialize;

use super::chain::{ADAM, Case, Outputs};
use super::sampler::{NOISE, NOISE_KEYS};
use super::twin;
use crate::model::Plane;
use crate::reference::adam::{Step, adam};
use crate::reference::chain::Passage;
use crate::reference::compare::{Report, Tolerance, compare, measure};
use crate::reference::edit::edit;
use crate::reference::importance::importance;
use crate::reference::metrics::squared_error;
use crate::reference::noise::noise;
use crate::reference::project::Record64;
use crate::reference::screen_grad::screen_grad;
use crate::reference::{Camera64, Scene64};

/// f64 kernels against the f64 reference: rounding of f64 through the longest stage, with room for its condition.
pub const EXACT: f64 = 1e-10;
/// f32 kernels against the reference on well-conditioned scenes.
pub const SINGLE: f64 = 1e-5;
/// f32 kernels on needles 1000 times longer than thick.
pub const SINGLE_NEEDLES: f64 = 1e-4;
/// Share of elements that may fall on the other side of a discontinuity in f32 (the alpha cut, tile edges, a sign).
pub const FLIP_SHARE: f64 = 0.01;

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Family of cases.
    pub family: String,
    /// Case.
    pub case: String,
    /// Stage.
    pub stage: &'static str,
    /// What is compared, and in which precision.
    pub quantity: String,
    /// Largest error (flips left out) over the largest wanted value.
    pub max_rel_error: f64,
    /// Median error, likewise.
    pub median_rel_error: f64,
    /// Bound on the largest error.
    pub bound: f64,
    /// Values that are not finite.
    pub non_finite: usize,
    /// Elements beyond the bound that a discontinuity excuses.
    pub flips: usize,
    /// Whether every bound was kept.
    pub pass: bool,
}

/// A named array of numbers.
pub struct Quantity {
    /// Stage it comes from.
    pub stage: &'static str,
    /// Name.
    pub name: &'static str,
    /// Numbers.
    pub values: Vec<f64>,
}

fn quantity(stage: &'static str, name: &'static str, values: Vec<f64>) -> Quantity {
    Quantity {
        stage,
        name,
        values,
    }
}

fn flat(planes: &[Vec<f64>]) -> Vec<f64> {
    planes.iter().flatten().copied().collect()
}

/// Fixed-size description of a record; zeros when culled.
fn record_values(r: Option<[f64; 14]>) -> [f64; 14] {
    r.unwrap_or([0.0; 14])
}

fn of_device(out: &Outputs, part: std::ops::Range<usize>) -> Vec<f64> {
    let bounds = |b: u32| [f64::from(b & 0xffff), f64::from(b >> 16)];
    out.records
        .iter()
        .flat_map(|r| {
            let values = r.as_ref().map(|r| {
                let [x0, x1] = bounds(r.bx);
                let [y0, y1] = bounds(r.by);
                let [red, green, blue] = r.rgb;
                [
                    r.x, r.y, r.a, r.r, r.c, r.lo, r.depth, red, green, blue, x0, x1, y0, y1,
                ]
            });
            record_values(values)[part.clone()].to_vec()
        })
        .collect()
}

fn of_reference(records: &[Option<Record64>], part: std::ops::Range<usize>) -> Vec<f64> {
    records
        .iter()
        .flat_map(|r| {
            let values = r.as_ref().map(|r| {
                let [[x0, x1], [y0, y1]] = r.bounds.map(|b| b.map(f64::from));
                let [red, green, blue] = r.rgb;
                let [x, y] = r.mean;
                [
                    x, y, r.a, r.r, r.c, r.lo, r.depth, red, green, blue, x0, x1, y0, y1,
                ]
            });
            record_values(values)[part.clone()].to_vec()
        })
        .collect()
}

/// Lists of all tiles one after the other, closed by −1 each.
fn lists(tiles: &[Vec<u32>]) -> Vec<f64> {
    tiles
        .iter()
        .flat_map(|t| t.iter().map(|g| f64::from(*g)).chain(std::iter::once(-1.0)))
        .collect()
}

/// What the device gave.
#[must_use]
pub fn device_quantities(out: &Outputs) -> Vec<Quantity> {
    let [cue_ssim, cue_l1, cue_views] = &out.cues;
    let pairs: usize = out.tiles.iter().map(Vec::len).sum();
    vec![
        quantity("project", "mean", of_device(out, 0..2)),
        quantity("project", "quadratic form", of_device(out, 2..5)),
        quantity("project", "opacity, depth, colour", of_device(out, 5..10)),
        quantity("project", "pixel bounds", of_device(out, 10..14)),
        quantity("scan", "pairs counted", vec![out.counted as f64]),
        quantity("bin", "pairs emitted", vec![pairs as f64]),
        quantity("sort", "tile lists", lists(&out.tiles)),
        quantity("splat", "image", out.image.clone()),
        quantity("splat", "transmittance", out.transmittance.clone()),
        quantity("loss", "L1, SSIM", out.loss.to_vec()),
        quantity("loss", "gradient", out.dimage.clone()),
        quantity("loss", "error maps", out.error_maps.clone()),
        quantity(
            "splat_grad",
            "sums",
            out.sums.iter().flatten().copied().collect(),
        ),
        quantity("project_grad", "position", flat(&out.grads[0..3])),
        quantity("project_grad", "log-scale", flat(&out.grads[3..6])),
        quantity("project_grad", "rotation", flat(&out.grads[6..10])),
        quantity("project_grad", "opacity", flat(&out.grads[10..11])),
        quantity("project_grad", "SH", flat(&out.grads[11..])),
        quantity("adam", "parameters", flat(&out.adam[0])),
        quantity(
            "adam",
            "moments",
            [flat(&out.adam[1]), flat(&out.adam[2])].concat(),
        ),
        quantity("noise", "displacement", flat(&out.noise)),
        quantity("screen_grad", "norms", out.screen_grad[0].clone()),
        quantity("screen_grad", "iterations", out.screen_grad[1].clone()),
        quantity(
            "importance",
            "cues",
            [cue_ssim.as_slice(), cue_l1, cue_views].concat(),
        ),
        quantity("metrics", "squared error", vec![out.squared_error]),
        quantity(
            "edit",
            "rows",
            out.edited.iter().flat_map(|p| flat(p)).collect(),
        ),
    ]
}

/// The same from the reference. The optimiser, the edits and the importance start from the device's own gradients and
/// maps, so that each stage answers for itself.
#[must_use]
pub fn reference_quantities(case: &Case, p: &Passage, device: &Outputs) -> Vec<Quantity> {
    let (scene, camera, _) = twin::inputs(case);
    let photo = twin::photo(case);
    let pairs: usize = p.tiles.iter().map(Vec::len).sum();
    let sums = p.sums.iter().flat_map(|s| s.unwrap_or([0.0; 9])).collect();
    let [params, m, v] = optimiser(case, &scene.planes, &device.grads);
    let (mut rows, mut first, mut second) = (params.clone(), m.clone(), v.clone());
    edit(&case.edits, &mut rows, [&mut first, &mut second]);
    let pixels = camera.pixels();
    let maps = [&device.error_maps[..pixels], &device.error_maps[pixels..]];
    let cues = cues_of(&scene, &camera, maps);
    let [norms, iterations] = pulls(&scene, &camera, device);
    let g = &p.grads.planes;
    vec![
        quantity("project", "mean", of_reference(&p.records, 0..2)),
        quantity("project", "quadratic form", of_reference(&p.records, 2..5)),
        quantity(
            "project",
            "opacity, depth, colour",
            of_reference(&p.records, 5..10),
        ),
        quantity("project", "pixel bounds", of_reference(&p.records, 10..14)),
        quantity("scan", "pairs counted", vec![pairs as f64]),
        quantity("bin", "pairs emitted", vec![pairs as f64]),
        quantity("sort", "tile lists", lists(&p.tiles)),
        quantity("splat", "image", p.image.clone()),
        quantity("splat", "transmittance", p.transmittance.clone()),
        quantity("loss", "L1, SSIM", vec![p.loss.l1, p.loss.ssim]),
        quantity("loss", "gradient", p.loss.gradient.clone()),
        quantity(
            "loss",
            "error maps",
            [p.loss.ssim_error.clone(), p.loss.l1_error.clone()].concat(),
        ),
        quantity("splat_grad", "sums", sums),
        quantity("project_grad", "position", flat(&g[0..3])),
        quantity("project_grad", "log-scale", flat(&g[3..6])),
        quantity("project_grad", "rotation", flat(&g[6..10])),
        quantity("project_grad", "opacity", flat(&g[10..11])),
        quantity("project_grad", "SH", flat(&g[11..])),
        quantity("adam", "parameters", flat(&params)),
        quantity("adam", "moments", [flat(&m), flat(&v)].concat()),
        quantity("noise", "displacement", displacements(&scene)),
        quantity("screen_grad", "norms", norms),
        quantity("screen_grad", "iterations", iterations),
        quantity("importance", "cues", cues),
        quantity(
            "metrics",
            "squared error",
            vec![squared_error(&p.image, &photo)],
        ),
        quantity(
            "edit",
            "rows",
            [flat(&rows), flat(&first), flat(&second)].concat(),
        ),
    ]
}

/// Displacement of every Gaussian by the noise: all x, all y, all z.
fn displacements(scene: &Scene64) -> Vec<f64> {
    let [seed, stream] = NOISE_KEYS;
    let moves: Vec<[f64; 3]> = (0..scene.len())
        .map(|i| noise(scene, i, &NOISE, seed, stream))
        .collect();
    (0..3)
        .flat_map(|k| moves.iter().map(move |m| m[k]))
        .collect()
}

/// Sums of the screen gradient's norm and number of iterations, after the same one twice, from the device's own sums.
fn pulls(scene: &Scene64, camera: &Camera64, device: &Outputs) -> [Vec<f64>; 2] {
    let seen: HashSet<u32> = device.tiles.iter().flatten().copied().collect();
    let norm = |i: usize| {
        let norm = screen_grad(scene, i, camera, &device.sums[i]);
        norm.filter(|_| seen.contains(&(i as u32)))
    };
    let norms: Vec<Option<f64>> = (0..scene.len()).map(norm).collect();
    let twice = |value: fn(&Option<f64>) -> f64| norms.iter().map(|n| 2.0 * value(n)).collect();
    [
        twice(|n| n.unwrap_or(0.0)),
        twice(|n| f64::from(u8::from(n.is_some()))),
    ]
}

/// Sums of both cues and number of views of every Gaussian, after the same view twice.
fn cues_of(scene: &Scene64, camera: &Camera64, maps: [&[f64]; 2]) -> Vec<f64> {
    let cues: Vec<Option<[f64; 2]>> = (0..scene.len())
        .map(|i| importance(scene, i, camera, maps))
        .collect();
    let cue = |k: usize| cues.iter().map(move |c| 2.0 * c.map_or(0.0, |c| c[k]));
    let views = cues.iter().map(|c| if c.is_some() { 2.0 } else { 0.0 });
    cue(0).chain(cue(1)).chain(views).collect()
}

/// Two steps of the reference's optimiser with the same gradients: parameters and moments.
fn optimiser(case: &Case, planes: &[Vec<f64>], grads: &[Vec<f64>]) -> [Vec<Vec<f64>>; 3] {
    let r = &case.rates;
    let mut params = planes.to_vec();
    let zeros = vec![vec![0.0; planes[0].len()]; planes.len()];
    let (mut m, mut v) = (zeros.clone(), zeros);
    for p in 0..Plane::count(case.sh_degree) {
        let rate = match p {
            _ if p < Plane::LOG_SCALE => r.position,
            _ if p < Plane::ROTATION => r.scale,
            _ if p < Plane::OPACITY => r.rotation,
            _ if p < Plane::SH => r.opacity,
            _ if p < Plane::SH + 3 => r.sh0,
            _ => r.sh,
        };
        for t in 1..=2 {
            let step = Step {
                rate,
                constants: ADAM,
                t,
            };
            adam(&grads[p], &step, &mut params[p], &mut m[p], &mut v[p]);
        }
    }
    [params, m, v]
}

/// Whether decisions at a discontinuity (the alpha cut, the last layer of a pixel, a tile's edge, the sign in L1) reach a
/// quantity, so that in f32 a few of its elements may differ by more than rounding.
fn has_flips(stage: &str, name: &str) -> bool {
    match stage {
        "project" => name == "pixel bounds",
        "scan" | "bin" | "sort" | "splat" | "splat_grad" | "project_grad" => true,
        "loss" => name != "L1, SSIM",
        _ => false,
    }
}

/// Tile lists as [`lists`] writes them: pairs that one side alone has, and places at which the common ones are in another
/// order.
fn list_flips(got: &[f64], want: &[f64]) -> usize {
    let tiles = |v: &[f64]| -> Vec<Vec<i64>> {
        v.split(|g| *g < 0.0)
            .map(|t| t.iter().map(|g| *g as i64).collect())
            .collect()
    };
    let (a, b) = (tiles(got), tiles(want));
    let in_tile = |(a, b): (&Vec<i64>, &Vec<i64>)| {
        let common = |x: &[i64], y: &[i64]| -> Vec<i64> {
            let y: HashSet<i64> = y.iter().copied().collect();
            x.iter().copied().filter(|g| y.contains(g)).collect()
        };
        let (left, right) = (common(a, b), common(b, a));
        let moved = left.iter().zip(&right).filter(|(x, y)| x != y).count();
        a.len() - left.len() + b.len() - right.len() + moved + left.len().abs_diff(right.len())
    };
    a.iter().zip(&b).map(in_tile).sum::<usize>() + a.len().abs_diff(b.len())
}

/// Compares every quantity of one run with the reference. `bound` applies to each; in f32 a share of the elements behind a
/// discontinuity may be flips, in f64 none.
#[must_use]
pub fn check(
    family: &str,
    case: &Case,
    got: &[Quantity],
    want: &[Quantity],
    precision: &str,
    bound: f64,
) -> Vec<Row> {
    got.iter()
        .zip(want)
        .map(|(g, w)| {
            let flips = if bound > EXACT && has_flips(g.stage, g.name) {
                (FLIP_SHARE * w.values.len() as f64) as usize
            } else {
                0
            };
            let (pass, report) = if g.name == "tile lists" {
                let report = Report {
                    flips: list_flips(&g.values, &w.values),
                    ..Report::default()
                };
                (report.flips <= flips, report)
            } else {
                let strict = Tolerance::all(bound);
                let tolerance = if flips > 0 {
                    strict.with_flips(flips, 0.05_f64.max(bound))
                } else {
                    strict
                };
                let verdict = compare(&g.values, &w.values, tolerance);
                (verdict.is_ok(), measure(&g.values, &w.values, bound))
            };
            Row {
                family: family.into(),
                case: case.name.clone(),
                stage: g.stage,
                quantity: format!("{} ({precision})", g.name),
                max_rel_error: report.max,
                median_rel_error: report.median,
                bound,
                non_finite: report.non_finite,
                flips: report.flips,
                pass,
            }
        })
        .collect()
}
