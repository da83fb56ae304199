//! The end of a run: removal of the Gaussians that no view shows, and the trace of density control.

use crate::base::error::Result;
use crate::scene::Plane;
use crate::train::plan::Decision;
use crate::train::step::Trainer;
use crate::train::trace::DensityTrace;

impl Trainer {
    /// Ends the run: removes the Gaussians that no training view shows, if the configuration says so. Once per run.
    pub fn finish(&mut self) -> Result<Option<Decision>> {
        self.settle()?;
        if self.learned.finished == Some(self.iteration) {
            return Ok(None);
        }
        self.learned.removed = 0;
        self.remove_unseen()?;
        self.learned.finished = Some(self.iteration);
        let decision = self.plan.learn(&self.learned).pop();
        self.fit_views()?;
        Ok(decision)
    }

    /// Removes the Gaussians that no pixel of any training view shows: behind, beyond, below the cut or hidden in all of them.
    /// The others render every training view to the same bit.
    fn remove_unseen(&mut self) -> Result<()> {
        let Some(seen) = self.seen(self.views.len())? else {
            return Ok(());
        };
        let kept: Vec<u32> = (0..seen.len() as u32)
            .filter(|&i| seen[i as usize] != 0)
            .collect();
        let removed = (seen.len() - kept.len()) as u64;
        if removed > 0 && !kept.is_empty() {
            self.gaussians
                .keep(&self.device, self.control.edit(), &kept)?;
            if let Some(trace) = &mut self.control.trace {
                trace.remove_unseen(self.iteration, &kept);
            }
            self.learned.removed = removed;
        }
        Ok(())
    }

    /// The trace of density control with the opacity and the summed blending weight of every Gaussian now; `None` unless the
    /// configuration asks for it, and after a resumption. Renders every training view.
    ///
    /// # Errors
    /// The driver's.
    pub fn density_trace(&mut self) -> Result<Option<&DensityTrace>> {
        if self.control.trace.is_none() {
            return Ok(None);
        }
        self.settle()?;
        let scene = &self.gaussians.scene;
        let logits = scene.plane(Plane::OPACITY)?;
        let mut sums = vec![0.0; scene.count];
        for camera in &self.views.set.cameras {
            let weights = self.pipeline.blending_weights(scene, camera)?;
            for (sum, weight) in sums.iter_mut().zip(weights) {
                *sum += weight;
            }
        }
        if let Some(trace) = &mut self.control.trace {
            trace.finish(&logits, &sums);
        }
        Ok(self.control.trace.as_ref())
    }

    /// Flags of the Gaussians that the first `views` training views show, 1 or 0; `None` if nobody asks.
    pub(super) fn seen(&mut self, views: usize) -> Result<Option<Vec<u32>>> {
        let Some(stage) = &self.seen else {
            return Ok(None);
        };
        let cameras = &self.views.set.cameras[..views];
        let forward = &mut self.pipeline.forward;
        forward
            .seen(stage, &self.gaussians.scene, cameras)
            .map(Some)
    }
}
