//! L1 + SSIM and its gradient (`kernels/loss.cl`).

use crate::error::Result;
use crate::gpu::tuning::TILE;
use crate::gpu::{Array, CameraArg, Kernel, Kernels, Real};

/// The loss stage.
#[derive(Debug)]
pub struct Loss {
    forward: Kernel,
    backward: Kernel,
    sum: Kernel,
    vector_width: usize,
    strip: usize,
    local: usize,
    photo_planes: usize,
}

/// A rendered image and its photo.
#[derive(Debug)]
pub struct ImagePair<'a, R: Real> {
    /// Render \[≥ 3, rows, stride\].
    pub image: &'a Array<R>,
    /// Photo \[3 or 4, height, width\].
    pub photo: &'a Array<u8>,
    /// Background under the photo's alpha.
    pub background: [f32; 3],
    /// Width and height, pixels.
    pub size: [usize; 2],
}

impl<R: Real> ImagePair<'_, R> {
    /// Padded width and height of a plane.
    #[must_use]
    pub fn padded(&self) -> [usize; 2] {
        self.size.map(|s| s.next_multiple_of(TILE as usize))
    }

    /// Pixels of a padded plane.
    #[must_use]
    pub fn plane(&self) -> usize {
        let [w, h] = self.padded();
        w * h
    }

    pub(super) fn background_real(&self) -> [R; 3] {
        self.background.map(|c| R::of(f64::from(c)))
    }
}

/// Width and height of a camera's image, as [`ImagePair::size`] wants them.
#[must_use]
pub fn size_of_image<R: Real>(camera: &CameraArg<R>) -> [usize; 2] {
    camera.size.map(|s| s as usize)
}

impl Loss {
    /// Builds the kernels.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [forward, backward, sum] =
            kernels.build::<R, 3>("loss", ["loss_forward", "loss_backward", "loss_sum"])?;
        let tuning = kernels.defines().tuning;
        Ok(Self {
            forward,
            backward,
            sum,
            vector_width: tuning.vector_width as usize,
            strip: tuning.strip as usize,
            local: tuning.coarse_local(),
            photo_planes: kernels.defines().photo_planes(),
        })
    }

    /// Work-items (columns, rows) of strips over a padded image.
    fn strips(&self, padded: [usize; 2]) -> [usize; 2] {
        [
            padded[0].div_ceil(self.vector_width),
            padded[1].div_ceil(self.strip),
        ]
    }

    /// Values that `partial` must hold for an image: two per strip.
    #[must_use]
    pub fn partial_len(&self, width: usize, height: usize) -> usize {
        let tile = TILE as usize;
        let [x, y] = self.strips([width.next_multiple_of(tile), height.next_multiple_of(tile)]);
        2 * x * y
    }

    /// Windowed moments; derivative maps \[9, rows, stride\], or error maps \[2, rows, stride\] with `write_error`.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn forward<R: Real>(
        &self,
        pair: &ImagePair<'_, R>,
        write_error: bool,
        maps: &Array<R>,
        partial: &Array<R>,
    ) -> Result<()> {
        let ([w, h], [stride, rows], bg) = (pair.size, pair.padded(), pair.background_real());
        self.forward
            .launch()
            .array(pair.image, 3 * pair.plane())
            .array(pair.photo, self.photo_planes * w * h)
            .value(bg[0])
            .value(bg[1])
            .value(bg[2])
            .value(w as i32)
            .value(h as i32)
            .value(stride as i32)
            .value(rows as i32)
            .value(i32::from(write_error))
            .array(maps, if write_error { 2 } else { 9 } * pair.plane())
            .array(partial, self.partial_len(w, h))
            .run(self.strips([stride, rows]), [self.local, 1])
    }

    /// dL/dC into `dimage` \[3, rows, stride\], from the derivative maps of [`Loss::forward`].
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn backward<R: Real>(
        &self,
        pair: &ImagePair<'_, R>,
        maps: &Array<R>,
        lambda_ssim: f64,
        dimage: &Array<R>,
    ) -> Result<()> {
        let ([w, h], [stride, rows], bg) = (pair.size, pair.padded(), pair.background_real());
        let n = (3 * w * h) as f64;
        self.backward
            .launch()
            .array(pair.image, 3 * pair.plane())
            .array(pair.photo, self.photo_planes * w * h)
            .value(bg[0])
            .value(bg[1])
            .value(bg[2])
            .value(w as i32)
            .value(h as i32)
            .value(stride as i32)
            .value(rows as i32)
            .array(maps, 9 * pair.plane())
            .value(R::of((1.0 - lambda_ssim) / n))
            .value(R::of(lambda_ssim / n))
            .array(dimage, 3 * pair.plane())
            .run(self.strips([stride, rows]), [self.local, 1])
    }

    /// Mean |x − y| and mean SSIM into `out[2·slot..]`.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn sum<R: Real>(
        &self,
        pair: &ImagePair<'_, R>,
        partial: &Array<R>,
        out: &Array<R>,
        slot: usize,
    ) -> Result<()> {
        let [w, h] = pair.size;
        let len = self.partial_len(w, h);
        self.sum
            .launch()
            .array(partial, len)
            .value((len / 2) as u32)
            .value(R::of(1.0 / (3 * w * h) as f64))
            .array(out, 2 * (slot + 1))
            .value(slot as u32)
            .run([1, 1], [1, 1])
    }
}
