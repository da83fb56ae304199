//! Sums of each pair → gradients of the raw parameters, and a step of the optimiser with them (`kernels/project_grad.cl`).

use std::ops::Range;

use crate::base::constants::{LOG_SCALE, blur};
use crate::base::error::Result;
use crate::base::math::sigmoid;
use crate::device::{Array, Program, Real};
use crate::pipeline::buffers::{GaussianBuffers, GradientBlock, ViewBuffers};
use crate::pipeline::launch::Arguments;
use crate::pipeline::reference::{Camera64, Options, Scene64, product, transpose, unit_quaternion};
use crate::pipeline::stage::adam::{LearningRates, Step};
use crate::pipeline::stage::project::{Area64, Shape64, color, cross, shape};
use crate::pipeline::stage::screen_grad::mean_gradient;
use crate::scene::{Plane, sh, sh_coefficients};

/// Adds the sums of large Gaussians before row `end` in the group style, in place; there is nothing to do where it has been done, or in the
/// other style.
fn add_large<R: Real>(stage: &Program, view: &ViewBuffers<R>, end: usize) -> Result<()> {
    if !stage.defines().tuning.group_style {
        return Ok(());
    }
    stage
        .launch("large_sums")
        .uints([end])
        .arrays([&view.isect_start, &view.isect_counts], end)
        .status(view)
        .array(&view.sums, 1)
        .over_shared(end)
}

/// Writes the gradients of a block of Gaussians, those of λ_o·mean(opacity) + λ_s·mean(scale) included, or adds them to those of the
/// block's views where it has some. After an overflow in the view nothing changes. The kernel is built for one SH degree.
pub fn backward<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    view: &ViewBuffers<R>,
    lambdas: [f64; 2],
    grads: &GradientBlock<'_, R>,
) -> Result<()> {
    let rows = grads.rows.clone();
    add_large(stage, view, rows.end.min(scene.count))?;
    let planes = Plane::count(stage.defines().sh_degree);
    stage
        .launch("project_grad")
        .gaussians(scene, rows.end)
        .uints([grads.first, grads.stride, usize::from(grads.views > 0)])
        .value(view.camera)
        .arrays([&view.isect_start, &view.isect_counts], scene.count)
        .status(view)
        .array(&view.sums, 1)
        .reals::<R>(regularisers(scene, lambdas))
        .array(grads.values, planes * grads.stride)
        .over_rows(rows.start - grads.first..rows.end - grads.first)
}

/// Takes a step of the optimiser with the gradients of some Gaussians, the first of which begins a run, and none of which is written; after an
/// overflow in the view nothing changes. The kernel is built for one SH degree, with `take_step`.
pub fn update<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    (view, rows): (&ViewBuffers<R>, Range<usize>),
    lambdas: [f64; 2],
    moments: [&Array<R>; 2],
    step: &Step<LearningRates>,
) -> Result<()> {
    add_large(stage, view, rows.end.min(scene.count))?;
    let planes = Plane::count(stage.defines().sh_degree);
    stage
        .launch("project_step")
        .gaussians(scene, rows.end)
        .value(view.camera)
        .arrays([&view.isect_start, &view.isect_counts], scene.count)
        .array(&view.sums, 1)
        .reals::<R>(regularisers(scene, lambdas))
        .reals::<R>(step.numbers::<R>())
        .arrays(moments, planes * scene.stride)
        .status(view)
        .over_runs(rows)
}

/// λ_o / N and λ_s / 3N.
fn regularisers<R: Real>(scene: &GaussianBuffers<R>, [opacity, scale]: [f64; 2]) -> [f64; 2] {
    let n = scene.all().max(1) as f64;
    [opacity / n, scale / (3.0 * n)]
}

// Definition in f64.

/// Gradients of all raw parameters from the nine sums of each Gaussian, regularisers λ_o·mean(o) + λ_s·mean(scale)
/// included. `sums[i]` is `None` for a culled Gaussian.
#[must_use]
pub fn project_grad(
    scene: &Scene64,
    camera: &Camera64,
    options: &Options,
    sums: &[Option<[f64; 9]>],
    lambdas: [f64; 2],
) -> Scene64 {
    let n = scene.len() as f64;
    let mut out = scene.zeros_like();
    for (i, s) in sums.iter().enumerate() {
        if let (Some(s), Some(o)) = (s, shape(scene, i, camera)) {
            geometry(scene, i, camera, &o, s, &mut out);
            colors(scene, i, camera, options, [s[6], s[7], s[8]], &mut out);
            out.planes[Plane::OPACITY][i] = s[0] * sigmoid(-scene.planes[Plane::OPACITY][i]);
        }
        let logit = scene.planes[Plane::OPACITY][i];
        out.planes[Plane::OPACITY][i] += lambdas[0] / n * sigmoid(logit) * sigmoid(-logit);
        for p in Plane::LOG_SCALE..Plane::ROTATION {
            let l = scene.planes[p][i];
            let free = l > LOG_SCALE[0] && l < LOG_SCALE[1];
            let d = &mut out.planes[p][i];
            *d = if free {
                *d + lambdas[1] / (3.0 * n) * l.exp()
            } else {
                0.0
            };
        }
    }
    out
}

fn geometry(
    scene: &Scene64,
    i: usize,
    camera: &Camera64,
    o: &Shape64,
    s: &[f64; 9],
    out: &mut Scene64,
) {
    // Inverse covariance K; the moments back in (dx, dy): dx = u + r dy.
    let k = [
        [o.cov[1][1] / o.det, -o.cov[0][1] / o.det],
        [-o.cov[0][1] / o.det, o.cov[0][0] / o.det],
    ];
    let r = o.cov[0][1] / o.cov[1][1];
    let xy = s[4] + r * s[5];
    let q = [[s[3] + r * s[4] + r * xy, xy], [xy, s[5]]];
    let dmean = mean_gradient(o, s);
    let mut dcov = product(&product(&k, &q), &k).map(|row| row.map(|v| 0.5 * v));
    // log √(det0/det) = ½ (log det0 − log det), det = det0 + b tr + b²: the trace's part here, det0's in area().
    if o.area.is_some() {
        let thin = 0.5 * s[0] * blur(true) / o.det;
        dcov[0][0] -= thin;
        dcov[1][1] -= thin;
    }
    // cov = T Sigma T^t + b I with T = J W.
    let dsigma = product(&product(&transpose(&o.jw), &dcov), &o.jw);
    let mut djw = product(&product(&dcov, &o.jw), &o.sigma).map(|row| row.map(|v| 2.0 * v));
    // Sigma = N N^t with N = R S.
    let nn: [[f64; 3]; 3] = std::array::from_fn(|a| std::array::from_fn(|b| o.rot[a][b] * o.s[b]));
    let dn = product(&dsigma, &nn).map(|row| row.map(|v| 2.0 * v));
    let mut drot: [[f64; 3]; 3] =
        std::array::from_fn(|a| std::array::from_fn(|b| dn[a][b] * o.s[b]));
    let mut dlog: [f64; 3] =
        std::array::from_fn(|b| o.s[b] * (0..3).map(|a| dn[a][b] * o.rot[a][b]).sum::<f64>());
    if let Some(area) = &o.area {
        let weight = s[0] * (o.det - area.det0) / o.det;
        area_grad(o, area, weight, &mut dlog, &mut drot, &mut djw);
    }
    for (b, d) in dlog.iter().enumerate() {
        // log s′ = ½ log(s² + σ²), and the opacity is multiplied by s/s′.
        out.planes[Plane::LOG_SCALE + b][i] = if o.area.is_some() {
            d * o.kept[b] + s[0] * (1.0 - o.kept[b])
        } else {
            *d
        };
    }
    let dq = quaternion(scene.gather(Plane::ROTATION, i), &drot);
    for (b, d) in dq.iter().enumerate() {
        out.planes[Plane::ROTATION + b][i] = *d;
    }
    let dt = camera_position(camera, o, &djw, dmean);
    for b in 0..3 {
        out.planes[Plane::POSITION + b][i] = (0..3).map(|a| camera.w[a][b] * dt[a]).sum();
    }
}

/// Adds `weight` times the derivative of ½ log det0, det0 = Σ_j (cofactor_j)·(r_j·t)².
fn area_grad(
    o: &Shape64,
    area: &Area64,
    weight: f64,
    dlog: &mut [f64; 3],
    drot: &mut [[f64; 3]; 3],
    djw: &mut [[f64; 3]; 2],
) {
    let by_along: [f64; 3] =
        std::array::from_fn(|j| weight * area.cofactors[j] * area.along[j] / area.det0);
    let share: [f64; 3] = std::array::from_fn(|j| by_along[j] * area.along[j]);
    let mut by_cross = [0.0; 3];
    for j in 0..3 {
        dlog[j] += share[(j + 1) % 3] + share[(j + 2) % 3];
        for a in 0..3 {
            drot[a][j] += by_along[j] * area.cross[a];
            by_cross[a] += by_along[j] * o.rot[a][j];
        }
    }
    let [first, second] = [cross(o.jw[1], by_cross), cross(by_cross, o.jw[0])];
    for a in 0..3 {
        djw[0][a] += first[a];
        djw[1][a] += second[a];
    }
}

/// dL/dt: through J = [[fx/z, 0, −fx·u/z], [0, fy/z, −fy·v/z]] and the mean to the camera position.
fn camera_position(
    camera: &Camera64,
    o: &Shape64,
    djw: &[[f64; 3]; 2],
    dmean: [f64; 2],
) -> [f64; 3] {
    let dj = product(djw, &transpose(&camera.w));
    let z = o.t[2];
    let mut dt = [0.0; 3];
    for k in 0..2 {
        let f = camera.focal[k];
        let (ratio, free) = o.ratio[k];
        dt[2] += -dj[k][k] * f / (z * z) + dj[k][2] * f * ratio / (z * z);
        let mut dratio = dmean[k] * f;
        if free {
            dratio -= dj[k][2] * f / z;
        }
        dt[k] += dratio / z;
        dt[2] -= dratio * o.t[k] / (z * z);
    }
    dt
}

/// dL/dq of the raw quaternion from dL/dR: derivative of each entry of the rotation matrix, then of the normalisation.
fn quaternion(raw: [f64; 4], drot: &[[f64; 3]; 3]) -> [f64; 4] {
    let ([w, x, y, z], norm) = unit_quaternion(raw);
    if norm == 0.0 {
        return [0.0; 4];
    }
    let derivatives: [[[f64; 3]; 3]; 4] = [
        [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]],
        [[0.0, y, z], [y, -2.0 * x, -w], [z, w, -2.0 * x]],
        [[-2.0 * y, x, w], [x, 0.0, z], [-w, z, -2.0 * y]],
        [[-2.0 * z, -w, x], [w, -2.0 * z, y], [x, y, 0.0]],
    ];
    let d: [f64; 4] = std::array::from_fn(|k| {
        (0..9)
            .map(|e| 2.0 * drot[e / 3][e % 3] * derivatives[k][e / 3][e % 3])
            .sum()
    });
    let unit = [w, x, y, z];
    let along: f64 = (0..4).map(|k| d[k] * unit[k]).sum();
    std::array::from_fn(|k| (d[k] - along * unit[k]) / norm)
}

fn colors(
    scene: &Scene64,
    i: usize,
    camera: &Camera64,
    options: &Options,
    d: [f64; 3],
    out: &mut Scene64,
) {
    let (rgb, dir, length) = color(scene, i, camera, options.sh_degree);
    let (basis, slopes) = (sh::basis(dir), sh::gradient(dir));
    let mut ddir = [0.0; 3];
    for c in 0..3 {
        if rgb[c] <= 0.0 {
            continue;
        }
        for k in 0..sh_coefficients(options.sh_degree) {
            let p = Plane::SH + 3 * k + c;
            out.planes[p][i] = d[c] * basis[k];
            for a in 0..3 {
                ddir[a] += d[c] * scene.planes[p][i] * slopes[k][a];
            }
        }
    }
    if length > 0.0 {
        let along: f64 = (0..3).map(|a| ddir[a] * dir[a]).sum();
        for a in 0..3 {
            out.planes[Plane::POSITION + a][i] += (ddir[a] - along * dir[a]) / length;
        }
    }
}
