//! Renders between iterations: by this device, or by all ranks while they share the Gaussians.

use crate::base::error::{Error, Result};
use crate::device::{Array, CameraArg};
use crate::pipeline::forward::{RenderOptions, Renderer, Renders};
use crate::train::crew::{LOOK, Words};
use crate::train::step::Trainer;

impl Renders for Trainer {
    fn render_view(&mut self, camera: &CameraArg<f32>, background: [f32; 3]) -> Result<()> {
        self.settle()?;
        if self.pipeline.share.is_none() {
            return (&self.gaussians.scene, &mut self.pipeline.forward)
                .render_view(camera, background);
        }
        let mut words = vec![LOOK];
        words.extend(background.map(f32::to_bits));
        Array::from_slice(&self.device, "camera", &[*camera])?.append_words(0, 1, &mut words)?;
        self.tell(words)?;
        self.render_band(camera, background)?;
        self.rest();
        Ok(())
    }

    fn renderer(&self) -> &Renderer {
        &self.pipeline.forward
    }
}

impl Trainer {
    /// Renders this rank's band of a view, of which the leader gets the image.
    fn render_band(&mut self, camera: &CameraArg<f32>, background: [f32; 3]) -> Result<()> {
        let scene = &self.gaussians.scene;
        let options = RenderOptions {
            sh_degree: scene.sh_degree,
            background,
            ..RenderOptions::default()
        };
        let forward = &mut self.pipeline.forward;
        let Some(share) = &mut self.pipeline.share else {
            return Err(Error::numerics("render", "no rows that ranks share"));
        };
        forward.frame.fit_image(&self.device, camera.image())?;
        share.divide_evenly(camera.image());
        share.render(forward, scene, camera, &options)?;
        share.show_leader(&mut forward.frame)
    }

    /// Renders this rank's band of a view that the leader looks at: background and camera.
    ///
    /// # Errors
    /// Words that are too few, another rank's failure, no room, or the driver's.
    pub(super) fn follow_look(&mut self, words: &[u32]) -> Result<()> {
        let mut words = Words(words);
        let background = words.take()?.map(f32::from_bits);
        let camera = Array::from_slice(&self.device, "camera", &[CameraArg::default()])?;
        let len = size_of::<CameraArg<f32>>() / size_of::<u32>();
        camera.write_words(0, words.some(len)?)?;
        self.render_band(&camera.read(0, 1)?[0], background)
    }
}
