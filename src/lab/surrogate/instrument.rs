//! The device side of the check: a scene over some views, its losses, cues and gradients.
//!
//! Losses are compared strip by strip: the sums that the loss stage leaves for every strip are subtracted on the host in f64, so
//! that what a candidate does not touch cancels exactly. Where the device has double precision all kernels run in it; in
//! single precision the strips that change still round.

use crate::base::error::Result;
use crate::density::ErrorStatistics;
use crate::device::{Array, Defines, Device, Kernels, Real};
use crate::pipeline::backward::GRADIENT_ROWS;
use crate::pipeline::buffers::{GaussianBuffers, ViewSet};
use crate::pipeline::forward::RenderOptions;
use crate::pipeline::pass::{ErrorSums, Pipeline, Target};
use crate::pipeline::stage::importance::Importance;
use crate::pipeline::stage::loss::{ImagePair, size_of_image};
use crate::scene::Gaussians;
use crate::train::estimates::{FaintPass, SHAPE};

/// Parameters of an instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setting {
    /// SH degree and background of the renders.
    pub render: RenderOptions,
    /// λ of the loss.
    pub lambda_ssim: f64,
    /// Contributions below this alpha are dropped.
    pub alpha_min: f64,
    /// ε: opacity of a probe over that of its candidate. The cut of the probes' render is ε times the other, so that a probe
    /// covers just the pixels that its candidate would.
    pub probe: f64,
}

/// Error statistics of every Gaussian over the views.
#[derive(Debug, Clone, Default)]
pub struct CueRows {
    /// Sums of 1 − SSIM.
    pub ssim: Vec<f32>,
    /// Sums of L1.
    pub l1: Vec<f32>,
    /// Views that see the centre.
    pub views: Vec<u32>,
}

impl CueRows {
    /// The view of them that density control takes.
    #[must_use]
    pub fn cues(&self) -> ErrorStatistics<'_> {
        ErrorStatistics {
            ssim: &self.ssim,
            l1: &self.l1,
            views: &self.views,
        }
    }
}

/// The scene as it is, over all views.
#[derive(Debug, Clone, Default)]
pub struct Base {
    /// Loss of each view.
    pub losses: Vec<f64>,
    /// Error statistics of every Gaussian.
    pub cues: CueRows,
    /// Derivatives of the mean loss by opacity logit and the three log-scales, of every Gaussian.
    pub gradients: [Vec<f64>; 4],
    /// Sums of each strip, by view.
    pub(super) strips: Vec<Vec<f64>>,
    /// View by view, true for each Gaussian with a tile intersection.
    pub(super) touched: Vec<Vec<bool>>,
}

/// Renders, losses and gradients of one scene over some views.
#[derive(Debug)]
pub struct Instrument<R: Real> {
    pub(super) device: Device,
    pub(super) setting: Setting,
    pub(super) views: ViewSet<R>,
    pub(super) splats: Gaussians,
    pub(super) scene: GaussianBuffers<R>,
    pipeline: Pipeline<R>,
    /// Stages with the faint births' cut.
    pub(super) faint: FaintPass<R>,
    importance: Importance,
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
        let pipeline = Pipeline::new(device, defines, [degree, degree], views.largest)?;
        let cut = setting.alpha_min * setting.probe;
        let room = splats.len() + births.max(1) + 2 * GRADIENT_ROWS;
        Ok(Self {
            scene: GaussianBuffers::upload(device, &splats, room)?,
            faint: FaintPass::new(device, defines, degree, cut, &pipeline)?,
            importance: Importance::new::<R>(&kernels)?,
            pipeline,
            degree,
            device: device.clone(),
            setting,
            views,
            splats,
        })
    }

    /// Number of views.
    pub(super) fn view_count(&self) -> usize {
        self.views.len()
    }

    /// Renders a view, with the ordinary cut or that of faint births.
    pub(super) fn render(&mut self, faint: bool, view: usize, count: usize) -> Result<()> {
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
        then(&self.pipeline.pair(&self.views.cameras[view], target)?)
    }

    /// Sums of each strip of the render made last: |x − y| and SSIM in turn.
    pub(super) fn strips(&self, view: usize) -> Result<Vec<f64>> {
        self.with_pair(view, |pair| self.pipeline.strips(pair))
    }

    /// The loss of these strips, without its constant, and the number of pixel values.
    pub(super) fn weigh(&self, view: usize, l1: f64, ssim: f64) -> f64 {
        let [w, h] = size_of_image(&self.views.cameras[view]);
        let lambda = self.setting.lambda_ssim;
        ((1.0 - lambda) * l1 - lambda * ssim) / (3 * w * h) as f64
    }

    /// Takes the loss of the render made last with the ordinary cut back to the image.
    pub(super) fn image_gradient(&self, view: usize) -> Result<()> {
        let lambda = self.setting.lambda_ssim;
        self.with_pair(view, |pair| self.pipeline.loss_gradient(view, pair, lambda))
    }

    /// Gradients of the rows from `first` (a multiple of 16) on from the render made last, ordinary or faint: opacity logit and
    /// log-scales.
    pub(super) fn gradients(
        &self,
        faint: bool,
        view: usize,
        first: usize,
    ) -> Result<[Vec<f64>; 4]> {
        let (camera, dimage) = (&self.views.cameras[view], self.pipeline.image_gradient());
        let (backward, forward) = match faint {
            true => (&self.faint.backward, &self.faint.forward),
            false => (&self.pipeline.backward, &self.pipeline.forward),
        };
        let rows = [first, self.degree as usize];
        backward.plane_gradients(forward, &self.scene, camera, dimage, rows, SHAPE)
    }

    /// Losses, cues and gradients of the scene as it is.
    pub fn base(&mut self) -> Result<Base> {
        let n = self.splats.len();
        let cues = Array::zeros(&self.device, "cues", 3 * self.scene.stride)?;
        let mut base = Base {
            gradients: std::array::from_fn(|_| vec![0.0; n]),
            ..Base::default()
        };
        let k = self.view_count() as f64;
        for view in 0..self.view_count() {
            self.render(false, view, n)?;
            let strips = self.strips(view)?;
            let sum = |at: usize| strips[at..].iter().step_by(2).sum::<f64>();
            let loss = self.setting.lambda_ssim + self.weigh(view, sum(0), sum(1));
            base.losses.push(loss);
            base.strips.push(strips);
            base.touched.push(self.pipeline.forward.intersected(0, n)?);
            let errors = ErrorSums {
                sums: &cues,
                first_view: view == 0,
            };
            self.with_pair(view, |pair| {
                let camera = &self.views.cameras[view];
                self.pipeline
                    .add_errors(&self.importance, &self.scene, camera, pair, &errors)
            })?;
            self.image_gradient(view)?;
            let gradients = self.gradients(false, view, 0)?;
            for (sums, more) in base.gradients.iter_mut().zip(gradients) {
                sums.iter_mut().zip(more).for_each(|(s, g)| *s += g / k);
            }
        }
        let row = |r: usize| cues.read(r * self.scene.stride, n);
        let narrow = |v: Vec<R>| v.into_iter().map(|v| v.into() as f32).collect();
        base.cues = CueRows {
            ssim: narrow(row(0)?),
            l1: narrow(row(1)?),
            views: row(2)?.into_iter().map(|v| v.into() as u32).collect(),
        };
        Ok(base)
    }
}
