//! The device side of the check: a scene over some views, its losses and error statistics; the true loss changes of births by
//! rendering again, and their first-order estimates.
//!
//! Losses are compared strip by strip: the sums that the loss stage leaves for every strip are subtracted on the host in f64, so
//! that what a candidate does not touch cancels exactly. Where the device has double precision all kernels run in it; in
//! single precision the strips that change still round.

use crate::base::error::Result;
use crate::density::ErrorStatistics;
use crate::device::{Array, Defines, Device, Kernels, Program, Real};
use crate::lab::surrogate::births::Birth;
use crate::pipeline::backward::GRADIENT_ROWS;
use crate::pipeline::buffers::{GaussianBuffers, ViewSet};
use crate::pipeline::forward::RenderOptions;
use crate::pipeline::pass::{Pipeline, Target};
use crate::pipeline::stage::loss::{Beside, ImagePair};
use crate::scene::{Gaussians, Plane};
use crate::train::estimates::{FaintPass, change, scaled_logit};

/// Parameters of an instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setting {
    /// SH degree and background of the renders.
    pub render: RenderOptions,
    /// λ of the loss.
    pub lambda_ssim: f64,
    /// Contributions below this alpha are dropped.
    pub alpha_min: f64,
    /// ε: opacity of a faint birth over that of its candidate. The cut of its render is ε times the other, so that it covers
    /// just the pixels that its candidate would.
    pub epsilon: f64,
}

/// The scene as it is, over all views.
#[derive(Debug, Clone, Default)]
pub struct Base {
    /// Loss of each view.
    pub losses: Vec<f64>,
    /// Sums of 1 − SSIM and of L1 at the centre of every Gaussian, over the views that see it.
    errors: [Vec<f32>; 2],
    /// Number of views that see the centre of every Gaussian.
    seen: Vec<u32>,
    /// Sums of each strip, by view.
    strips: Vec<Vec<f64>>,
}

impl Base {
    /// The errors as density control takes them.
    pub(super) fn errors(&self) -> ErrorStatistics<'_> {
        let [ssim, l1] = &self.errors;
        ErrorStatistics {
            ssim,
            l1,
            views: &self.seen,
        }
    }
}

/// First-order estimate of a birth.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Estimate {
    /// First-order change of the mean loss.
    pub change: f64,
    /// For each view, true if any tile intersection is its own.
    pub touched: Vec<bool>,
}

/// Renders, losses and gradients of one scene over some views.
#[derive(Debug)]
pub struct Instrument<R: Real> {
    device: Device,
    setting: Setting,
    views: ViewSet<R>,
    splats: Gaussians,
    scene: GaussianBuffers<R>,
    pipeline: Pipeline<R>,
    /// Stages with the faint births' cut.
    faint: FaintPass<R>,
    importance: Program,
    degree: u32,
}

impl<R: Real> Instrument<R> {
    /// Uploads the scene, with room for `births` more, and builds the kernels.
    pub fn new(
        device: &Device,
        views: ViewSet<R>,
        splats: Gaussians,
        setting: Setting,
        births: usize,
    ) -> Result<Self> {
        let degree = setting.render.sh_degree.min(splats.sh_degree());
        let defines = Defines {
            alpha_min: setting.alpha_min,
            sh_degree: degree,
            alpha: views.alpha,
            ..Defines::new(device.tuning())
        };
        let kernels = Kernels::new(device, defines);
        let pipeline = Pipeline::new(device, defines, degree, views.largest)?;
        let cut = setting.alpha_min * setting.epsilon;
        let room = splats.len() + births.max(1) + 2 * GRADIENT_ROWS;
        Ok(Self {
            scene: GaussianBuffers::upload(device, &splats, room)?,
            faint: FaintPass::new(device, defines, degree, cut, &pipeline)?,
            importance: kernels.build::<R>("importance")?,
            pipeline,
            degree,
            device: device.clone(),
            setting,
            views,
            splats,
        })
    }

    /// Renders a view, with the ordinary cut or that of faint births.
    fn render(&mut self, faint: bool, view: usize, count: usize) -> Result<()> {
        self.scene.count = count;
        let camera = &self.views.cameras[view];
        let forward = match faint {
            true => &mut self.faint.forward,
            false => &mut self.pipeline.forward,
        };
        forward.render(&self.scene, camera, &self.setting.render)
    }

    /// Calls `then` with the render made last with the ordinary cut, and the view's photo.
    fn with_pair<T>(
        &self,
        view: usize,
        then: impl FnOnce(&ImagePair<'_, R>) -> Result<T>,
    ) -> Result<T> {
        let photo = self.views.photo(view, &[])?;
        let target = Target {
            view,
            photo: &photo,
            background: self.setting.render.background,
            skip_blank: false,
        };
        then(&self.pipeline.pair(target)?)
    }

    /// Sums of each strip of the render made last: |x − y| and SSIM in turn.
    fn strips(&self, view: usize) -> Result<Vec<f64>> {
        self.with_pair(view, |pair| self.pipeline.strips(pair))
    }

    /// The loss of these strips, without its constant, and the number of pixel values.
    fn weigh(&self, view: usize, l1: f64, ssim: f64) -> f64 {
        let [w, h] = self.views.cameras[view].image().pixels;
        let lambda = self.setting.lambda_ssim;
        ((1.0 - lambda) * l1 - lambda * ssim) / (3 * w * h) as f64
    }

    /// Takes the loss of the render made last with the ordinary cut back to the image.
    fn image_gradient(&self, view: usize) -> Result<()> {
        let lambda = self.setting.lambda_ssim;
        self.with_pair(view, |pair| {
            self.pipeline
                .loss_gradient(view, pair, lambda, Beside::NOTHING)
        })
    }

    /// Derivatives with respect to the opacity logits of the rows from `first` (a multiple of 16) on, from the render made last with the faint cut.
    fn slopes(&self, first: usize) -> Result<Vec<f64>> {
        let (backward, forward) = (&self.faint.backward, &self.faint.forward);
        let (dimage, rows) = (
            self.pipeline.image_gradient(),
            [first, self.degree as usize],
        );
        let planes = [Plane::OPACITY];
        let [slopes] = backward.plane_gradients(forward, &self.scene, dimage, rows, planes)?;
        Ok(slopes)
    }

    /// Losses and sums of the scene as it is.
    pub fn base(&mut self) -> Result<Base> {
        let n = self.splats.len();
        let sums = Array::zeros(&self.device, "sums", 3 * self.scene.stride)?;
        let mut base = Base::default();
        for view in 0..self.views.len() {
            self.render(false, view, n)?;
            let strips = self.strips(view)?;
            let sum = |at: usize| strips[at..].iter().step_by(2).sum::<f64>();
            let loss = self.setting.lambda_ssim + self.weigh(view, sum(0), sum(1));
            base.losses.push(loss);
            base.strips.push(strips);
            self.with_pair(view, |pair| {
                let (stage, first) = (&self.importance, view == 0);
                self.pipeline.errors(pair)?;
                self.pipeline.add_errors(stage, &self.scene, first, &sums)
            })?;
        }
        let row = |r: usize| sums.read(r * self.scene.stride, n);
        let narrow = |v: Vec<R>| v.into_iter().map(|v| v.into() as f32).collect();
        base.errors = [narrow(row(0)?), narrow(row(1)?)];
        base.seen = row(2)?.into_iter().map(|v| v.into() as u32).collect();
        Ok(base)
    }

    /// Writes births to the rows from `first` on, their opacities times `factor`.
    fn insert(&self, first: usize, births: &[Birth], factor: f64) -> Result<()> {
        let value = |plane: usize, b: &Birth| match plane {
            0..3 => f64::from(b.position[plane]),
            Plane::LOG_SCALE..Plane::ROTATION => {
                f64::from(b.shape.log_scale[plane - Plane::LOG_SCALE])
            }
            Plane::OPACITY => scaled_logit(f64::from(b.shape.opacity_logit), factor),
            _ => f64::from(self.splats.planes()[plane][b.source as usize]),
        };
        for plane in 0..self.scene.planes() {
            let values: Vec<R> = births.iter().map(|b| R::of(value(plane, b))).collect();
            let at = plane * self.scene.stride + first;
            self.scene.params.write(at, &values)?;
        }
        Ok(())
    }

    /// First-order estimates of births (method: a birth of opacity → 0 changes nothing, but has a derivative). All are
    /// in the scene at once, ε as opaque as they would be, and one backward pass per view tells the derivatives; dL/dC is that
    /// of the ordinary render.
    pub fn estimate(&mut self, births: &[Birth]) -> Result<Vec<Estimate>> {
        let (n, epsilon) = (self.splats.len(), self.setting.epsilon);
        self.insert(n, births, epsilon)?;
        let mut estimates = vec![Estimate::default(); births.len()];
        let (first, count) = (n / GRADIENT_ROWS * GRADIENT_ROWS, n + births.len());
        for view in 0..self.views.len() {
            self.render(false, view, n)?;
            self.image_gradient(view)?;
            self.render(true, view, count)?;
            let slopes = self.slopes(first)?;
            let touched = self.faint.forward.intersected(n)?;
            for (k, (e, b)) in estimates.iter_mut().zip(births).enumerate() {
                let logit = f64::from(b.shape.opacity_logit);
                let change = change(slopes[n - first + k], logit, epsilon);
                e.change += change / self.views.len() as f64;
                e.touched.push(touched[k]);
            }
        }
        Ok(estimates)
    }

    /// The true change of the mean loss by one birth; views that it does not touch are left out,
    /// because nothing changes there.
    pub fn change(&mut self, base: &Base, birth: &Birth, touched: &[bool]) -> Result<f64> {
        let n = self.splats.len();
        self.insert(n, &[*birth], 1.0)?;
        let mut sum = 0.0;
        for (view, seen) in touched.iter().enumerate() {
            if !*seen {
                continue;
            }
            self.render(false, view, n + 1)?;
            let strips = self.strips(view)?;
            let before = base.strips[view].chunks_exact(2);
            let differences = strips.chunks_exact(2).zip(before);
            let (l1, ssim) = differences.fold((0.0, 0.0), |(l1, ssim), (new, old)| {
                (l1 + (new[0] - old[0]), ssim + (new[1] - old[1]))
            });
            sum += self.weigh(view, l1, ssim);
        }
        Ok(sum / self.views.len() as f64)
    }
}
