//! Training by the definitions in f64, and what each stage is given, from the documentation of the schedules.

use std::sync::Arc;

use mhsplat::TrainConfig;
use mhsplat::base::constants::{ALPHA_MIN, NEAR};
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::capture::{Dataset, View};
use mhsplat::config::ViewSubset;
use mhsplat::density::mh::MetropolisHastings;
use mhsplat::density::{
    DensityControl, ErrorStatistics, NoiseLaw, Outcome, Picture, SceneState, Statistics,
    StepContext,
};
use mhsplat::pipeline::reference::{Camera64, Options, Scene64};
use mhsplat::pipeline::reference_pass::{render, run};
use mhsplat::pipeline::stage::adam::{Step, adam};
use mhsplat::pipeline::stage::edit::{edit, reorder};
use mhsplat::pipeline::stage::importance::importance;
use mhsplat::pipeline::stage::noise::noise;
use mhsplat::pipeline::stage::splat::splat;
use mhsplat::scene::{Gaussians, Plane, filters, morton};

/// Iterations that the schedules are written for.
const PAPER: f64 = 30_000.0;

/// Mistakes in what the stages are given; none by default.
#[derive(Debug, Clone, Copy, Default)]
pub struct Wrong {
    /// Addend to the number of Adam's step.
    pub step: u32,
    /// Addend to the iteration that learning rates are taken of.
    pub rates: u32,
    /// True if the noise follows the rate of a short run.
    pub boosted_noise: bool,
    /// Addend to the seed of the noise.
    pub noise_seed: u64,
    /// Addend to the iteration that keys the noise.
    pub noise_iteration: u32,
    /// Addend to the seed of the order of views.
    pub view_seed: u64,
    /// Addend to the seed of the backgrounds.
    pub background_seed: u64,
    /// Addend to the iteration that bands of spherical harmonics are added by.
    pub band: u32,
    /// Views by which the window of the error statistics begins too late.
    pub window: usize,
    /// Addend to the seed of the density step.
    pub density_seed: u64,
    /// Addend to the iteration of the density step.
    pub density_iteration: u32,
    /// Addend to the progress of the density step.
    pub progress: f64,
    /// Addend to the iteration whose views births in image space are proposed in.
    pub pictures: u32,
    /// True if moments of rows that the density step writes are kept.
    pub kept_moments: bool,
    /// True if the rates of a batch's steps are those of single views.
    pub batch_rates: bool,
    /// True if the second moment remembers as much as in a long run.
    pub long_memory: bool,
    /// True if the moments forget by steps and not by views.
    pub batch_moments: bool,
    /// True if the step takes the sum of a batch's gradients and not their mean.
    pub batch_sum: bool,
    /// True if the step takes the gradients of a batch's last view alone.
    pub batch_last: bool,
}

/// Errors under the centre of each Gaussian in one view: 1 − SSIM and L1; `None` if it is not seen.
pub type ViewErrors = Vec<Option<[f64; 2]>>;

/// A run in f64.
pub struct Definitions<'a> {
    data: &'a Dataset,
    config: &'a TrainConfig,
    wrong: Wrong,
    /// Parameters.
    pub scene: Scene64,
    moments: [Vec<Vec<f64>>; 2],
    /// Gradients of the views of the batch so far.
    gradients: Vec<Vec<f64>>,
    /// Iterations done.
    pub iteration: u32,
    /// L1 and SSIM of each iteration.
    pub losses: Vec<[f64; 2]>,
    /// Errors in the view of each iteration since the last density step.
    pub errors: Vec<ViewErrors>,
}

impl<'a> Definitions<'a> {
    pub fn new(
        data: &'a Dataset,
        config: &'a TrainConfig,
        start: &Gaussians,
        anti_aliased: bool,
        wrong: Wrong,
    ) -> Self {
        let mut scene = Scene64::new(start);
        scene.filter = anti_aliased.then(Vec::new);
        let zeros = scene.zeros_like().planes;
        let mut new = Self {
            data,
            config,
            wrong,
            scene,
            moments: [zeros.clone(), zeros.clone()],
            gradients: zeros,
            iteration: 0,
            losses: Vec::new(),
            errors: Vec::new(),
        };
        new.smooth();
        new
    }

    /// Number of iterations of a run of this length in the place of `paper` of 30,000.
    fn scaled(&self, paper: u32) -> u32 {
        (f64::from(paper) * f64::from(self.config.iterations) / PAPER).round() as u32
    }

    fn smooth(&mut self) {
        if self.scene.filter.is_some() {
            let cameras: Vec<_> = self.data.train.iter().map(|v| v.camera).collect();
            let positions = (0..self.scene.len()).map(|i| self.scene.position(i));
            self.scene.filter = Some(filters(positions, &cameras));
        }
    }

    /// The view of an iteration: every epoch is a permutation of the views, by Fisher and Yates from the last one on, without those at its
    /// end that fill no batch.
    fn view(&self, iteration: u32) -> &'a View {
        let n = self.data.train.len();
        let seed = self.config.seed + self.wrong.view_seed;
        let epoch = n - n % self.config.batch as usize;
        let stream = Stream::ViewOrder.stream(iteration / epoch as u32);
        let mut order: Vec<usize> = (0..n).collect();
        for i in (1..n).rev() {
            let u = Philox::uniform(seed, stream, i as u64)[0];
            order.swap(i, (u * (i + 1) as f64) as usize);
        }
        &self.data.train[order[iteration as usize % epoch]]
    }

    /// Camera and options of an iteration with a background of its own.
    fn inputs(&self, iteration: u32) -> (Camera64, Options) {
        let seed = self.config.seed + self.wrong.background_seed;
        let stream = Stream::Background.stream(0);
        let [r, g, b, _] = Philox::uniform(seed, stream, u64::from(iteration));
        let options = Options {
            alpha_min: ALPHA_MIN,
            sh_degree: self.scene.sh_degree,
            background: [r, g, b],
        };
        (Camera64::new(&self.view(iteration).camera, NEAR), options)
    }

    fn photo(&self, iteration: u32) -> Vec<f64> {
        let photo = self.view(iteration).photo.load().unwrap();
        let value = |v: &u8| f64::from(*v) / 255.0;
        photo.data.iter().map(value).collect()
    }

    /// Learning rate of a plane of an iteration: f = 4 in a run as short as this.
    fn rate(&self, plane: usize) -> f64 {
        let o = &self.config.optimizer;
        let iteration = self.iteration + self.wrong.rates;
        let share = f64::from(iteration) / f64::from(self.config.iterations);
        assert!(self.config.iterations <= 1875 && o.lr_settle_from == 0);
        let settle = o.lr_settle.powf(share);
        match plane {
            _ if plane < Plane::LOG_SCALE => 8.0 * self.position_rate(iteration),
            _ if plane < Plane::ROTATION => 8.0 * settle * o.lr_scale,
            _ if plane < Plane::OPACITY => 2.0 * settle * o.lr_rotation,
            _ if plane < Plane::SH => 2.0 * settle * o.lr_opacity,
            _ if plane < Plane::SH + 3 => 2.0 * settle * o.lr_sh0,
            _ => 4.0 * settle * o.lr_sh,
        }
    }

    /// Learning rate of the positions without the factor of short runs.
    fn position_rate(&self, iteration: u32) -> f64 {
        let o = &self.config.optimizer;
        let share = f64::from(iteration) / f64::from(self.config.iterations);
        o.lr_position * (o.lr_position_final / o.lr_position).powf(share)
    }

    /// Adds a band if one is due, then takes an iteration: render, loss, gradients, Adam, noise.
    pub fn iterate(&mut self) {
        self.add_band();
        let (camera, options) = self.inputs(self.iteration);
        let (photo, l) = (self.photo(self.iteration), self.config.loss);
        let lambdas = [l.lambda_ssim, l.lambda_opacity, l.lambda_scale];
        let pass = run(&self.scene, &camera, &options, &photo, None, lambdas);
        self.losses.push([pass.loss.l1, pass.loss.ssim]);
        let maps = [&pass.loss.ssim_error[..], &pass.loss.l1_error];
        let under = |i: usize| importance(&self.scene, i, &camera, maps);
        self.errors.push((0..self.scene.len()).map(under).collect());
        let first = self.iteration.is_multiple_of(self.config.batch);
        let afresh = first || self.wrong.batch_last;
        for (sums, plane) in self.gradients.iter_mut().zip(&pass.grads.planes) {
            for (sum, g) in sums.iter_mut().zip(plane) {
                *sum = if afresh { *g } else { *sum + g };
            }
        }
        if (self.iteration + 1).is_multiple_of(self.config.batch) {
            self.optimize();
            self.perturb();
        }
        self.iteration += 1;
    }

    /// A step with the mean gradient of a batch.
    fn optimize(&mut self) {
        let (o, w, views) = (self.config.optimizer, self.wrong, self.config.batch);
        let divisor = match w.batch_sum || w.batch_last {
            true => 1.0,
            false => f64::from(views),
        };
        let power = if w.batch_moments { 1.0 } else { views.into() };
        // Of a run as short as this the memory is a sixteenth of the configured one.
        let sooner = if w.long_memory { 1.0 } else { 16.0 };
        let beta2 = 1.0 - sooner * (1.0 - o.beta2);
        for p in 0..self.gradients.len() {
            let mean: Vec<f64> = self.gradients[p].iter().map(|g| g / divisor).collect();
            let step = Step {
                rate: self.boost() * self.rate(p),
                constants: [o.beta1.powf(power), beta2.powf(power), o.epsilon],
                t: (self.iteration + 1) / views + w.step,
            };
            let [m, v] = &mut self.moments;
            let params = &mut self.scene.planes[p];
            assert_eq!(adam(&mean, &step, params, &mut m[p], &mut v[p]), 0);
        }
    }

    /// Factor on the rates of a batch's steps.
    fn boost(&self) -> f64 {
        match self.wrong.batch_rates {
            true => 1.0,
            false => f64::from(self.config.batch).sqrt(),
        }
    }

    fn perturb(&mut self) {
        let (mh, w) = (&self.config.mh, &self.wrong);
        let factor = if w.boosted_noise { 8.0 } else { 1.0 };
        let law = NoiseLaw {
            rate: factor * mh.noise_rate * self.boost() * self.position_rate(self.iteration),
            steepness: 100.0,
            opacity: mh.dead_opacity,
        };
        let stream = Stream::Noise.stream(self.iteration + w.noise_iteration);
        let seed = self.config.seed + w.noise_seed;
        for i in 0..self.scene.len() {
            let moved = noise(&self.scene, i, &law, seed, stream);
            for (k, d) in moved.into_iter().enumerate() {
                self.scene.planes[Plane::POSITION + k][i] += d;
            }
        }
    }

    fn add_band(&mut self) {
        let interval = self.scaled(self.config.optimizer.sh_interval);
        let due = (self.iteration + self.wrong.band).is_multiple_of(interval);
        if self.iteration == 0 || !due || self.scene.sh_degree >= self.config.sh_degree {
            return;
        }
        self.scene.sh_degree += 1;
        let (planes, n) = (Plane::count(self.scene.sh_degree), self.scene.len());
        let [m, v] = &mut self.moments;
        for all in [&mut self.scene.planes, m, v, &mut self.gradients] {
            all.resize(planes, vec![0.0; n]);
        }
    }

    /// Progress of a density step that is due now.
    fn progress(&self) -> f64 {
        let mh = &self.config.mh;
        let [from, until] =
            [mh.from_iteration, mh.until_iteration].map(|i| f64::from(self.scaled(i)));
        (f64::from(self.iteration) - from) / (until - from) + self.wrong.progress
    }

    /// Views whose errors the density step gets that is due now.
    pub fn window(&self) -> &[ViewErrors] {
        let n = self.data.train.len();
        let wanted = match self.config.mh.view_subset {
            ViewSubset::All => n,
            ViewSubset::Fixed(k) => n.min(k as usize),
            _ => (n as f64 * (1.0 - self.progress())) as usize,
        };
        let all = self.errors.len();
        &self.errors[all - wanted.min(all) + self.wrong.window..]
    }

    /// Sums of both errors over some views, and number of views, of each Gaussian.
    pub fn sums(views: &[ViewErrors]) -> [Vec<f64>; 3] {
        let n = views[0].len();
        let of = |i: usize| views.iter().filter_map(move |v| v[i]);
        let sum = |k: usize| (0..n).map(|i| of(i).map(|e| e[k]).sum()).collect();
        let count = |i: usize| of(i).count() as f64;
        [sum(0), sum(1), (0..n).map(count).collect()]
    }

    /// The density step: errors and pictures in f64, decisions of the strategy, its edits in f64, Morton order.
    pub fn density_step(&mut self) -> Outcome {
        let singles = |plane: &[f64]| plane.iter().map(|v| *v as f32).collect::<Vec<f32>>();
        let mh = &self.config.mh;
        let w = self.wrong;
        let planes: Vec<Vec<f32>> = self.scene.planes[..Plane::SH]
            .iter()
            .map(|p| singles(p))
            .collect();
        let state = SceneState {
            positions: std::array::from_fn(|k| &planes[Plane::POSITION + k][..]),
            log_scales: std::array::from_fn(|k| &planes[Plane::LOG_SCALE + k][..]),
            rotations: std::array::from_fn(|k| &planes[Plane::ROTATION + k][..]),
            opacity_logits: &planes[Plane::OPACITY],
        };
        let [ssim, l1, views] = Self::sums(self.window()).map(|s| singles(&s));
        let views: Vec<u32> = views.iter().map(|v| *v as u32).collect();
        let pictures: Vec<Picture<'_>> = (self.iteration + w.pictures..)
            .take(mh.pixel_views as usize)
            .map(|at| self.picture(at))
            .collect();
        let center = |v: &View| v.camera.center().as_vec3().to_array();
        let cameras: Vec<[f32; 3]> = self.data.train.iter().map(center).collect();
        let context = StepContext {
            cameras: &cameras,
            pictures: &pictures,
            ..StepContext::at(
                self.iteration + w.density_iteration,
                self.progress(),
                self.config.seed + w.density_seed,
            )
        };
        let errors = ErrorStatistics {
            ssim: &ssim,
            l1: &l1,
            views: &views,
        };
        let outcome = MetropolisHastings::new(mh)
            .step(&context, &state, &Statistics::Errors(errors))
            .unwrap();
        self.apply(&outcome);
        self.errors.clear();
        self.smooth();
        outcome
    }

    fn apply(&mut self, outcome: &Outcome) {
        let [m, v] = &mut self.moments;
        let kept = [m.clone(), v.clone()];
        for plane in self.scene.planes.iter_mut().chain(&mut *m).chain(&mut *v) {
            plane.resize(outcome.rows, 0.0);
        }
        edit(&outcome.edits, &mut self.scene.planes, [m, v]);
        if self.wrong.kept_moments {
            for (plane, before) in self.moments.iter_mut().zip(&kept) {
                for (now, before) in plane.iter_mut().zip(before) {
                    now[..before.len()].copy_from_slice(before);
                }
            }
        }
        let axis = |k: usize| -> Vec<f32> {
            let plane = self.scene.planes[Plane::POSITION + k].iter();
            plane.map(|v| *v as f32).collect()
        };
        let [x, y, z] = [0, 1, 2].map(axis);
        let up = self.data.up().expect("photos that stand upright").as_vec3();
        let mut order = morton::order([&x, &y, &z], up.into());
        order.retain(|row| !outcome.removed.contains(row));
        let [m, v] = &mut self.moments;
        for plane in self.scene.planes.iter_mut().chain(m).chain(v) {
            *plane = reorder(&order, plane);
        }
        // No batch is under way.
        self.gradients = self.scene.zeros_like().planes;
    }

    /// A view as the iteration `at` will take it.
    fn picture(&self, at: u32) -> Picture<'static> {
        let (camera, options) = self.inputs(at);
        let (projected, tiles, image, left) = render(&self.scene, &camera, &options);
        let photo = self.photo(at);
        let n = camera.pixels();
        let mut deep = projected;
        for one in deep.iter_mut().flatten() {
            one.rgb = [one.depth; 3];
        }
        let black = Options {
            background: [0.0; 3],
            ..options
        };
        let (depth, _) = splat(&deep, &tiles, &camera, &black);
        let apart = |i: usize, c: usize| (image[c * n + i] - photo[c * n + i]).abs();
        let error = |i: usize| (0..3).map(|c| apart(i, c)).sum::<f64>() / 3.0;
        let singles =
            |of: &dyn Fn(usize) -> f64| -> Vec<f32> { (0..n).map(|i| of(i) as f32).collect() };
        let [w0, w1, w2] = camera.w;
        let [fx, fy] = camera.focal;
        let [cx, cy] = camera.principal;
        Picture {
            size: camera.size.map(|v| v as usize),
            stride: camera.size[0] as usize,
            intrinsics: [fx, fy, cx, cy].map(|v| v as f32),
            rotation: std::array::from_fn(|k| [w0, w1, w2][k / 3][k % 3] as f32),
            center: camera.center.map(|v| v as f32),
            photo: Arc::new([0, 1, 2].map(|c| singles(&|i| photo[c * n + i]))),
            error: singles(&error).into(),
            depth: singles(&|i| depth[i]).into(),
            transmittance: singles(&|i| left[i]).into(),
        }
    }
}
