//! An affine colour transform per training image (`kernels/exposure.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Kernel, Kernels, Launch, Real};

/// The transform that changes nothing, row-major \[A | b\].
pub const IDENTITY: [f64; 12] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// A x + b for a colour x; `e` is row-major \[A | b\].
#[must_use]
pub fn exposed(e: &[f32], x: [f32; 3]) -> [f32; 3] {
    [0, 4, 8].map(|r| e[r] * x[0] + e[r + 1] * x[1] + e[r + 2] * x[2] + e[r + 3])
}

/// A⁻¹ (y − b); y where A has no inverse to speak of.
#[must_use]
pub fn unexposed(e: &[f32], y: [f32; 3]) -> [f32; 3] {
    let row = |r: usize| glam::Vec3::new(e[4 * r], e[4 * r + 1], e[4 * r + 2]);
    let a = glam::Mat3::from_cols(row(0), row(1), row(2)).transpose();
    let invertible = a.determinant().abs() > 1e-3; // a NaN fails this, too
    if !invertible {
        return y;
    }
    let from = glam::Vec3::new(y[0] - e[3], y[1] - e[7], y[2] - e[11]);
    (a.inverse() * from).to_array()
}

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
        // As the kernel has them: 1 − β₂ of 0.999 in f32 is off by 1.3e-5 of itself, and the corrections must be off likewise.
        let [beta1, beta2, epsilon] = a.constants.map(R::of);
        let left = |beta: R| 1.0 - Into::<f64>::into(beta).powf(f64::from(a.step));
        self.step
            .launch()
            .array(a.partial, self.partial_len())
            .value(self.chunks as u32)
            .value(a.view as u32)
            .value(a.views as u32)
            .value(R::of(a.rate))
            .value(beta1)
            .value(beta2)
            .value(epsilon)
            .value(R::of(1.0 / left(beta1)))
            .value(R::of(1.0 / left(beta2).sqrt()))
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

/// A x + b of every pixel of a planar image \[3, pixels\]; `exposure` is row-major \[A | b\].
#[must_use]
pub fn apply(image: &[f64], exposure: &[f64; 12]) -> Vec<f64> {
    let n = image.len() / 3;
    let of = |r: usize, i: usize| -> f64 {
        let linear: f64 = (0..3).map(|c| exposure[4 * r + c] * image[c * n + i]).sum();
        linear + exposure[4 * r + 3]
    };
    (0..3 * n).map(|at| of(at / n, at % n)).collect()
}

/// dL/dx = Aᵀ dL/dx′ \[3, pixels\] and dL/d\[A | b\] of an image x \[3, pixels\] and dL/dx′.
#[must_use]
pub fn backward(image: &[f64], exposure: &[f64; 12], dimage: &[f64]) -> (Vec<f64>, [f64; 12]) {
    let n = image.len() / 3;
    let of = |c: usize, i: usize| -> f64 {
        (0..3)
            .map(|r| exposure[4 * r + c] * dimage[r * n + i])
            .sum()
    };
    let entry = |k: usize| -> f64 {
        let (r, c) = (k / 4, k % 4);
        let x = |i: usize| if c < 3 { image[c * n + i] } else { 1.0 };
        (0..n).map(|i| dimage[r * n + i] * x(i)).sum()
    };
    (
        (0..3 * n).map(|at| of(at / n, at % n)).collect(),
        std::array::from_fn(entry),
    )
}

/// Takes the mean deviation from the identity off the transforms \[views, 12\].
pub fn center(exposures: &mut [f64]) {
    let views = exposures.len() / 12;
    for (k, identity) in IDENTITY.into_iter().enumerate() {
        let sum: f64 = exposures.iter().skip(k).step_by(12).sum();
        let mean = sum / views as f64 - identity;
        exposures
            .iter_mut()
            .skip(k)
            .step_by(12)
            .for_each(|v| *v -= mean);
    }
}
