//! An affine colour transform per training image (`kernels/exposure.cl`).

use crate::error::Result;
use crate::gpu::tuning::status::SLOTS;
use crate::gpu::{Array, Kernel, Kernels, Launch, Real};

/// Entries of \[A | b\], row-major 3 × 4.
pub const ENTRIES: usize = 12;

/// The exposure stage.
#[derive(Debug)]
pub struct Exposure {
    apply: Kernel,
    backward: Kernel,
    step: Kernel,
    center: Kernel,
    chunks: usize,
    local: usize,
}

/// A render and the transform of the view that it is of.
#[derive(Debug)]
pub struct ExposedImage<'a, R: Real> {
    /// Render \[≥ 3, rows, stride\].
    pub image: &'a Array<R>,
    /// Pixels of a padded plane.
    pub plane: usize,
    /// Transforms \[views, 12\].
    pub exposures: &'a Array<R>,
    /// The view.
    pub view: usize,
}

/// Arguments of [`Exposure::step`].
#[derive(Debug)]
pub struct ExposureStep<'a, R: Real> {
    /// What [`Exposure::backward`] left.
    pub partial: &'a Array<R>,
    /// The view that it was of.
    pub view: usize,
    /// Number of views.
    pub views: usize,
    /// Learning rate.
    pub rate: f64,
    /// β₁, β₂, ε.
    pub constants: [f64; 3],
    /// Step, from 1.
    pub step: u32,
    /// In/out \[views, 12\].
    pub exposures: &'a Array<R>,
    /// In/out \[views, 12\].
    pub moments: [&'a Array<R>; 2],
    /// Gradient of the view's transform \[12\].
    pub grads: &'a Array<R>,
    /// Status array; after an overflow nothing is changed.
    pub status: &'a Array<u32>,
}

impl Exposure {
    /// Builds the kernels.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let names = [
            "exposure_apply",
            "exposure_backward",
            "exposure_step",
            "exposure_center",
        ];
        let [apply, backward, step, center] = kernels.build::<R, 4>("exposure", names)?;
        let tuning = kernels.defines().tuning;
        Ok(Self {
            apply,
            backward,
            step,
            center,
            chunks: tuning.chunks,
            local: tuning.coarse_local(),
        })
    }

    /// Values that `partial` must hold.
    #[must_use]
    pub fn partial_len(&self) -> usize {
        ENTRIES * self.chunks
    }

    /// A kernel with what both passes over the image begin with.
    fn launch<'k, R: Real>(&self, kernel: &'k Kernel, x: &ExposedImage<'_, R>) -> Launch<'k> {
        kernel
            .launch()
            .array(x.image, 3 * x.plane)
            .value(x.plane as u32)
            .value(self.chunks as u32)
            .array(x.exposures, ENTRIES * (x.view + 1))
            .value(x.view as u32)
    }

    /// A x + b of every pixel into `corrected` \[3, rows, stride\].
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn apply<R: Real>(&self, x: &ExposedImage<'_, R>, corrected: &Array<R>) -> Result<()> {
        self.launch(&self.apply, x)
            .array(corrected, 3 * x.plane)
            .run([self.chunks, 1], [self.local, 1])
    }

    /// The gradient with respect to the corrected image in `dimage` \[3, rows, stride\] becomes that with respect to the
    /// render; `partial` receives what [`Exposure::step`] adds up.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn backward<R: Real>(
        &self,
        x: &ExposedImage<'_, R>,
        dimage: &Array<R>,
        partial: &Array<R>,
    ) -> Result<()> {
        self.launch(&self.backward, x)
            .array(dimage, 3 * x.plane)
            .array(partial, self.partial_len())
            .run([self.chunks, 1], [self.local, 1])
    }

    /// Enqueues one step of the transforms of all views, whose mean stays the identity.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn step<R: Real>(&self, a: &ExposureStep<'_, R>) -> Result<()> {
        let len = ENTRIES * a.views;
        let [beta1, beta2, epsilon] = a.constants;
        let t = f64::from(a.step);
        self.step
            .launch()
            .array(a.partial, self.partial_len())
            .value(self.chunks as u32)
            .value(a.view as u32)
            .value(a.views as u32)
            .value(R::of(a.rate))
            .value(R::of(beta1))
            .value(R::of(beta2))
            .value(R::of(epsilon))
            .value(R::of(1.0 / (1.0 - beta1.powf(t))))
            .value(R::of(1.0 / (1.0 - beta2.powf(t)).sqrt()))
            .array(a.exposures, len)
            .array(a.moments[0], len)
            .array(a.moments[1], len)
            .array(a.grads, ENTRIES)
            .array(a.status, SLOTS)
            .run([ENTRIES, a.views], [1, 1])?;
        self.center
            .launch()
            .value(a.views as u32)
            .array(a.exposures, len)
            .array(a.status, SLOTS)
            .run([ENTRIES, 1], [1, 1])
    }
}
