//! Per-image exposure: what stands between the render and the loss. Where it is off, nothing of it is built.

use crate::base::error::{Error, Result};
use crate::capture::Alpha;
use crate::capture::photo::colors;
use crate::config::ExposureChoice;
use crate::device::tuning::status::{OVERFLOW, SLOTS};
use crate::device::{Array, CameraArg, Defines, Kernels};
use crate::pipeline::stage::exposure::{
    ENTRIES, ExposedImage, Exposure, ExposureStep, IDENTITY, exposed, unexposed,
};
use crate::pipeline::stage::loss::{ImagePair, size_of_image};
use crate::train::brightness::Decision;
use crate::train::{Trainer, brightness};

/// Transforms of the training views on the device.
#[derive(Debug)]
pub(super) struct Compensation {
    stage: Exposure,
    views: usize,
    exposures: Array<f32>,
    moments: [Array<f32>; 2],
    /// The render under its view's transform.
    corrected: Array<f32>,
    partial: Array<f32>,
    grads: Array<f32>,
    /// Iterations done when it was switched on.
    since: u32,
}

impl Compensation {
    /// The identity for every view; `plane` is the padded size of the largest, pixels.
    pub(super) fn new(kernels: &Kernels, views: usize, plane: usize, since: u32) -> Result<Self> {
        let device = kernels.device();
        let stage = Exposure::new::<f32>(kernels)?;
        let zeros = |name, len| Array::zeros(device, name, len);
        let it = Self {
            views,
            exposures: zeros("exposures", ENTRIES * views)?,
            moments: [
                zeros("moment1", ENTRIES * views)?,
                zeros("moment2", ENTRIES * views)?,
            ],
            corrected: zeros("corrected", 3 * plane)?,
            partial: zeros("exposure partial", stage.partial_len())?,
            grads: zeros("exposure grads", ENTRIES)?,
            stage,
            since,
        };
        let identity = IDENTITY.map(|v| v as f32).repeat(views);
        it.exposures.write(0, &identity)?;
        Ok(it)
    }

    fn arrays(&self) -> [&Array<f32>; 3] {
        [&self.exposures, &self.moments[0], &self.moments[1]]
    }
}

impl Trainer {
    fn compensation(&self) -> Result<Compensation> {
        let kernels = Kernels::new(&self.device, Defines::new(self.device.tuning()));
        let plane = self.dimage.len() / 3;
        let since = self.schedule.exposure_from().unwrap_or(0);
        Compensation::new(&kernels, self.views.len(), plane, since)
    }

    /// A render and its photo as the loss compares them: the render under its view's transform, if exposure is compensated.
    pub(super) fn pair<'a>(
        &'a self,
        view: usize,
        camera: &CameraArg<f32>,
        photo: &'a Array<u8>,
        background: [f32; 3],
    ) -> Result<ImagePair<'a, f32>> {
        let mut pair = ImagePair {
            image: &self.renderer.frame.image,
            photo,
            background,
            size: size_of_image(camera),
            blank: None,
        };
        if let Some(e) = &self.exposure {
            e.stage
                .apply(&self.exposed_image(e, view, &pair), &e.corrected)?;
            pair.image = &e.corrected;
        }
        Ok(pair)
    }

    fn exposed_image<'a>(
        &'a self,
        e: &'a Compensation,
        view: usize,
        pair: &ImagePair<'_, f32>,
    ) -> ExposedImage<'a, f32> {
        ExposedImage {
            image: &self.renderer.frame.image,
            plane: pair.plane(),
            exposures: &e.exposures,
            view,
        }
    }

    /// The gradient of the loss by the render (and by the view's transform) of what [`Trainer::pair`] gave.
    pub(super) fn loss_gradient(&self, view: usize, pair: &ImagePair<'_, f32>) -> Result<()> {
        let lambda = self.config.loss.lambda_ssim;
        self.loss
            .gradient(pair, lambda, &self.maps, &self.partial, &self.dimage)?;
        let Some(e) = &self.exposure else {
            return Ok(());
        };
        let exposed = self.exposed_image(e, view, pair);
        e.stage.backward(&exposed, &self.dimage, &e.partial)
    }

    /// The optimiser's step of the transforms, if there are any.
    pub(super) fn step_exposure(&self, iteration: u32, view: usize) -> Result<()> {
        let Some(e) = &self.exposure else {
            return Ok(());
        };
        self.step_transforms(e, iteration, view, &self.renderer.frame.status)
    }

    fn step_transforms(
        &self,
        e: &Compensation,
        iteration: u32,
        view: usize,
        status: &Array<u32>,
    ) -> Result<()> {
        let o = &self.config.optimizer;
        e.stage.step(&ExposureStep {
            partial: &e.partial,
            view,
            views: e.views,
            rate: self.schedule.exposure_rate(iteration),
            constants: [o.beta1, o.beta2, o.epsilon],
            step: iteration.saturating_sub(e.since) + 1,
            exposures: &e.exposures,
            moments: [&e.moments[0], &e.moments[1]],
            grads: &e.grads,
            status,
        })
    }

    /// What comes before the next iteration where that is due: a look at the bands, the decision on exposure. Whether
    /// [`Trainer::build_exposure`] is to follow; [`Trainer::step`] does both where nobody has. Twice is as good as once.
    ///
    /// # Errors
    /// As [`Trainer::step`].
    pub fn prepare(&mut self) -> Result<bool> {
        self.look_after_bands()?;
        self.exposure_begins()
    }

    /// Whether exposure is to be compensated from now on: that is due and, if it is left open, worth it; never of transparent
    /// photos.
    fn exposure_begins(&mut self) -> Result<bool> {
        if self.schedule.exposure_from() != Some(self.iteration)
            || self.views.alpha == Alpha::Transparency
            || self.exposure.is_some()
        {
            return Ok(false);
        }
        self.settle()?;
        if self.config.exposure == ExposureChoice::On {
            return Ok(true);
        }
        if self.exposure_decision.is_none() {
            let views = brightness::compared(self.views.len(), self.config.iterations);
            let mut gains = Vec::with_capacity(views.len());
            for view in views {
                gains.extend(self.gain(view)?);
            }
            self.exposure_decision = Some(Decision::new(self.iteration, &gains));
        }
        Ok(self.exposure_decision.is_some_and(|d| d.on))
    }

    /// Compiles the kernels of exposure and runs each once, so that no iteration waits for them; the transforms are the identity.
    ///
    /// # Errors
    /// A build failure, more than the device can allocate, or the driver's.
    pub fn build_exposure(&mut self) -> Result<()> {
        let built = self.compensation()?;
        let image = ExposedImage {
            image: &self.renderer.frame.image,
            plane: self.dimage.len() / 3,
            exposures: &built.exposures,
            view: 0,
        };
        built.stage.apply(&image, &built.corrected)?;
        built.stage.backward(&image, &self.dimage, &built.partial)?;
        // After an overflow the step changes nothing.
        let status = Array::zeros(&self.device, "status", SLOTS)?;
        status.write(OVERFLOW as usize, &[1])?;
        self.step_transforms(&built, self.iteration, 0, &status)?;
        self.device.finish()?;
        self.exposure = Some(built);
        Ok(())
    }

    fn gain(&mut self, view: usize) -> Result<Option<[f64; 3]>> {
        let photo = self.views.photo(view, &[])?;
        let (camera, factor) = self.camera_at(self.iteration, view);
        let options = self.options(self.iteration, self.scene.sh_degree);
        self.renderer.render(&self.scene, &camera, &options)?;
        let seen = self.renderer.read_image(&camera)?;
        let pixels = seen.width * seen.height;
        let photo = self.shrunk(&photo, view, factor)?;
        let alpha = self.views.alpha;
        let bytes = photo.read(0, alpha.planes() * pixels)?;
        let photo = colors(alpha, &bytes, options.background);
        Ok(brightness::gain(&seen.rgb, &seen.transmittance, &photo))
    }

    /// What was decided on per-image exposure; none where the configuration says, or before it is due.
    #[must_use]
    pub fn exposure_decision(&self) -> Option<Decision> {
        self.exposure_decision
    }

    /// Whether exposure is compensated now.
    #[must_use]
    pub fn compensates_exposure(&self) -> bool {
        self.exposure.is_some()
    }

    /// Transforms, first and second moments, \[3\]\[views · 12\]; nothing where exposure is not compensated.
    ///
    /// # Errors
    /// The driver's.
    pub fn exposures(&self) -> Result<Vec<Vec<f32>>> {
        let arrays = self.exposure.iter().flat_map(Compensation::arrays);
        arrays.map(Array::to_vec).collect()
    }

    /// Continues with a decision and what [`Trainer::exposures`] gave.
    pub(super) fn restore_exposure(
        &mut self,
        decision: Option<Decision>,
        rows: &[Vec<f32>],
    ) -> Result<()> {
        self.exposure_decision = decision;
        let wanted = self.config.exposure != ExposureChoice::Off;
        if decision.is_some_and(|d| d.on) || wanted && !rows.is_empty() {
            self.build_exposure()?;
        }
        let arrays: Vec<&Array<f32>> = self
            .exposure
            .iter()
            .flat_map(Compensation::arrays)
            .collect();
        let fits = arrays.len() == rows.len();
        if !fits || arrays.iter().zip(rows).any(|(a, row)| a.len() != row.len()) {
            return Err(Error::Numerics {
                stage: "checkpoint".into(),
                what: format!("exposures of another shape: {} rows", rows.len()),
            });
        }
        for (array, row) in arrays.iter().zip(rows) {
            array.write(0, row)?;
        }
        Ok(())
    }

    /// What exposure compensation makes of a render (planar RGB), and a photo's planes without it, as the scene has its colours.
    pub(super) fn exposed_picture(
        &self,
        view: usize,
        render: &mut [f32],
        photo: &mut [Vec<f32>; 3],
    ) -> Result<()> {
        let Some(e) = &self.exposure else {
            return Ok(());
        };
        let e = e.exposures.read(ENTRIES * view, ENTRIES)?;
        let pixels = render.len() / 3;
        for i in 0..pixels {
            let x = exposed(&e, [0, 1, 2].map(|c| render[c * pixels + i]));
            let y = unexposed(&e, [0, 1, 2].map(|c| photo[c][i]));
            for c in 0..3 {
                render[c * pixels + i] = x[c];
                photo[c][i] = y[c];
            }
        }
        Ok(())
    }
}
