//! What every stage gave, on the device and in the reference, as named arrays of numbers.

use std::collections::HashSet;

use crate::base::constants::LOG_SCALE;
use crate::lab::verify::chain::{ADAM, Case, ExposureOutputs, Outputs};
use crate::lab::verify::exposure::largest_sum;
use crate::lab::verify::sampler::{NOISE, NOISE_KEYS, seen_before};
use crate::lab::verify::{exposure, twin};
use crate::pipeline::chain::Passage;
use crate::pipeline::reference::{Camera64, Scene64, unit_quaternion};
use crate::pipeline::stage::adam::{Step, adam};
use crate::pipeline::stage::edit::edit;
use crate::pipeline::stage::importance::importance;
use crate::pipeline::stage::metrics::{squared_error, sum_counted};
use crate::pipeline::stage::noise::noise;
use crate::pipeline::stage::project::Record64;
use crate::pipeline::stage::project_grad::project_grad;
use crate::pipeline::stage::screen_grad::screen_grad;
use crate::pipeline::stage::seen::seen;
use crate::scene::Plane;

/// A named array of numbers.
pub struct Quantity {
    /// Stage it comes from.
    pub stage: &'static str,
    /// Name.
    pub name: &'static str,
    /// Numbers.
    pub values: Vec<f64>,
    /// Errors are relative to no less than this.
    pub floor: f64,
}

impl Quantity {
    fn floored(self, floor: f64) -> Self {
        Self { floor, ..self }
    }
}

fn quantity(stage: &'static str, name: &'static str, values: Vec<f64>) -> Quantity {
    Quantity {
        stage,
        name,
        values,
        floor: 0.0,
    }
}

fn flat(planes: &[Vec<f64>]) -> Vec<f64> {
    planes.iter().flatten().copied().collect()
}

/// The 3D filter, if there is one.
fn filter(values: &[f64]) -> Option<Quantity> {
    (!values.is_empty()).then(|| quantity("filter", "standard deviation", values.to_vec()))
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
    let mut all = vec![
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
        quantity("adam", "first moments", flat(&out.adam[1])),
        quantity("adam", "second moments", flat(&out.adam[2])),
        quantity("noise", "displacement", flat(&out.noise)),
        quantity("screen_grad", "norms", out.screen_grad[0].clone()),
        quantity("screen_grad", "iterations", out.screen_grad[1].clone()),
        quantity("seen", "Gaussians", out.seen.clone()),
        quantity(
            "importance",
            "cues",
            [cue_ssim.as_slice(), cue_l1, cue_views].concat(),
        ),
        quantity(
            "edit",
            "rows",
            out.edited.iter().flat_map(|p| flat(p)).collect(),
        ),
    ];
    all.extend(scored(out.squared_error, out.dissimilarity));
    all.extend(filter(&out.filter));
    all.extend(exposed(&out.exposure, 0.0));
    all
}

fn scored(squared_error: f64, dissimilarity: f64) -> [Quantity; 2] {
    [
        quantity("metrics", "squared error", vec![squared_error]),
        quantity("metrics", "1 - SSIM", vec![dissimilarity]),
    ]
}

/// The same from the reference; SSIM from the device's own map of 1 − SSIM.
fn scores_of(case: &Case, p: &Passage, map: &[f64]) -> [Quantity; 2] {
    let mask = twin::mask(case);
    let error = squared_error(&p.image, &twin::photo(case), mask.as_deref());
    let [squared, ssim] = scored(error, sum_counted(map, mask.as_deref()));
    // Of pictures that agree it is nothing but rounding.
    [squared, ssim.floored(1e-3 * map.len() as f64)]
}

/// What the exposure stage gave; `largest` is what the sums of its gradient are made of.
fn exposed(out: &ExposureOutputs, largest: f64) -> [Quantity; 6] {
    let of = |name, values: &[f64]| quantity("exposure", name, values.to_vec());
    [
        of("image", &out.image),
        of("gradient by the render", &out.dimage),
        of("gradient by the transform", &out.grads).floored(largest),
        of("transforms", &out.adam[0]),
        of("first moments", &out.adam[1]),
        of("second moments", &out.adam[2]),
    ]
}

/// The same from the reference. The optimiser, the edits and the importance start from the device's own gradients and
/// maps, so that each stage answers for itself.
#[must_use]
pub fn reference_quantities(case: &Case, p: &Passage, device: &Outputs) -> Vec<Quantity> {
    let (scene, camera, _) = twin::inputs(case);
    let pairs: usize = p.tiles.iter().map(Vec::len).sum();
    let sums = p.sums.iter().flat_map(|s| s.unwrap_or([0.0; 9])).collect();
    let steps = optimiser(case, &scene.planes, &device.grads);
    let [mut rows, mut first, mut second] = steps.clone();
    edit(&case.edits, &mut rows, [&mut first, &mut second]);
    let pixels = camera.pixels();
    let maps = [&device.error_maps[..pixels], &device.error_maps[pixels..]];
    let cues = cues_of(&scene, &camera, maps);
    let [norms, iterations] = pulls(&scene, &camera, device);
    let edited = [flat(&rows), flat(&first), flat(&second)].concat();
    let record = |part| of_reference(&p.records, part);
    let gaussians = scene.len().max(1) as f64;
    let mut all = vec![
        quantity("project", "mean", record(0..2)),
        quantity("project", "quadratic form", record(2..5)),
        quantity("project", "opacity, depth, colour", record(5..10)),
        quantity("project", "pixel bounds", record(10..14)),
        quantity("scan", "pairs counted", vec![pairs as f64]),
        quantity("bin", "pairs emitted", vec![pairs as f64]),
        quantity("sort", "tile lists", lists(&p.tiles)),
        quantity("splat", "image", p.image.clone()),
        quantity("splat", "transmittance", p.transmittance.clone()),
        quantity("loss", "L1, SSIM", vec![p.loss.l1, p.loss.ssim]),
        // Where render and photo agree it is nothing, of terms of this size: the sign of L1 over all values.
        quantity("loss", "gradient", p.loss.gradient.clone()).floored(1.0 / (3 * pixels) as f64),
        quantity(
            "loss",
            "error maps",
            [p.loss.ssim_error.clone(), p.loss.l1_error.clone()].concat(),
        ),
        quantity("splat_grad", "sums", sums),
        quantity("project_grad", "position", flat(&p.grads.planes[0..3])),
        quantity("project_grad", "log-scale", flat(&p.grads.planes[3..6])),
        // A round Gaussian, or one seen along its axis, does not change when it turns: the terms, of the size of those of the
        // scales over the quaternion's norm, cancel.
        quantity("project_grad", "rotation", flat(&p.grads.planes[6..10]))
            .floored(largest_turn(case, p) / largest_norm(&scene)),
        // A saturated opacity has no gradient; the regulariser's alone is up to λ_o/4N.
        quantity("project_grad", "opacity", flat(&p.grads.planes[10..11]))
            .floored(0.25 * case.lambdas[1] / gaussians),
        quantity("project_grad", "SH", flat(&p.grads.planes[11..])),
        quantity("adam", "parameters", flat(&steps[0])),
        quantity("adam", "first moments", flat(&steps[1])),
        quantity("adam", "second moments", flat(&steps[2])),
        quantity("noise", "displacement", displacements(&scene)),
        quantity("screen_grad", "norms", norms),
        quantity("screen_grad", "iterations", iterations),
        quantity("seen", "Gaussians", shown(case, p)),
        quantity("importance", "cues", cues),
        quantity("edit", "rows", edited),
    ];
    all.extend(scores_of(case, p, maps[0]));
    all.extend(filter(scene.filter.as_deref().unwrap_or_default()));
    all.extend(exposed(&exposure::reference(device), largest_sum(device)));
    all
}

/// 1 for each Gaussian that the view shows, or that counts as seen before.
fn shown(case: &Case, p: &Passage) -> Vec<f64> {
    let (_, camera, _) = twin::inputs(case);
    let now = seen(&p.records, &p.tiles, &camera, case.alpha_min);
    let before = seen_before(now.len());
    let either = |(now, before)| f64::from(u32::from(now) | before);
    now.into_iter().zip(before).map(either).collect()
}

/// How large the terms of a rotation's gradient are at most: those that the longest axis of a Gaussian would have across the
/// line of sight. The gradient by the log-scale of axis k without the regulariser, 2 s_k² times the covariance's along that
/// axis, times (s_max/s_k)².
fn largest_turn(case: &Case, p: &Passage) -> f64 {
    let (scene, camera, options) = twin::inputs(case);
    let pulls = project_grad(&scene, &camera, &options, &p.sums, [0.0; 2]);
    let of = |i: usize| -> f64 {
        let axes = scene
            .gather::<3>(Plane::LOG_SCALE, i)
            .map(|l| l.clamp(LOG_SCALE[0], LOG_SCALE[1]));
        let longest = axes.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let pulls = pulls.gather::<3>(Plane::LOG_SCALE, i);
        let term = |k: usize| pulls[k].abs() * (2.0 * (longest - axes[k])).exp();
        (0..3)
            .map(term)
            .filter(|t| t.is_finite())
            .fold(0.0, f64::max)
    };
    (0..scene.len()).map(of).fold(0.0, f64::max)
}

/// The largest norm of a quaternion; 1 if there is none.
fn largest_norm(scene: &Scene64) -> f64 {
    let norm = |i: usize| unit_quaternion(scene.gather(Plane::ROTATION, i)).1;
    let norms = (0..scene.len()).map(norm).filter(|n| n.is_finite());
    match norms.fold(0.0, f64::max) {
        0.0 => 1.0,
        norm => norm,
    }
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
