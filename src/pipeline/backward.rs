//! [`Backward`]: the backward stages, in order.

use std::sync::{Arc, OnceLock};

use crate::base::error::Result;
use crate::device::{Array, Defines, Device, Kernels, Program, Real};
use crate::pipeline::buffers::{GaussianBuffers, GradientBlock};
use crate::pipeline::forward::Renderer;
use crate::pipeline::stage::{project_grad, splat_grad};
use crate::scene::Plane;

/// Number of SH degrees there are.
const SH_DEGREES: usize = 4;
/// Rows of gradients that are read back start at multiples of this.
pub const GRADIENT_ROWS: usize = 16;
/// Rows whose gradients are on the device at a time when they are read back.
const BLOCK: usize = 1 << 16;

/// Runs the backward stages after a render: image gradient → sums per tile intersection → raw parameters.
#[derive(Debug)]
pub struct Backward {
    splat_grad: Program,
    /// One build for every SH degree in f32 and in f64, made when it is wanted: training without estimates never wants any.
    project_grad: Arc<[[OnceLock<Program>; SH_DEGREES]; 2]>,
    kernels: Kernels,
}

impl Backward {
    /// Builds the kernels.
    pub fn new<R: Real>(device: &Device, defines: Defines) -> Result<Self> {
        let kernels = Kernels::new(device, defines);
        Ok(Self {
            splat_grad: kernels.build::<R>("splat_grad")?,
            project_grad: Arc::default(),
            kernels,
        })
    }

    /// The same stages for renders with another alpha cut.
    pub fn with_cut<R: Real>(&self, device: &Device, defines: Defines) -> Result<Self> {
        Ok(Self {
            splat_grad: Kernels::new(device, defines).build::<R>("splat_grad")?,
            project_grad: self.project_grad.clone(),
            kernels: self.kernels.clone(),
        })
    }

    /// The build of project_grad for an SH degree.
    fn gradient_stage<R: Real>(&self, sh_degree: u32) -> Result<&Program> {
        let built = &self.project_grad[usize::from(R::IS_DOUBLE)][sh_degree as usize];
        if let Some(stage) = built.get() {
            return Ok(stage);
        }
        let stage = self
            .kernels
            .of_degree(sh_degree)
            .build::<R>("project_grad")?;
        Ok(built.get_or_init(|| stage))
    }

    /// Takes the image gradient of the view rendered last back to sums per tile intersection.
    pub fn splats<R: Real>(&self, forward: &Renderer<R>, dimage: &Array<R>) -> Result<()> {
        splat_grad::backward(&self.splat_grad, &forward.frame, dimage)
    }

    /// Takes the sums per tile intersection back to the raw parameters of a block of Gaussians; `lambdas` weigh the regularisers on opacity and scale.
    pub fn parameters<R: Real>(
        &self,
        forward: &Renderer<R>,
        scene: &GaussianBuffers<R>,
        sh_degree: u32,
        lambdas: [f64; 2],
        grads: &GradientBlock<'_, R>,
    ) -> Result<()> {
        let stage = self.gradient_stage::<R>(sh_degree)?;
        project_grad::backward(stage, scene, &forward.frame, lambdas, grads)
    }

    /// Derivatives of the loss with respect to some planes of the parameters, from the image gradient of the view rendered last,
    /// of the Gaussians from `first` (a multiple of [`GRADIENT_ROWS`]) on.
    pub fn plane_gradients<R: Real, const K: usize>(
        &self,
        forward: &Renderer<R>,
        scene: &GaussianBuffers<R>,
        dimage: &Array<R>,
        [first, sh_degree]: [usize; 2],
        planes: [usize; K],
    ) -> Result<[Vec<f64>; K]> {
        self.splats(forward, dimage)?;
        let count = scene.count;
        let stride = (count - first).next_multiple_of(GRADIENT_ROWS).min(BLOCK);
        let values = Array::zeros(forward.device(), "grads", scene.planes() * stride)?;
        let mut read = planes.map(|_| Vec::new());
        for from in (first..count).step_by(BLOCK) {
            let grads = GradientBlock {
                values: &values,
                planes: Plane::count(sh_degree as u32),
                stride,
                first: from,
                rows: from..count.min(from + BLOCK),
                views: 0,
            };
            self.parameters(forward, scene, sh_degree as u32, [0.0; 2], &grads)?;
            for (to, plane) in read.iter_mut().zip(planes) {
                let rows = values.read(plane * stride, grads.rows.len())?;
                to.extend(rows.into_iter().map(Into::into));
            }
        }
        Ok(read)
    }
}
