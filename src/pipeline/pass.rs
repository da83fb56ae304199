//! [`Pipeline`]: all stages of one view, forward and backward. Nothing else knows their order.

use std::ops::Range;

use crate::base::error::Result;
use crate::device::{Array, CameraArg, Defines, Device, ImageSize, Kernels, Program, Real};
use crate::pipeline::backward::Backward;
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::exposure::ExposureModel;
use crate::pipeline::forward::{RenderOptions, Renderer};
use crate::pipeline::photo_array::PhotoArray;
use crate::pipeline::room::image_planes;
use crate::pipeline::share::Share;
use crate::pipeline::stage::importance;
use crate::pipeline::stage::loss::{Beside, ImagePair, Loss};
use crate::scene::Plane;
use crate::scene::sh::C0;

/// A photo to compare a render with.
#[derive(Debug, Clone, Copy)]
pub struct Target<'a> {
    /// Number of the view, for its exposure transform.
    pub view: usize,
    /// Photo at the camera's size: all of it, or the rows that the band of this rank needs.
    pub photo: &'a PhotoArray,
    /// Background under the photo's alpha.
    pub background: [f32; 3],
    /// Loss left out of tiles that are blank in render and photo.
    pub skip_blank: bool,
}

/// Stages of one view, with what lies between them.
#[derive(Debug)]
pub struct Pipeline<R: Real = f32> {
    device: Device,
    /// Forward stages.
    pub forward: Renderer<R>,
    /// Backward stages.
    pub backward: Backward,
    /// Marks the tiles in which a photo's pixels count; `None` if all do.
    active_tiles: Option<Program>,
    loss: Loss<R>,
    /// This rank's part of every view while ranks share the Gaussians; `None` while it has them all.
    pub share: Option<Share<R>>,
    /// Per-image exposure, between render and loss; `None` if it is off.
    pub exposure: Option<ExposureModel<R>>,
    dimage: Array<R>,
}

impl<R: Real> Pipeline<R> {
    /// Builds the kernels for SH degrees up to one and images of at most `largest` pixels.
    pub fn new(
        device: &Device,
        defines: Defines,
        sh_degree: u32,
        largest: ImageSize,
    ) -> Result<Self> {
        let kernels = Kernels::new(device, defines);
        let active_tiles = defines.masked() || defines.skips_blank();
        Ok(Self {
            forward: Renderer::new(device, defines, sh_degree, true)?,
            backward: Backward::new::<R>(device, defines)?,
            active_tiles: active_tiles
                .then(|| kernels.build::<R>("active_tiles"))
                .transpose()?,
            share: None,
            exposure: None,
            loss: Loss::new(&kernels, largest, true)?,
            dimage: image_planes(device, "dimage", 3, largest)?,
            device: device.clone(),
        })
    }

    /// Choices that the kernels are compiled with.
    #[must_use]
    pub fn defines(&self) -> Defines {
        self.forward.defines()
    }

    /// Renders a view without waiting, unless ranks share it; `photo` says which tiles count.
    ///
    /// # Errors
    /// Arrays that do not fit, or the driver's.
    pub fn enqueue(
        &mut self,
        scene: &GaussianBuffers<R>,
        camera: &CameraArg<R>,
        photo: &PhotoArray,
        options: &RenderOptions,
    ) -> Result<()> {
        self.mark_tiles(photo, camera)?;
        match &mut self.share {
            Some(share) => share.render(&mut self.forward, scene, camera, options),
            None => self.forward.enqueue(scene, camera, options),
        }
    }

    /// The view enqueued last; after the backward stages with the sums of all pairs of the Gaussians that are here.
    #[must_use]
    pub fn frame(&self) -> &ViewBuffers<R> {
        &self.forward.frame
    }

    /// Has the stages take the tiles of a photo in which a pixel counts.
    pub fn mark_tiles(&mut self, photo: &PhotoArray, camera: &CameraArg<R>) -> Result<()> {
        if let Some(stage) = &self.active_tiles {
            let marked = photo.active_tiles(&self.device, stage, camera.image())?;
            self.forward.take_tiles(marked);
        }
        Ok(())
    }

    /// The render made last and its photo as the loss compares them: the render under its view's exposure transform.
    pub fn pair<'a>(&'a self, target: Target<'a>) -> Result<ImagePair<'a, R>> {
        let skips = target.skip_blank && self.active_tiles.is_some();
        let view = &self.forward.frame;
        let mut pair = ImagePair::new(view, target.photo, target.background);
        pair.blank = skips.then(|| view.blank());
        if let Some(exposure) = &self.exposure {
            exposure.stage.apply(view, target.view)?;
            pair.image = &exposure.stage.corrected;
        }
        Ok(pair)
    }

    /// Takes (1 − λ)·L1 + λ·(1 − SSIM) of a view's pair back to its render, and to its exposure transform; writes what is wanted beside
    /// that. The loss is written by the leader alone where ranks share the view.
    pub fn loss_gradient(
        &self,
        view: usize,
        pair: &ImagePair<'_, R>,
        lambda: f64,
        beside: Beside<'_, R>,
    ) -> Result<()> {
        let fused = Beside {
            // Ranks put their sums together first.
            losses: beside.losses.filter(|_| self.share.is_none()),
            ..beside
        };
        self.loss.gradient(pair, lambda, &self.dimage, fused)?;
        let frame = &self.forward.frame;
        if let Some(exposure) = &self.exposure {
            if let Some(share) = &self.share {
                share.complete(&frame.image, 3, pair.size)?;
                share.complete(&self.dimage, 3, pair.size)?;
            }
            exposure.stage.backward(frame, view, &self.dimage)?;
        }
        if let Some((losses, slot)) = beside.losses {
            let here = match &self.share {
                Some(share) => share.sum_loss(&self.loss, pair)?,
                None => !self.loss.fuses(),
            };
            if here {
                self.loss.sum(pair, losses, slot)?;
            }
        }
        match beside.errors && !self.loss.fuses() {
            true => self.errors(&pair.clone().everywhere()),
            false => Ok(()),
        }
    }

    /// Writes the error maps of a pair.
    pub fn errors(&self, pair: &ImagePair<'_, R>) -> Result<()> {
        self.loss.errors(pair)
    }

    /// Mean |x − y| and mean SSIM of a pair; waits.
    pub fn loss(&self, pair: &ImagePair<'_, R>) -> Result<[f64; 2]> {
        let sums = Array::zeros(&self.device, "loss", 2)?;
        self.loss.compare(pair)?;
        self.loss.sum(pair, &sums, 0)?;
        let parts = sums.to_vec()?;
        Ok([parts[0].into(), parts[1].into()])
    }

    /// Sums of |x − y| and SSIM of each strip of a pair, in turn; waits.
    pub fn strips(&self, pair: &ImagePair<'_, R>) -> Result<Vec<f64>> {
        self.loss.compare(pair)?;
        let sums = self.loss.read_strips(pair.size)?;
        Ok(sums.into_iter().map(Into::into).collect())
    }

    /// Adds the errors of the pair whose errors were wanted last at the projected centres of the Gaussians to their statistics, which `first_view` starts
    /// anew.
    pub fn add_errors(
        &self,
        stage: &Program,
        scene: &GaussianBuffers<R>,
        first_view: bool,
        statistics: &Array<R>,
    ) -> Result<()> {
        let (maps, planes) = (self.loss.error_maps()?, self.loss.error_planes());
        if let Some(share) = &self.share {
            share.complete(maps, planes, self.forward.frame.camera.image())?;
        }
        importance::add_errors(
            stage,
            scene,
            self.frame(),
            (maps, planes),
            first_view,
            statistics,
        )
    }

    /// Takes the image gradient back to sums per tile intersection, and sends those of other ranks' Gaussians to them; those of the rows that
    /// are here come by [`Pipeline::take_sums`].
    pub fn splat_gradient(&mut self) -> Result<()> {
        self.backward.splats(&self.forward, &self.dimage)?;
        match &mut self.share {
            Some(share) => share.return_sums(&self.forward.frame),
            None => Ok(()),
        }
    }

    /// Number of parts in which the sums of the rows that are here come: one, unless they come over a network.
    #[must_use]
    pub fn parts(&self) -> usize {
        self.share.as_ref().map_or(1, Share::parts)
    }

    /// Brings the sums of a part of the `count` rows that are here, waiting for other ranks where they share the view; returns the rows. Parts
    /// come one after the other, once for each render, and what is enqueued for one is done while the next is on its way.
    ///
    /// # Errors
    /// No room, another rank's failure, or the driver's.
    pub fn take_sums(&mut self, part: usize, count: usize) -> Result<Range<usize>> {
        match &mut self.share {
            Some(share) => share.take_sums(part, &mut self.forward.frame),
            None => Ok(0..count),
        }
    }

    /// Waits for the update of the rows where ranks share them, whose time decides who has how many.
    ///
    /// # Errors
    /// The driver's.
    pub fn end_update(&mut self) -> Result<()> {
        self.share.as_mut().map_or(Ok(()), Share::end_update)
    }

    /// Blending weight α·T of each Gaussian in a view, summed over its pixels, in single precision; a third is missing for each
    /// channel in which the colour is cut off at 0. Waits.
    pub fn blending_weights(
        &mut self,
        scene: &GaussianBuffers<R>,
        camera: &CameraArg<R>,
    ) -> Result<Vec<f32>> {
        let options = RenderOptions {
            sh_degree: scene.sh_degree,
            ..RenderOptions::default()
        };
        self.forward.render(scene, camera, &options)?;
        // The sum of the image's values: its derivative with respect to a colour is the weight.
        let size = camera.image();
        let ([width, height], [stride, rows]) = (size.pixels, size.padded());
        let mut ones = vec![R::of(0.0); 3 * stride * rows];
        for row in ones.chunks_exact_mut(stride).enumerate() {
            if row.0 % rows < height {
                row.1[..width].fill(R::of(1.0));
            }
        }
        self.dimage.write(0, &ones)?;
        let colors = [0, 1, 2].map(|channel| Plane::SH + channel);
        let degree = scene.sh_degree as usize;
        let forward = &self.forward;
        let gradients =
            self.backward
                .plane_gradients(forward, scene, &self.dimage, [0, degree], colors)?;
        let weight = |i: usize| gradients.iter().map(|g| g[i]).sum::<f64>() / (3.0 * C0);
        Ok((0..scene.count).map(|i| weight(i) as f32).collect())
    }

    /// Error maps of the pair whose errors were wanted last, and the number of their planes ([`Loss::error_maps`]).
    ///
    /// # Errors
    /// No room for them.
    pub fn error_maps(&self) -> Result<(&Array<R>, usize)> {
        Ok((self.loss.error_maps()?, self.loss.error_planes()))
    }

    /// Image gradient of the pair compared last.
    #[must_use]
    pub fn image_gradient(&self) -> &Array<R> {
        &self.dimage
    }
}
