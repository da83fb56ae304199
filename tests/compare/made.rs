//! Made-up runs: PSNR rises from 12 to about 25 dB over 1000 iterations and 50 CPU seconds.

use std::path::{Path, PathBuf};

use crate::report::samples::scores;
use mhsplat::base::error::Result;
use mhsplat::config::{Sampler, TrainConfig};
use mhsplat::evaluate::ViewScore;
use mhsplat::lab::compare::{Comparison, Options, Source, compare};
use mhsplat::run::PlanRecord;
use mhsplat::run::*;

#[derive(Clone)]
pub struct Made {
    pub name: String,
    pub group: Option<String>,
    pub record: RunRecord,
    pub rows: Vec<MetricsRow>,
}

fn row(step: u32, seed: u64) -> MetricsRow {
    let t = f64::from(step) / 20.0;
    // Seeds differ a little in speed and height.
    let share = 1.0 + 0.01 * seed as f64;
    let seconds = 50.0 * t * share;
    MetricsRow {
        iteration: 50 * step,
        train_seconds: 0.6 * seconds,
        wall_seconds: 0.7 * seconds,
        cpu_seconds: seconds,
        psnr: Some(12.0 + 13.5 * (1.0 - (-4.0 * t).exp()) - 0.1 * share),
        ssim: Some(0.9 - 0.5 * (-4.0 * t).exp()),
        gaussians: 1000 + u64::from(10 * step),
        ..MetricsRow::default()
    }
}

/// A finished run of mh.
pub fn run(name: &str, seed: u64) -> Made {
    let rows: Vec<MetricsRow> = (1..=20).map(|s| row(s, seed)).collect();
    let config = TrainConfig {
        seed,
        iterations: 1000,
        ..TrainConfig::default()
    };
    let dataset = DatasetRecord {
        path: "scenes/room".into(),
        layout: "colmap-bin".into(),
        train_views: 35,
        test_views: 5,
        width: 96,
        height: 72,
        missing: Vec::new(),
        outliers: Vec::new(),
        masked_out: Vec::new(),
        fingerprint: Some("0123456789abcdef".into()),
        capture: None,
    };
    let mut record = RunRecord::new(
        config,
        dataset,
        DeviceRecord::default(),
        PlanRecord::default(),
    );
    let last = rows[19];
    record.iterations = 1000;
    (record.gaussians, record.train_seconds) = (last.gaussians, last.train_seconds);
    record.final_scores = Some(FinalRecord {
        mean: scores(last.psnr.unwrap(), last.ssim.unwrap(), 0.1),
        per_view: vec![ViewScore {
            view: "one.png".into(),
            scores: scores(25.0, 0.9, 0.1),
        }],
    });
    Made {
        name: name.into(),
        group: None,
        record,
        rows,
    }
}

impl Made {
    pub fn with(mut self, change: impl Fn(&mut RunRecord)) -> Self {
        change(&mut self.record);
        self
    }

    pub fn sampler_none(self) -> Self {
        self.with(|r| r.config.sampler = Sampler::None)
    }

    pub fn iterations(self, n: u32) -> Self {
        self.with(|r| (r.config.iterations, r.iterations) = (n, n))
    }

    pub fn named(mut self, group: &str) -> Self {
        self.group = Some(group.into());
        self
    }

    /// CPU seconds times a factor.
    pub fn slower(mut self, factor: f64) -> Self {
        self.rows.iter_mut().for_each(|r| r.cpu_seconds *= factor);
        self
    }

    /// PSNR less so many dB, from the second evaluation on.
    pub fn below(mut self, decibels: f64) -> Self {
        for r in self.rows.iter_mut().skip(1) {
            r.psnr = r.psnr.map(|p| p - decibels);
        }
        self
    }

    /// The first so many evaluations.
    pub fn rows(mut self, n: usize) -> Self {
        self.rows.truncate(n);
        self
    }

    /// A run folder below `dir`.
    pub fn write(&self, dir: &Path) -> PathBuf {
        let folder = dir.join(&self.name);
        std::fs::create_dir_all(&folder).unwrap();
        self.record.write(&folder).unwrap();
        let mut table = MetricsWriter::open(folder.join("metrics.csv"), None).unwrap();
        self.rows.iter().for_each(|r| table.write(r).unwrap());
        folder
    }
}

/// The runs, each in a folder of its own, compared.
pub fn compared(made: &[Made], options: &Options) -> Result<Comparison> {
    let dir = tempfile::tempdir().unwrap();
    let source = |(place, m): (usize, &Made)| Source {
        group: m.group.clone(),
        path: m.write(&dir.path().join(place.to_string())),
    };
    let sources: Vec<Source> = made.iter().enumerate().map(source).collect();
    compare(&sources, options)
}
