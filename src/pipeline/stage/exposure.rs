//! An affine colour transform of each training image (`kernels/exposure.cl`).

use glam::{Mat3, Vec3};

use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Kernels, Launch, Program, Real};
use crate::pipeline::buffers::ViewBuffers;
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
    let [red, green, blue] = [0, 4, 8].map(|row| Vec3::from_slice(&e[row..]));
    let a = Mat3::from_cols(red, green, blue).transpose();
    let from = Vec3::from(y) - Vec3::new(e[3], e[7], e[11]);
    match a.determinant().abs() > 1e-3 {
        true => (a.inverse() * from).to_array(),
        false => y, // for NaN, too
    }
}

/// The kernels, the transforms of the training views and the arrays of their steps.
#[derive(Debug)]
pub struct Exposures<R: Real> {
    program: Program,
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
}

impl<R: Real> Exposures<R> {
    /// Builds the kernels; the transforms change nothing. `plane` is the number of pixels of the largest padded plane.
    pub fn new(kernels: &Kernels, views: usize, plane: usize) -> Result<Self> {
        let program = kernels.build::<R>("exposure")?;
        let start = IDENTITY.map(R::of).repeat(views);
        let zeros = |name, len| Array::zeros(kernels.device(), name, len);
        let moment = |name| zeros(name, start.len());
        Ok(Self {
            transforms: Array::from_slice(kernels.device(), "exposures", &start)?,
            moments: [moment("exposure moment1")?, moment("exposure moment2")?],
            corrected: zeros("corrected", 3 * plane)?,
            partial: zeros("exposure partial", ENTRIES * program.chunks())?,
            grads: zeros("exposure grads", ENTRIES)?,
            program,
        })
    }

    /// Writes A x + b of every pixel of the render of training view `number` to `corrected`.
    pub fn apply(&self, view: &ViewBuffers<R>, number: usize) -> Result<()> {
        self.over_image("exposure_apply", view, number)
            .array(&self.corrected, 3 * view.camera.image().plane())
            .over_groups(self.program.chunks())
    }

    /// Turns the gradient with respect to the corrected image in `dimage` into that with respect to the render, and leaves the sums for
    /// [`Exposures::step`].
    pub fn backward(&self, view: &ViewBuffers<R>, number: usize, dimage: &Array<R>) -> Result<()> {
        let chunks = self.program.chunks();
        self.over_image("exposure_backward", view, number)
            .array(dimage, 3 * view.camera.image().plane())
            .array(&self.partial, ENTRIES * chunks)
            .over_groups(chunks)
    }

    /// Enqueues one step of the transforms of all views, whose mean stays the identity; after an overflow nothing changes.
    pub fn step(&self, number: usize, step: &Step, status: &Array<u32>) -> Result<()> {
        let (len, chunks) = (self.transforms.len(), self.program.chunks());
        let ([m, v], views) = (&self.moments, len / ENTRIES);
        self.program
            .launch("exposure_step")
            .array(&self.partial, ENTRIES * chunks)
            .uints([chunks, number, views])
            .reals::<R>([step.rate])
            .reals::<R>(step.arguments::<R>())
            .arrays([&self.transforms, m, v], len)
            .array(&self.grads, ENTRIES)
            .array(status, SLOTS)
            .over_groups(ENTRIES)
    }

    /// A sweep over the image of a view.
    fn over_image(&self, kernel: &'static str, view: &ViewBuffers<R>, number: usize) -> Launch<'_> {
        let plane = view.camera.image().plane();
        self.program
            .launch(kernel)
            .array(&view.image, 3 * plane)
            .uints([plane, self.program.chunks()])
            .array(&self.transforms, ENTRIES * (number + 1))
            .uints([number])
    }
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
