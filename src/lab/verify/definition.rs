//! [`Reference`]: the definitions in f64, applied to a case.

use std::collections::HashSet;

use crate::base::constants::{FLIP_PIXELS_PER_DEGREE, LOG_SCALE, NEAR, SUMS};
use crate::capture::Alpha;
use crate::density::NoiseLaw;
use crate::lab::verify::cases::{ADAM, Case};
use crate::pipeline::reference::{Camera64, Options, Scene64, unit_quaternion};
use crate::pipeline::reference_pass::{ReferencePass, run};
use crate::pipeline::stage::adam::{Step, adam};
use crate::pipeline::stage::bin::bin;
use crate::pipeline::stage::edit::edit;
use crate::pipeline::stage::exposure::{ENTRIES, IDENTITY, backward, center};
use crate::pipeline::stage::flip::error_map;
use crate::pipeline::stage::importance::importance;
use crate::pipeline::stage::morton::{Order, kept};
use crate::pipeline::stage::noise::noise;
use crate::pipeline::stage::project_grad::project_grad;
use crate::pipeline::stage::screen_grad::screen_grad;
use crate::pipeline::stage::seen::seen;
use crate::scene::{Gaussians, Plane, filters};

/// Noise of every case: gentle enough a gate that all Gaussians take part, and as long as the scene is large.
pub const NOISE: NoiseLaw = NoiseLaw {
    rate: 100.0,
    steepness: 4.0,
    opacity: 0.5,
};
/// Seed and stream of the noise: high words that are not zero, so that none may be dropped.
pub const NOISE_KEYS: [u64; 2] = [0x0123_4567_89ab_cdef, (13 << 32) | 777];

/// Exposure transforms of the views in every case, the second being that of the case's: a brightening with some mixing of
/// channels. Exact in f32.
pub const EXPOSURES: [[f64; ENTRIES]; 3] = [
    IDENTITY,
    [
        1.25, 0.0625, -0.03125, 0.015625, -0.125, 0.875, 0.25, -0.0625, 0.03125, 0.5, 0.75, 0.125,
    ],
    IDENTITY,
];
/// The case's view.
pub const VIEW: usize = 1;
/// Learning rate of both steps of the transforms.
pub const EXPOSURE_RATE: f64 = 0.01;

/// Photo of a case over its background, planar \[3, height, width\].
#[must_use]
pub fn photo(case: &Case) -> Vec<f64> {
    let p = &case.photo;
    let n = (p.width * p.height) as usize;
    let value = |c: usize, i: usize| f64::from(p.data[c * n + i]) / 255.0;
    (0..3 * n)
        .map(|at| {
            let (c, i) = (at / n, at % n);
            let gap = if p.alpha == Alpha::Transparency {
                1.0 - value(3, i)
            } else {
                0.0
            };
            value(c, i) + gap * f64::from(case.background[c])
        })
        .collect()
}

/// Scene, camera and options of a case.
#[must_use]
pub fn inputs(case: &Case) -> (Scene64, Camera64, Options) {
    let options = Options {
        alpha_min: case.alpha_min,
        sh_degree: case.sh_degree,
        background: case.background.map(f64::from),
    };
    let mut scene = Scene64::new(&case.splats);
    if !case.filter_views.is_empty() {
        let positions = (0..scene.len()).map(|i| scene.position(i));
        scene.filter = Some(filters(positions, &case.filter_views));
    }
    (scene, Camera64::new(&case.camera, NEAR), options)
}

/// Flags of so many Gaussians that count as seen before: every third.
pub fn seen_before(count: usize) -> impl Iterator<Item = u32> {
    (0..count).map(|i| u32::from(i % 3 == 2))
}

/// Lists of all tiles one after the other, closed by −1 each.
pub fn lists(tiles: &[Vec<u32>]) -> Vec<f64> {
    let list = |t: &Vec<u32>| -> Vec<f64> {
        let gaussians = t.iter().map(|g| f64::from(*g));
        gaussians.chain([-1.0]).collect()
    };
    tiles.iter().flat_map(list).collect()
}

/// Projected Gaussian as numbers: mean, quadratic form, opacity, depth, colour, pixel bounds.
pub(super) type ProjectedRow = [f64; 14];

/// Parameters or transforms and both moments after some steps of the optimiser with the same gradients.
type Stepped<T> = [T; 3];

/// Numbers after `count` steps of the optimiser from moments of 0, `after` each of which the parameters are changed once more;
/// and number of gradients that are not finite.
pub(super) fn steps(
    mut params: Vec<f64>,
    grads: &[f64],
    (rate, count): (f64, u32),
    after: impl Fn(&mut [f64]),
) -> (Stepped<Vec<f64>>, u32) {
    let zeros = vec![0.0; params.len()];
    let (mut m, mut v, mut bad) = (zeros.clone(), zeros, 0);
    for t in 1..=count {
        let step = Step {
            rate,
            constants: ADAM,
            t,
        };
        bad += adam(grads, &step, &mut params, &mut m, &mut v);
        after(&mut params);
    }
    ([params, m, v], bad)
}

/// A case and the result of every stage.
///
/// Methods that take numbers of the device start from them, so that each stage answers for itself.
#[derive(Debug, Clone)]
pub struct Reference {
    /// Scene.
    pub scene: Scene64,
    /// Camera.
    pub camera: Camera64,
    /// Options.
    pub options: Options,
    /// Photo over the background \[3, height, width\].
    pub photo: Vec<f64>,
    /// Fourth plane of the photo \[height, width\]; empty if it has none.
    pub opacity: Vec<f64>,
    /// Mask \[height, width\]; `None` if the photo has none.
    pub mask: Option<Vec<f64>>,
    /// Forward and backward stages.
    pub pass: ReferencePass,
}

impl Reference {
    /// Runs every stage on a case.
    #[must_use]
    pub fn new(case: &Case) -> Self {
        let (scene, camera, options) = inputs(case);
        let (photo, weights) = (photo(case), case.lambdas);
        let fourth = case.photo.data[photo.len()..].iter();
        let opacity: Vec<f64> = fourth.map(|v| f64::from(*v) / 255.0).collect();
        let mask = (case.photo.alpha == Alpha::Mask).then(|| opacity.clone());
        Self {
            pass: run(&scene, &camera, &options, &photo, mask.as_deref(), weights),
            scene,
            camera,
            options,
            photo,
            opacity,
            mask,
        }
    }

    /// Projected Gaussians; zeros when culled.
    pub(super) fn projected(&self) -> Vec<ProjectedRow> {
        let of = |r: &crate::pipeline::stage::project::Projected64| {
            let [[x0, x1], [y0, y1]] = r.bounds.map(|b| b.map(f64::from));
            let [red, green, blue] = r.rgb;
            let [x, y] = r.mean;
            [
                x, y, r.a, r.r, r.c, r.lo, r.depth, red, green, blue, x0, x1, y0, y1,
            ]
        };
        let all = self.pass.projected.iter();
        all.map(|r| r.as_ref().map_or_else(ProjectedRow::default, of))
            .collect()
    }

    /// Gaussians of each tile of so many pixels a side.
    pub(super) fn tiles(&self, tile: i32) -> Vec<Vec<u32>> {
        let alpha_min = self.options.alpha_min;
        bin(&self.pass.projected, &self.camera, tile, alpha_min)
    }

    /// Sums of each Gaussian \[N, 9\].
    pub(super) fn sums(&self) -> Vec<f64> {
        let sums = self.pass.sums.iter();
        sums.flat_map(|s| s.unwrap_or([0.0; SUMS])).collect()
    }

    /// Size of the terms of a rotation's gradient: those of the scales over the quaternion's norm. A round Gaussian, or one
    /// seen along its axis, does not change when it turns, and the terms cancel.
    ///
    /// The largest term is the one that the longest axis of a Gaussian would have across the line of sight. It is the gradient
    /// with respect to the log-scale of axis k without the regulariser, 2 s_k² times the covariance's along that axis, times
    /// (s_max/s_k)².
    pub(super) fn turn_floor(&self) -> f64 {
        let (scene, sums) = (&self.scene, &self.pass.sums);
        let pulls = project_grad(scene, &self.camera, &self.options, sums, [0.0; 2]);
        let largest = |values: &mut dyn Iterator<Item = f64>| {
            values.filter(|v| v.is_finite()).fold(0.0, f64::max)
        };
        let turn = |i: usize| -> f64 {
            let axes = scene
                .gather::<3>(Plane::LOG_SCALE, i)
                .map(|l| l.clamp(LOG_SCALE[0], LOG_SCALE[1]));
            let longest = axes.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let pulls = pulls.gather::<3>(Plane::LOG_SCALE, i);
            let term = |k: usize| pulls[k].abs() * (2.0 * (longest - axes[k])).exp();
            largest(&mut (0..3).map(term))
        };
        let norm = |i: usize| unit_quaternion(scene.gather(Plane::ROTATION, i)).1;
        let norm = match largest(&mut (0..scene.len()).map(norm)) {
            0.0 => 1.0,
            norm => norm,
        };
        largest(&mut (0..scene.len()).map(turn)) / norm
    }

    /// Planes of the parameters and moments after so many steps of the optimiser with these gradients.
    pub(super) fn optimised(
        &self,
        case: &Case,
        grads: &[f64],
        steps_taken: u32,
    ) -> Stepped<Vec<Vec<f64>>> {
        let (r, n) = (&case.rates, self.scene.len());
        let of = |(p, plane): (usize, &Vec<f64>)| {
            let rate = match p {
                _ if p < Plane::LOG_SCALE => r.position,
                _ if p < Plane::ROTATION => r.scale,
                _ if p < Plane::OPACITY => r.rotation,
                _ if p < Plane::SH => r.opacity,
                _ if p < Plane::SH + 3 => r.sh0,
                _ => r.sh,
            };
            let count = steps_taken * u32::from(p < Plane::count(case.sh_degree));
            let grads = &grads[p * n..(p + 1) * n];
            steps(plane.clone(), grads, (rate, count), |_| ()).0
        };
        let planes: Vec<_> = self.scene.planes.iter().enumerate().map(of).collect();
        [0, 1, 2].map(|k| planes.iter().map(|p| p[k].clone()).collect())
    }

    /// Displacement of every Gaussian by the noise: all x, all y, all z.
    pub(super) fn displacements(&self) -> Vec<f64> {
        let [seed, stream] = NOISE_KEYS;
        let moves: Vec<[f64; 3]> = (0..self.scene.len())
            .map(|i| noise(&self.scene, i, &NOISE, seed, stream))
            .collect();
        (0..3)
            .flat_map(|k| moves.iter().map(move |m| m[k]))
            .collect()
    }

    /// Sums of the screen gradient's norm and number of iterations, after the same one twice; `sums` are those of each
    /// Gaussian, `lists` the closed lists of the tiles.
    pub(super) fn screen_gradients(&self, sums: &[f64], lists: &[f64]) -> [Vec<f64>; 2] {
        let in_view: HashSet<i64> = lists.iter().map(|g| *g as i64).collect();
        let norm = |(i, sums): (usize, &[f64; SUMS])| {
            let norm = screen_grad(&self.scene, i, &self.camera, sums);
            norm.filter(|_| in_view.contains(&(i as i64)))
        };
        let (sums, _) = sums.as_chunks::<SUMS>();
        let norms: Vec<Option<f64>> = sums.iter().enumerate().map(norm).collect();
        let twice = |value: fn(&Option<f64>) -> f64| norms.iter().map(|n| 2.0 * value(n)).collect();
        [
            twice(|n| n.unwrap_or(0.0)),
            twice(|n| f64::from(u8::from(n.is_some()))),
        ]
    }

    /// 1 for each Gaussian that contributes to the view, or that counts as seen before.
    pub(super) fn seen(&self) -> Vec<f64> {
        let ReferencePass {
            projected, tiles, ..
        } = &self.pass;
        let now = seen(projected, tiles, &self.camera, self.options.alpha_min);
        let before = seen_before(now.len());
        let either = |(now, before)| f64::from(u32::from(now) | before);
        now.into_iter().zip(before).map(either).collect()
    }

    /// Sums of both errors and number of views of every Gaussian, after the same view twice, from its error maps.
    pub(super) fn error_sums(&self, maps: &[f64]) -> Vec<f64> {
        let (ssim, l1) = maps.split_at(self.camera.pixels());
        let errors: Vec<Option<[f64; 2]>> = (0..self.scene.len())
            .map(|i| importance(&self.scene, i, &self.camera, [ssim, l1]))
            .collect();
        let sum = |k: usize| errors.iter().map(move |e| 2.0 * e.map_or(0.0, |e| e[k]));
        let views = errors.iter().map(|e| if e.is_some() { 2.0 } else { 0.0 });
        sum(0).chain(sum(1)).chain(views).collect()
    }

    /// Sums of ꟻLIP over each row of an image that is clamped, as far as its pixels count.
    pub(super) fn flip(&self, image: &[f64]) -> Vec<f64> {
        let counts = |i: usize| self.mask.as_ref().map_or(1.0, |mask| mask[i]);
        let [width, height] = self.camera.size.map(|s| s as usize);
        let render = image.iter().enumerate();
        let render = render.map(|(at, v)| counts(at % (width * height)) * v.clamp(0.0, 1.0));
        let render: Vec<f64> = render.collect();
        let map = error_map(
            &self.photo,
            &render,
            [width, height],
            FLIP_PIXELS_PER_DEGREE,
        );
        let sum = |y: usize| {
            (y * width..(y + 1) * width)
                .map(|i| counts(i) * map[i])
                .sum()
        };
        (0..height).map(sum).collect()
    }

    /// Transforms and moments \[views · 12\] after two steps with this gradient of the case's transform.
    pub(super) fn transforms(&self, gradient: &[f64]) -> Stepped<Vec<f64>> {
        let params = EXPOSURES.as_flattened().to_vec();
        let mut grads = vec![0.0; params.len()];
        grads[VIEW * ENTRIES..(VIEW + 1) * ENTRIES].copy_from_slice(gradient);
        steps(params, &grads, (EXPOSURE_RATE, 2), center).0
    }
}

/// Planes of the parameters and moments after the edits of a case, one after the other.
pub(super) fn edited(case: &Case, state: Stepped<Vec<Vec<f64>>>) -> Vec<f64> {
    let [mut rows, mut first, mut second] = state;
    edit(&case.edits, &mut rows, [&mut first, &mut second]);
    [rows, first, second].concat().concat()
}

/// Rows that a pass removes, of n.
pub(super) fn removed(n: usize) -> impl Iterator<Item = u32> {
    (0..n as u32).filter(|i| i % 5 == 2)
}

/// Direction that is up in every case.
pub const UP: [f32; 3] = [0.36, -0.8, 0.48];

/// Rows that stay, in Morton order.
pub(super) fn ordered(splats: &Gaussians, removed: &[u32]) -> Vec<f64> {
    let axis = |k: usize| splats.planes()[Plane::POSITION + k].as_slice();
    let rows = kept(
        [axis(0), axis(1), axis(2)],
        removed,
        Order::Morton { up: UP },
    );
    rows.into_iter().map(f64::from).collect()
}

/// Largest sum of magnitudes of the terms of dL/d\[A | b\].
pub(super) fn largest_sum(image: &[f64], dimage: &[f64]) -> f64 {
    let magnitudes = |v: &[f64]| v.iter().map(|v| v.abs()).collect::<Vec<f64>>();
    let (_, sums) = backward(&magnitudes(image), &IDENTITY, &magnitudes(dimage));
    sums.into_iter().fold(0.0, f64::max)
}
