//! Everything that can be asked of a trainer between iterations.

use glam::{DVec3, Vec3};

use crate::base::error::{Error, Result};
use crate::base::math::logit;
use crate::capture::Camera;
use crate::config::Sampler;
use crate::density::mh::sparsity::{Lattice, VoxelCounts};
use crate::density::{DensityStats, Edit};
use crate::device::tuning::Tuning;
use crate::device::{Array, CameraArg, DeviceKind, StageTime};
use crate::pipeline::buffers::{GaussianBuffers, ViewSet};
use crate::pipeline::forward::{Quantity, RenderOptions, Rendered, Renderer, Renders};
use crate::pipeline::photos::PhotoStats;
use crate::pipeline::room::restride;
use crate::scene::formats::{SceneFile, Sphere};
use crate::scene::sh::C0;
use crate::scene::{Gaussians, Plane, morton};
use crate::train::noted::Noted;
use crate::train::plan::{Learned, Plan};
use crate::train::schedule::{Schedule, most_halvings};
use crate::train::sizes::Sizes;
use crate::train::step::{LOSS_RING, Trainer};

/// Largest number of views over which the loss is taken if every iteration has a background of its own.
const MAX_LOSS_VIEWS: usize = 32;

impl Trainer {
    /// Mean total loss without the regularisers, (1 − λ)·L1 + λ·(1 − SSIM), over the last iterations (at most 256, and no
    /// more than there are views); `None` before the first iteration. If every iteration has a background of its own, that
    /// of at most 32 views, rendered over the background that does not change.
    pub fn recent_loss(&mut self) -> Result<Option<f64>> {
        self.settle()?;
        if self.iteration > 0 && self.plan.random_background.value {
            return self.steady_loss().map(Some);
        }
        self.noted_loss()
    }

    /// Mean total loss that the last iterations have noted, each over its own background: [`Trainer::recent_loss`] but for that, and
    /// cheap.
    pub fn noted_loss(&mut self) -> Result<Option<f64>> {
        self.settle()?;
        let n = (self.iteration as usize)
            .min(LOSS_RING)
            .min(self.views.len());
        if n == 0 {
            return Ok(None);
        }
        let ring = self.losses.to_vec()?;
        let sum: f64 = (0..n)
            .map(|k| {
                let slot = (self.iteration as usize + LOSS_RING - 1 - k) % LOSS_RING;
                self.total_loss([f64::from(ring[2 * slot]), f64::from(ring[2 * slot + 1])])
            })
            .sum();
        Ok(Some(sum / n as f64))
    }

    fn total_loss(&self, [l1, ssim]: [f64; 2]) -> f64 {
        let lambda = self.plan.config.loss.lambda_ssim;
        (1.0 - lambda) * l1 + lambda * (1.0 - ssim)
    }

    /// Mean loss of some training views over the background that does not change, at the size that they have now.
    fn steady_loss(&mut self) -> Result<f64> {
        let (n, count) = (self.views.len(), self.views.len().min(MAX_LOSS_VIEWS));
        let views: Vec<usize> = (0..count).map(|k| k * n / count).collect();
        let mut sum = 0.0;
        for (k, &number) in views.iter().enumerate() {
            let at = self.iteration;
            let view = self.views.view(at, at, number, &views[k + 1..])?;
            let view = self.views.over_fixed_background(view);
            self.render_view(&view.camera, view.background)?;
            let pair = self.pipeline.pair(self.views.target(&view))?;
            let parts = self.pipeline.loss(&pair.everywhere())?;
            sum += self.total_loss(parts);
        }
        Ok(sum / count as f64)
    }

    /// The plan, with everything that training has found out so far.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Findings of training so far.
    #[must_use]
    pub fn learned(&self) -> &Learned {
        &self.learned
    }

    /// Pixels of the largest training photo at full size.
    #[must_use]
    pub fn largest_photo(&self) -> usize {
        let [width, height] = self.views.set.largest.pixels;
        width * height
    }

    /// True if the largest training photo can be halved.
    #[must_use]
    pub fn halves(&self) -> bool {
        most_halvings(self.views.set.largest.pixels) > 0
    }

    /// Number of training views.
    #[must_use]
    pub fn views(&self) -> usize {
        self.views.len()
    }

    /// The photos' sizes over the run.
    #[must_use]
    pub fn sizes(&self) -> &Sizes {
        self.views.sizes()
    }

    /// Number of times that photos are halved at the next iteration.
    #[must_use]
    pub fn halvings(&self) -> u32 {
        self.views.halvings(self.iteration)
    }

    /// First iteration that takes photos at the largest size of the run.
    #[must_use]
    pub fn full_size_from(&self) -> u32 {
        self.views.full_size_from()
    }

    /// Sizes for which the kernels are built.
    #[must_use]
    pub fn tuning(&self) -> Tuning {
        self.device.tuning()
    }

    /// Number of devices or processes that share the training.
    #[must_use]
    pub fn ranks(&self) -> usize {
        self.device.helpers().ranks()
    }

    /// Kind of the device.
    #[must_use]
    pub fn device_kind(&self) -> DeviceKind {
        self.device.info().kind
    }

    /// Iterations enqueued so far.
    #[must_use]
    pub fn iteration(&self) -> u32 {
        self.iteration
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn gaussians(&self) -> usize {
        self.gaussians.scene.all()
    }

    /// The Gaussians and, with anti-aliasing, their smoothing filter \[N\].
    ///
    /// # Errors
    /// The driver's, or non-finite parameters.
    pub fn splats(&mut self) -> Result<(Gaussians, Vec<f32>)> {
        let (splats, rows) = self.held(false)?;
        Ok((splats, rows.filter))
    }

    /// The scene as a file is to hold it: with smoothing filters merged into the Gaussians, and the colour that is to be seen behind them.
    ///
    /// # Errors
    /// The driver's, or non-finite parameters.
    pub fn scene(&mut self) -> Result<SceneFile> {
        let (splats, filter) = self.splats()?;
        let mut centers = self.views.set.cameras.iter().map(|camera| camera.center);
        // Cameras in one place say nothing about the size of the local frame's unit.
        let apart = centers.any(|center| Vec3::from(center).length() > 0.5);
        let unit = Sphere {
            center: DVec3::ZERO,
            radius: 1.0,
        };
        let up = self.plan.up;
        Ok(SceneFile {
            up: (up != morton::NO_UP).then(|| up.map(f64::from)),
            cameras: apart.then_some(unit),
            background: self.plan.behind(),
            ..SceneFile::trained(&splats, &filter)?
        })
    }

    /// Renders the Gaussians as they are, over the background that does not change.
    pub fn render(&mut self, camera: &Camera) -> Result<Rendered> {
        let background = self.schedule.fixed_background();
        self.render_view(
            &CameraArg::new(camera, self.device.tuning().tile),
            background,
        )?;
        self.pipeline.forward.read_image()
    }

    /// Renders the Gaussians as they are for somebody who looks on: refuses a view of more tile intersections than `most` and
    /// twice the most that training has had, and counts for no stage of training.
    ///
    /// # Errors
    /// See [`Renderer::image_within`].
    pub fn glimpse(
        &mut self,
        camera: &Camera,
        quantity: Quantity,
        most: usize,
    ) -> Result<Rendered> {
        let most = self.before_a_look(most)?;
        let background = match quantity {
            Quantity::Color => self.schedule.fixed_background(),
            Quantity::Depth => [0.0; 3],
        };
        let options = RenderOptions {
            sh_degree: self.gaussians.scene.sh_degree,
            background,
            quantity,
            active_only: false,
        };
        let forward = &mut self.pipeline.forward;
        forward.image_within(&self.gaussians.scene, camera, &options, most)
    }

    /// The tile intersections that a look may have, once nothing is in flight.
    fn before_a_look(&mut self, most: usize) -> Result<usize> {
        self.gather()?;
        Ok(most.max(2 * self.counters.max_intersections))
    }

    /// Has the findings of density steps noted from now on.
    pub fn note_density(&mut self) {
        self.control.noted.get_or_insert_default();
    }

    /// Findings of the last density step; `None` unless they are noted.
    #[must_use]
    pub fn noted(&self) -> Option<&Noted> {
        self.control.noted.as_ref()
    }

    /// Number of Gaussians in the voxel of each Gaussian, as the sparsity prior of a birth would count them now, without those that are
    /// dead by their opacity \[N\]; `None` for a sampler without such a prior.
    ///
    /// # Errors
    /// The driver's.
    pub fn voxel_counts(&mut self) -> Result<Option<Vec<u32>>> {
        self.gather()?;
        let config = &self.plan.config;
        if config.sampler != Sampler::Mh {
            return Ok(None);
        }
        let scene = &self.gaussians.scene;
        let [x, y, z] = [0, 1, 2].map(|k| scene.plane(Plane::POSITION + k));
        let (x, y, z) = (x?, y?, z?);
        let cameras: Vec<[f32; 3]> = self.views.set.cameras.iter().map(|c| c.center).collect();
        let eta = self.schedule.density_progress(self.iteration);
        let lattice = Lattice::at(&config.mh, eta, &cameras);
        let (logits, dead) = (scene.plane(Plane::OPACITY)?, logit(config.mh.dead_opacity));
        let alive = |i: usize| f64::from(logits[i]) > dead;
        let counts = VoxelCounts::count_where([&x, &y, &z], lattice, alive);
        let position = |i: usize| [x[i], y[i], z[i]].map(f64::from);
        let count = |i: usize| counts.get(position(i));
        Ok(Some((0..scene.count).map(count).collect()))
    }

    /// Brightness of each Gaussian from any direction, the mean of its red, green and blue \[N\].
    ///
    /// # Errors
    /// The driver's.
    pub fn brightness(&mut self) -> Result<Vec<f32>> {
        self.gather()?;
        let scene = &self.gaussians.scene;
        let [red, green, blue] = [0, 1, 2].map(|c| scene.plane(Plane::SH + c));
        let (red, green, blue) = (red?, green?, blue?);
        let sum = |i: usize| red[i] + green[i] + blue[i];
        let grey = |i: usize| 0.5 + C0 as f32 * sum(i) / 3.0;
        Ok((0..scene.count).map(grey).collect())
    }

    /// Renders the Gaussians in other colours, RGB in \[0, 1\] \[N\], as [`Trainer::glimpse`] does: from a copy without SH bands.
    ///
    /// # Errors
    /// See [`Renderer::image_within`]; another number of colours.
    pub fn glimpse_colored(
        &mut self,
        camera: &Camera,
        colors: &[[f32; 3]],
        most: usize,
    ) -> Result<Rendered> {
        let most = self.before_a_look(most)?;
        let colored = self.colored(colors);
        let options = RenderOptions::default();
        let forward = &mut self.pipeline.forward;
        colored.and_then(|scene| forward.image_within(&scene, camera, &options, most))
    }

    fn colored(&self, colors: &[[f32; 3]]) -> Result<GaussianBuffers> {
        let scene = &self.gaussians.scene;
        let (stride, count) = (scene.stride, scene.count);
        if colors.len() != count {
            let what = format!("{} colours for {count} Gaussians", colors.len());
            return Err(Error::numerics("colours", what));
        }
        let copy =
            |array: &Array<f32>, planes| restride(&self.device, array, planes, stride, stride);
        let params = copy(&scene.params, Plane::count(0))?;
        let filter = copy(&scene.filter, scene.filter.len() / stride)?;
        let coefficient = |color: f32| (color - 0.5) / C0 as f32;
        for c in 0..3 {
            let values: Vec<f32> = colors.iter().map(|rgb| coefficient(rgb[c])).collect();
            params.write((Plane::SH + c) * stride, &values)?;
        }
        Ok(GaussianBuffers {
            params,
            filter,
            stride,
            count,
            sh_degree: 0,
            shard: None,
        })
    }

    /// Density statistics over the run.
    #[must_use]
    pub fn stats(&self) -> &DensityStats {
        &self.control.stats
    }

    /// Gradient values that were not finite, as far as the host has seen.
    #[must_use]
    pub fn non_finite(&self) -> u64 {
        self.counters.non_finite
    }

    /// Number of iterations that were repeated because their tile intersections did not fit.
    #[must_use]
    pub fn overflows(&self) -> u64 {
        self.counters.overflows
    }

    /// True if exposure is compensated now.
    #[must_use]
    pub fn compensates_exposure(&self) -> bool {
        self.pipeline.exposure.is_some()
    }

    /// Transforms, first and second moments \[3\]\[views · 12\]; empty unless exposure is compensated.
    pub fn exposures(&self) -> Result<Vec<Vec<f32>>> {
        match &self.pipeline.exposure {
            Some(model) => model.rows(),
            None => Ok(Vec::new()),
        }
    }

    /// Leaves room for no more than `pairs` tile intersections, so that a test can see what happens then.
    #[doc(hidden)]
    pub fn shrink_intersections(&mut self, pairs: usize) -> Result<()> {
        self.gather()?;
        self.pipeline
            .forward
            .frame
            .set_intersections(&self.device, pairs)
    }

    /// First-order estimates of births in the views that training takes next; empty if density control asks for none.
    #[doc(hidden)]
    pub fn estimate(&mut self, births: &[Edit]) -> Result<Vec<f64>> {
        self.gather()?;
        let at = self.iteration;
        let (control, mut on) = self.controlled();
        control.estimate(&mut on, at, births)
    }

    /// Has the stages of every iteration timed, and not of a sample that stands for all. Before the first iteration; it costs some time
    /// with every launch.
    pub fn time_every_iteration(&mut self) {
        self.timing.time_all();
    }

    /// Device time per stage so far, of iterations from a sample of them, and under `density` the host's time in density steps, transfers
    /// included and without the device's stages in them and the estimates, whose time on host and device is under `probe`.
    #[must_use]
    pub fn stage_times(&self) -> Vec<(&'static str, StageTime)> {
        let mut times: Vec<_> = self.timing.stages().into_iter().collect();
        let (steps, estimates) = (self.control.time, self.control.estimate_time());
        if steps.calls > 0 {
            let mut host = steps;
            host.seconds = (host.seconds - self.timing.step_seconds()).max(0.0);
            if estimates.calls > 0 {
                host.seconds = (host.seconds - estimates.seconds).max(0.0);
                times.push(("probe", estimates));
            }
            times.push(("density", host));
        }
        times
    }

    /// Time that the decisions of density steps took the host, whether training went on meanwhile or not.
    #[must_use]
    pub fn decision_time(&self) -> StageTime {
        self.control.decisions
    }

    /// Photos waited for, and their share of the budget; sets of views that share it are counted, too.
    #[must_use]
    pub fn photo_stats(&self) -> PhotoStats {
        self.views.set.photos().stats()
    }

    /// The schedules of this run.
    #[must_use]
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    /// At most so many of the training views, evenly spread.
    #[must_use]
    pub fn training_views(&self, most: usize) -> ViewSet {
        self.views.set.some(most)
    }

    /// The scene, all of it on this device, and the renderer, between iterations.
    ///
    /// # Errors
    /// See [`Trainer::settle`]; no room.
    pub fn scene_and_renderer(&mut self) -> Result<(&GaussianBuffers, &mut Renderer)> {
        self.gather()?;
        Ok((&self.gaussians.scene, &mut self.pipeline.forward))
    }
}
