//! Exposure compensation in the loop: when it is decided, and when its kernels are built.

use crate::base::error::Result;
use crate::device::{Defines, Kernels};
use crate::pipeline::exposure::ExposureModel;
use crate::train::exposure::compare;
use crate::train::plan::Exposure;
use crate::train::step::{Event, Next, Trainer};

impl Trainer {
    /// Compares photos with their renders if that is due, or says that kernels are to be compiled.
    pub(super) fn exposure_due(&mut self) -> Result<(Option<Event>, Next)> {
        let at = self.iteration;
        if at < self.schedule.exposure_from(at) {
            return Ok((None, Next::Iterate));
        }
        match self.plan.exposure.value {
            Exposure::Compare => {
                self.settle()?;
                let iterations = self.schedule.iterations(at);
                let (pipeline, scene) = (&mut self.pipeline, &self.gaussians.scene);
                let gains = compare(pipeline, scene, &self.views, at, iterations)?;
                self.learned.gains = Some(gains);
                let decision = self.plan.learn(&self.learned).into_iter().next();
                Ok((decision.map(Event::Decided), Next::Exposure))
            }
            Exposure::On if self.pipeline.exposure.is_none() => {
                self.settle()?;
                Ok((Some(Event::Compiling), Next::Compile))
            }
            _ => Ok((None, Next::Iterate)),
        }
    }

    /// Compiles the kernels of exposure compensation and runs each once; the transforms are the identity.
    pub(super) fn build_exposure(&mut self) -> Result<()> {
        let kernels = Kernels::new(&self.device, Defines::new(self.device.tuning()));
        let dimage = self.pipeline.image_gradient();
        let (views, plane) = (self.views.len(), dimage.len() / 3);
        let from = *self.learned.exposed_from.get_or_insert(self.iteration);
        let built = ExposureModel::new(&kernels, views, plane, from)?;
        let view = &self.pipeline.forward.frame;
        let step = self.transform_step(self.iteration);
        built.warm_up(&self.device, view, dimage, step)?;
        self.device.finish()?;
        self.pipeline.exposure = Some(built);
        Ok(())
    }
}
