//! The end of a run: removal of the Gaussians that no view shows, and the trace of density control.

use crate::base::error::{Error, Result};
use crate::device::Array;
use crate::pipeline::forward::RenderOptions;
use crate::ranks::{Part, bits_of, flags_of};
use crate::scene::Plane;
use crate::train::crew::{KEEP, SEEN, Words};
use crate::train::gaussians::Carried;
use crate::train::moves;
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
        let Some(seen) = self.seen_by_views()? else {
            return Ok(());
        };
        let kept: Vec<u32> = (0..seen.len() as u32)
            .filter(|&i| seen[i as usize])
            .collect();
        let removed = (seen.len() - kept.len()) as u64;
        if removed > 0 && !kept.is_empty() {
            self.keep(&kept, &seen)?;
            if let Some(trace) = &mut self.control.trace {
                trace.remove_unseen(self.iteration, &kept);
            }
            self.learned.removed = removed;
        }
        Ok(())
    }

    /// Flags of the Gaussians that the training views show; `None` if nobody asks.
    fn seen_by_views(&mut self) -> Result<Option<Vec<bool>>> {
        let views = self.views.len();
        let division = match (&self.crew, &self.pipeline.share) {
            (Some(crew), Some(_)) if self.seen.is_some() => crew.division().to_vec(),
            _ => {
                let seen = self.seen(views)?;
                return Ok(seen.map(|flags| flags.into_iter().map(|flag| flag != 0).collect()));
            }
        };
        self.tell(vec![SEEN])?;
        let mut seen = Vec::new();
        for (message, of) in self.tell_seen()?.iter().zip(division.windows(2)) {
            seen.extend(flags_of(message, of[1] - of[0])?);
        }
        self.rest();
        Ok(Some(seen))
    }

    /// Tells the leader which of the rows here any training view shows, in bands that all ranks render; returns what all have told, which is
    /// nothing at the others.
    ///
    /// # Errors
    /// Another rank's failure, no room, or the driver's.
    pub(super) fn tell_seen(&mut self) -> Result<Vec<Vec<u32>>> {
        let (scene, forward) = (&self.gaussians.scene, &mut self.pipeline.forward);
        let (Some(stage), Some(share)) = (&self.seen, &mut self.pipeline.share) else {
            return Err(Error::numerics(
                "seen",
                "no kernel or no rows that ranks share",
            ));
        };
        let options = RenderOptions {
            sh_degree: scene.sh_degree,
            ..RenderOptions::default()
        };
        let mut seen = vec![false; scene.count];
        for camera in &self.views.set.cameras {
            share.divide_evenly(camera.image());
            share.render(forward, scene, camera, &options)?;
            let shown = share.return_flags(&forward.shown(stage, &seen)?)?;
            seen.iter_mut()
                .zip(shown)
                .for_each(|(seen, shown)| *seen |= shown);
        }
        share.tell_leader(Part::Evidence, bits_of(&seen))
    }

    /// Keeps some of all Gaussians, in their order, of which `flags` are true.
    fn keep(&mut self, kept: &[u32], flags: &[bool]) -> Result<()> {
        let Some(crew) = self.crew.as_mut().filter(|_| self.pipeline.share.is_some()) else {
            let order = Array::from_slice(&self.device, "row order", kept)?;
            let (stage, kept) = (self.control.edit(), (&order, kept.len()));
            return self
                .gaussians
                .reorder(&self.device, stage, kept, Carried::All);
        };
        let before = crew.division().to_vec();
        let after = crew.divide_rows(kept.len());
        let divisions = [before, after].concat();
        let mut words = vec![KEEP];
        words.extend(divisions.iter().map(|row| *row as u32));
        words.extend(bits_of(flags));
        self.tell(words.clone())?;
        self.follow_keep(&words[1..])?;
        self.rest();
        Ok(())
    }

    /// Keeps those of the rows of all ranks that the leader names, and takes this rank's part of them.
    ///
    /// # Errors
    /// Words that are too few, another rank's failure, no room, or the driver's.
    pub(super) fn follow_keep(&mut self, words: &[u32]) -> Result<()> {
        let Some(share) = &self.pipeline.share else {
            return Err(Error::numerics("keep", "no rows that ranks share"));
        };
        let mut words = Words(words);
        let mut division = || -> Result<Vec<usize>> {
            let bounds = words.some(share.ranks() + 1)?;
            Ok(bounds.iter().map(|row| *row as usize).collect())
        };
        let (before, after) = (division()?, division()?);
        let flags = flags_of(words.0, before[share.ranks()])?;
        let kept = (0..).zip(flags).filter(|(_, flag)| *flag);
        let kept: Vec<u32> = kept.map(|(row, _)| row).collect();
        let counts = before.windows(2).map(|of| of[1] - of[0]).collect();
        let on = (&self.device, &mut self.gaussians, self.control.edit());
        moves::keep(share, on, counts, (&kept, &after))
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
        self.gather()?;
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
