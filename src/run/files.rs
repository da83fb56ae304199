//! What a run writes into its folder.

use crate::base::error::Result;
use crate::run::checkpoint::Checkpoint;
use crate::run::density_log::read_density;
use crate::run::metrics::read_rows;
use crate::run::record::StageRecord;
use crate::run::report::page::write_report;
use crate::run::{Run, checkpoint, clock};
use crate::scene::ply;

impl Run {
    pub(super) fn write_record(&mut self) -> Result<()> {
        let now = self.clock.reading();
        let stages = self.stage_times();
        let mut plan = self.plan.observed(&self.config, self.trainer.findings());
        if let Some(decision) = self.trainer.exposure_decision() {
            plan.exposure_decided(decision);
        }
        let r = &mut self.record;
        r.plan = plan;
        r.iterations = self.trainer.iteration();
        r.gaussians = self.trainer.gaussians() as u64;
        r.removed = self.trainer.findings().removed;
        r.train_seconds = now.train_seconds;
        r.wall_seconds = now.wall_seconds;
        r.cpu_seconds = now.cpu_seconds;
        r.peak_rss_bytes = clock::peak_rss_bytes();
        r.density = *self.trainer.stats();
        r.photos = self.trainer.photo_stats();
        r.stages = stages;
        r.write(&self.dir)
    }

    /// Seconds per stage over all sessions of the run.
    fn stage_times(&self) -> Vec<StageRecord> {
        let now = self.trainer.stage_times().into_iter();
        now.map(|(name, t)| {
            let before = self.stages.iter().find(|s| s.name == name);
            StageRecord {
                name: name.into(),
                seconds: t.seconds + before.map_or(0.0, |s| s.seconds),
                calls: t.calls + before.map_or(0, |s| s.calls),
            }
        })
        .collect()
    }

    pub(super) fn export(&mut self) -> Result<()> {
        self.clock.pause();
        let state = self.trainer.state()?;
        let path = self.dir.join("scene.ply");
        ply::write_filtered(&path, &state.splats, &state.filter, &self.frame)?;
        self.clock.resume();
        Ok(())
    }

    pub(super) fn checkpoint(&mut self) -> Result<()> {
        self.clock.pause();
        let saved = Checkpoint {
            state: self.trainer.state()?,
            config: self.config.clone(),
            clock: self.clock.reading(),
            dataset: self.fingerprint.clone(),
            tuning: self.trainer.tuning(),
            stages: self.stage_times(),
        };
        checkpoint::write(&self.dir, &saved)?;
        self.saved = Some(saved.state.iteration);
        self.clock.resume();
        Ok(())
    }

    pub(super) fn report(&mut self) -> Result<()> {
        self.clock.pause();
        let gallery = self.gallery()?;
        let rows = read_rows(self.dir.join("metrics.csv"))?;
        let density = read_density(self.dir.join("density.csv"))?;
        write_report(&self.dir, &self.record, &rows, &density, &gallery)?;
        self.clock.resume();
        Ok(())
    }
}
