//! [`Scoring`]: a rendered view held against its photo.

use std::sync::OnceLock;

use crate::base::error::{Error, Result};
use crate::device::{Array, CameraArg, Defines, Device, ImageSize, Kernels, Program};
use crate::pipeline::forward::Renders;
use crate::pipeline::photo_array::PhotoArray;
use crate::pipeline::stage::flip::Flip;
use crate::pipeline::stage::loss::{ImagePair, Loss};
use crate::pipeline::stage::metrics;

/// Sums over the pixels of a pair, as far as they count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairErrors {
    /// Squared error of the clamped render, all channels.
    pub squared: f64,
    /// Pixels that count: the sum of the mask.
    pub counted: f64,
    /// 1 − SSIM of the clamped render.
    pub dissimilarity: f64,
}

/// Stages that score a render, with what lies between them.
#[derive(Debug)]
pub struct Scoring {
    metrics: Program,
    loss: Loss<f32>,
    rows: Array<f32>,
    /// From when it is wanted first.
    flip: OnceLock<Flip<f32>>,
    kernels: Kernels,
    largest: ImageSize,
}

impl Scoring {
    /// Builds the kernels for images of at most `largest` pixels.
    pub fn new(device: &Device, defines: Defines, largest: ImageSize) -> Result<Self> {
        let kernels = Kernels::new(device, defines);
        Ok(Self {
            metrics: kernels.build::<f32>("metrics")?,
            loss: Loss::new(&kernels, largest, false)?,
            rows: Array::zeros(device, "score", 3 * largest.pixels[1])?,
            flip: OnceLock::new(),
            kernels,
            largest,
        })
    }

    /// Scores a picture of one pixel, so that everything is compiled and has its room.
    ///
    /// # Errors
    /// See [`Scoring::flip`].
    pub fn warm_up(&self) -> Result<()> {
        let (device, size) = (
            self.kernels.device(),
            ImageSize {
                pixels: [1, 1],
                ..self.largest
            },
        );
        let planes = self.kernels.defines().photo_planes();
        let image = Array::zeros(device, "image", 3 * size.plane())?;
        let pair = ImagePair {
            image: &image,
            photo: &PhotoArray::whole(Array::zeros(device, "photo", planes)?, size),
            background: [0.0; 3],
            size,
            band: 0..1,
            blank: None,
        };
        let errors = self.errors(&pair)?;
        self.flip(&pair, errors.counted).map(drop)
    }

    /// Renders a view and compares it with its photo; the clamped image stays in the renderer.
    ///
    /// # Errors
    /// Those of [`Renders::render_view`].
    pub fn view(
        &self,
        scene: &mut dyn Renders,
        camera: &CameraArg<f32>,
        photo: &PhotoArray,
        background: [f32; 3],
    ) -> Result<PairErrors> {
        scene.render_view(camera, background)?;
        self.errors(&ImagePair::new(&scene.renderer().frame, photo, background))
    }

    /// Clamps a render in place and compares it with its photo; waits.
    pub fn errors(&self, pair: &ImagePair<'_, f32>) -> Result<PairErrors> {
        metrics::score(&self.metrics, pair, &self.rows)?;
        self.loss.errors(pair)?;
        let maps = (self.loss.error_maps()?, self.loss.error_planes());
        metrics::sum_dissimilarity(&self.metrics, pair, maps, &self.rows)?;
        let h = pair.size.pixels[1];
        let rows = self.rows.read(0, 3 * h)?;
        let sum = |k: usize| -> f64 { rows[k * h..][..h].iter().map(|v| f64::from(*v)).sum() };
        Ok(PairErrors {
            squared: sum(0),
            counted: sum(1),
            dissimilarity: sum(2),
        })
    }

    /// Mean ꟻLIP of a pair that [`Scoring::errors`] has clamped, over its `counted` pixels; 0 if there are none. Waits.
    ///
    /// # Errors
    /// A render that is not finite, or see [`Flip::new`].
    pub fn flip(&self, pair: &ImagePair<'_, f32>, counted: f64) -> Result<f64> {
        let flip = match self.flip.get() {
            Some(flip) => flip,
            None => {
                let flip = Flip::new(&self.kernels, self.largest)?;
                self.flip.get_or_init(|| flip)
            }
        };
        let sum: f64 = flip.rows(pair)?.into_iter().map(f64::from).sum();
        if !sum.is_finite() {
            return Err(Error::numerics("flip", "a render that is not finite"));
        }
        Ok(if counted > 0.0 { sum / counted } else { 0.0 })
    }
}
