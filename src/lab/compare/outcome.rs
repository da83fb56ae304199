//! Figures of a group.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::lab::compare::curve::Crossing;
use crate::lab::compare::group::Group;
use crate::lab::compare::load::{Clock, Loaded};
use crate::lab::stats::Spread;

/// Shares of a run's own final PSNR that it is timed to.
pub const SHARES: [f64; 2] = [0.95, 0.98];

/// One run.
#[derive(Debug, Clone, Serialize)]
pub struct RunOutcome {
    /// Folder.
    pub path: String,
    /// Seed.
    pub seed: u64,
    /// True if the run came to its end.
    pub finished: bool,
    /// Iterations of the last evaluation.
    pub iterations: u32,
    /// Gaussians at the last evaluation, including those removed before it because no training view shows them.
    pub gaussians: u64,
    /// Mean PSNR of the last evaluation, dB.
    pub psnr: f64,
    /// Mean SSIM of the last evaluation.
    pub ssim: Option<f64>,
    /// Mean FLIP of the end; `None` for unfinished runs and those of earlier versions.
    pub flip: Option<f64>,
    /// CPU seconds at the last evaluation.
    pub cpu_seconds: f64,
    /// Seconds of training.
    pub train_seconds: f64,
    /// Seconds since the start.
    pub wall_seconds: f64,
}

impl RunOutcome {
    /// Reading of a clock at the last evaluation.
    #[must_use]
    pub fn last(&self, clock: Clock) -> f64 {
        match clock {
            Clock::Cpu => self.cpu_seconds,
            Clock::Train => self.train_seconds,
            Clock::Wall => self.wall_seconds,
            Clock::Iterations => f64::from(self.iterations),
        }
    }
}

/// Times at which the runs of a group first had a PSNR, by one clock.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reach {
    /// Clock of the times.
    pub clock: Clock,
    /// Run by run; null if it was not reached.
    pub runs: Vec<Option<Crossing>>,
    /// Spread over the runs, if all of them reached it.
    pub spread: Option<Spread>,
}

impl Reach {
    fn new(clock: Clock, runs: Vec<Option<Crossing>>) -> Self {
        let all: Option<Vec<f64>> = runs.iter().map(|r| r.map(|c| c.at)).collect();
        Self {
            clock,
            spread: all.and_then(|v| Spread::of(&v)),
            runs,
        }
    }

    /// Number of runs that reached it.
    #[must_use]
    pub fn reached(&self) -> usize {
        self.runs.iter().flatten().count()
    }

    /// Returns true if a run was there at its first evaluation already.
    #[must_use]
    pub fn at_most(&self) -> bool {
        self.runs.iter().flatten().any(|c| c.at_most)
    }
}

/// Times to one PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Target {
    /// PSNR, dB.
    pub psnr: f64,
    /// Clock by clock.
    pub reach: Vec<Reach>,
}

/// Times to a share of a run's own final PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Share {
    /// Share of the final PSNR in dB.
    pub share: f64,
    /// Clock by clock.
    pub reach: Vec<Reach>,
}

/// Samples of one thing.
#[derive(Debug, Clone, Serialize)]
pub struct GroupOutcome {
    /// Name.
    pub label: String,
    /// Different seeds among its runs.
    pub seeds: usize,
    /// Gaussians at the end.
    pub gaussians: Option<Spread>,
    /// Mean PSNR at the end, dB.
    pub psnr: Option<Spread>,
    /// Mean SSIM at the end.
    pub ssim: Option<Spread>,
    /// Mean FLIP at the end, if all runs have it.
    pub flip: Option<Spread>,
    /// CPU seconds at the end.
    pub cpu_seconds: Option<Spread>,
    /// Training seconds at the end.
    pub train_seconds: Option<Spread>,
    /// Wall seconds at the end.
    pub wall_seconds: Option<Spread>,
    /// Times to equal PSNR.
    pub to_psnr: Vec<Target>,
    /// Times to a share of a run's own final PSNR.
    pub to_share: Vec<Share>,
    /// The runs.
    pub runs: Vec<RunOutcome>,
}

impl GroupOutcome {
    /// Times to the threshold at `place`, by a clock.
    #[must_use]
    pub fn reach(&self, place: usize, clock: Clock) -> Option<&Reach> {
        let target = self.to_psnr.get(place)?;
        target.reach.iter().find(|r| r.clock == clock)
    }
}

fn of_run(run: &Loaded) -> RunOutcome {
    let last = run.rows.last().copied().unwrap_or_default();
    let scores = run.record.final_scores.as_ref();
    RunOutcome {
        path: run.source.path.display().to_string(),
        seed: run.record.seed,
        finished: run.finished(),
        iterations: last.iteration,
        gaussians: last.gaussians + run.record.removed,
        psnr: last.psnr.unwrap_or_default(),
        ssim: last.ssim,
        flip: scores.filter(|_| run.finished()).and_then(|f| f.flip),
        cpu_seconds: last.cpu_seconds,
        train_seconds: last.train_seconds,
        wall_seconds: last.wall_seconds,
    }
}

fn reach(members: &[&Loaded], psnr: impl Fn(&Loaded) -> Option<f64>) -> Vec<Reach> {
    let by = |clock: Clock| {
        let first = |r: &&Loaded| r.psnr(clock).first_reaches(psnr(r)?);
        Reach::new(clock, members.iter().map(first).collect())
    };
    let has = |c: &Clock| *c != Clock::Cpu || members.iter().all(|r| r.has_cpu());
    Clock::ALL.into_iter().filter(has).map(by).collect()
}

/// Figures of a group.
pub fn of_group(group: &Group, runs: &[Loaded], thresholds: &[f64]) -> GroupOutcome {
    let members: Vec<&Loaded> = group.runs.iter().map(|r| &runs[*r]).collect();
    let own: Vec<RunOutcome> = members.iter().map(|r| of_run(r)).collect();
    let spread = |of: &dyn Fn(&RunOutcome) -> Option<f64>| {
        let all: Option<Vec<f64>> = own.iter().map(of).collect();
        all.and_then(|v| Spread::of(&v))
    };
    let seeds: BTreeSet<u64> = own.iter().map(|r| r.seed).collect();
    let share = |share: f64| Share {
        share,
        reach: reach(&members, |r| {
            Some(share * r.psnr(Clock::Iterations).last()?)
        }),
    };
    let target = |psnr: &f64| Target {
        psnr: *psnr,
        reach: reach(&members, |_| Some(*psnr)),
    };
    GroupOutcome {
        label: group.label.clone(),
        seeds: seeds.len(),
        gaussians: spread(&|r| Some(r.gaussians as f64)),
        psnr: spread(&|r| Some(r.psnr)),
        ssim: spread(&|r| r.ssim),
        flip: spread(&|r| r.flip),
        cpu_seconds: spread(&|r| Some(r.cpu_seconds).filter(|s| *s > 0.0)),
        train_seconds: spread(&|r| Some(r.train_seconds)),
        wall_seconds: spread(&|r| Some(r.wall_seconds)),
        to_psnr: thresholds.iter().map(target).collect(),
        to_share: SHARES.map(share).to_vec(),
        runs: own,
    }
}
