//! An affine colour transform of each training image (`kernels/exposure.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Device, Kernel, Kernels, Launch, Real};
use crate::pipeline::stage::adam::Step;

/// Entries of \[A | b\], row-major 3 × 4.
pub const ENTRIES: usize = 12;

/// The transform that changes nothing, row-major \[A | b\].
pub const IDENTITY: [f64; ENTRIES] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// A x + b for a colour x; `e` is row-major \[A | b\].
#[must_use]
pub fn exposed(e: &[f32], x: [f32; 3]) -> [f32; 3] {
    [0, 4, 8].map(|r| e[r] * x[0] + e[r + 1] * x[1] + e[r + 2] * x[2] + e[r + 3])
}

/// A⁻¹ (y − b), or y if A is nearly singular.
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

/// Transforms of the training views and the arrays of their steps.
#[derive(Debug)]
pub struct Exposures<R: Real> {
    /// Transforms.
    pub transforms: Array<R>,
    /// First and second moments of the transforms.
    pub moments: [Array<R>; 2],
    /// Colours of the render under the transform of its view.
    pub corrected: Array<R>,
    /// Sums of each chunk for the gradient.
    pub partial: Array<R>,
    /// Gradient of the transform of one view.
    pub grads: Array<R>,
    /// Number of views.
    pub views: usize,
}

impl<R: Real> Exposures<R> {
    /// Transforms that change nothing; `plane` is the number of pixels of the largest padded plane.
    pub fn new(device: &Device, stage: &Exposure, views: usize, plane: usize) -> Result<Self> {
        let chunks = stage.step.chunks();
        let start = IDENTITY.map(R::of).repeat(views);
        let zeros = |name, len| Array::zeros(device, name, len);
        Ok(Self {
            transforms: Array::from_slice(device, "exposures", &start)?,
            moments: [
                zeros("moment1", start.len())?,
                zeros("moment2", start.len())?,
            ],
            corrected: zeros("corrected", 3 * plane)?,
            partial: zeros("exposure partial", ENTRIES * chunks)?,
            grads: zeros("exposure grads", ENTRIES)?,
            views,
        })
    }
}

/// The kernels.
#[derive(Debug)]
pub struct Exposure {
    apply: Kernel,
    backward: Kernel,
    step: Kernel,
    center: Kernel,
}

impl Exposure {
    /// Builds the kernels.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let names = [
            "exposure_apply",
            "exposure_backward",
            "exposure_step",
            "exposure_center",
        ];
        let [apply, backward, step, center] = kernels.build::<R, 4>("exposure", names)?;
        Ok(Self {
            apply,
            backward,
            step,
            center,
        })
    }

    /// Writes A x + b of every pixel of a view's render to `corrected`; `plane` is the number of pixels of a padded plane.
    pub fn apply<R: Real>(
        &self,
        image: &Array<R>,
        plane: usize,
        e: &Exposures<R>,
        view: usize,
    ) -> Result<()> {
        with_image(&self.apply, image, plane, e, view)
            .array(&e.corrected, 3 * plane)
            .over_chunks([self.apply.chunks(), 1])
    }

    /// Turns the gradient by the corrected image in `dimage` into that by the render, and leaves the sums for
    /// [`Exposure::step`].
    pub fn backward<R: Real>(
        &self,
        image: &Array<R>,
        plane: usize,
        e: &Exposures<R>,
        view: usize,
        dimage: &Array<R>,
    ) -> Result<()> {
        let chunks = self.backward.chunks();
        with_image(&self.backward, image, plane, e, view)
            .array(dimage, 3 * plane)
            .array(&e.partial, ENTRIES * chunks)
            .over_chunks([chunks, 1])
    }

    /// Enqueues one step of the transforms of all views, whose mean stays the identity; after an overflow nothing changes.
    pub fn step<R: Real>(
        &self,
        e: &Exposures<R>,
        view: usize,
        step: &Step,
        status: &Array<u32>,
    ) -> Result<()> {
        let (len, chunks) = (ENTRIES * e.views, self.step.chunks());
        self.step
            .launch()
            .array(&e.partial, ENTRIES * chunks)
            .uints([chunks, view, e.views])
            .reals::<R>([step.rate])
            .reals::<R>(step.arguments::<R>())
            .array(&e.transforms, len)
            .array(&e.moments[0], len)
            .array(&e.moments[1], len)
            .array(&e.grads, ENTRIES)
            .array(status, SLOTS)
            .run([ENTRIES, e.views], [1, 1])?;
        self.center
            .launch()
            .uints([e.views])
            .array(&e.transforms, len)
            .array(status, SLOTS)
            .run([ENTRIES, 1], [1, 1])
    }
}

/// The arguments that both passes over the image begin with.
fn with_image<'k, R: Real>(
    kernel: &'k Kernel,
    image: &Array<R>,
    plane: usize,
    e: &Exposures<R>,
    view: usize,
) -> Launch<'k> {
    kernel
        .launch()
        .array(image, 3 * plane)
        .uints([plane, kernel.chunks()])
        .array(&e.transforms, ENTRIES * (view + 1))
        .uints([view])
}

// Definition in f64.

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

/// Subtracts the mean deviation from the identity from the transforms \[views, 12\].
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
