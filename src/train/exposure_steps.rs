//! Exposure compensation in the loop: when it is decided, and when its kernels are built.

use crate::base::error::Result;
use crate::capture::photo::colors;
use crate::device::{Defines, Kernels};
use crate::pipeline::exposure::ExposureModel;
use crate::pipeline::forward::Renders;
use crate::train::brightness::{GainSpread, compared, gain};
use crate::train::crew::EXPOSE;
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
                self.learned.gains = Some(self.compare()?);
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

    /// Compares some training views with their renders.
    fn compare(&mut self) -> Result<GainSpread> {
        let at = self.iteration;
        let numbers = compared(self.views.len(), self.schedule.iterations(at));
        let mut gains = Vec::with_capacity(numbers.len());
        for number in numbers {
            let view = self.views.view(at, at, number, &[])?;
            self.render_view(&view.camera, view.background)?;
            let render = self.pipeline.forward.read_image()?;
            let (alpha, pixels) = (self.views.set.alpha, render.width * render.height);
            let bytes = view.photo.read(0, alpha.planes() * pixels)?;
            let photo = colors(alpha, &bytes, view.background);
            gains.extend(gain(&render.rgb, &render.transmittance, &photo));
        }
        Ok(GainSpread::new(at, &gains))
    }

    /// Compiles the kernels of exposure compensation, which begins now, at all ranks.
    pub(super) fn begin_exposure(&mut self) -> Result<()> {
        let from = *self.learned.exposed_from.get_or_insert(self.iteration);
        self.tell(vec![EXPOSE, from])?;
        self.rest();
        self.build_exposure()
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
