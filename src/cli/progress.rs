//! Progress bar and summary of `mhsplat train`.

use std::io::IsTerminal;
use std::path::Path;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use crate::cli::common::Common;
use crate::cli::output;
use mhsplat::base::error::Result;
use mhsplat::chart::text::about;
use mhsplat::run::{FinalRecord, Progress, RunRecord, SCENE_PAGE};

/// Shows how many photos have been read, on a terminal.
pub fn reading(done: usize, all: usize) {
    static BAR: LazyLock<ProgressBar> = LazyLock::new(|| {
        let style = ProgressStyle::with_template("{bar:20} {pos} of {len} photos read");
        style.map_or_else(
            |_| ProgressBar::new(0),
            |s| ProgressBar::new(0).with_style(s),
        )
    });
    BAR.set_length(all as u64);
    BAR.set_position(done as u64);
    if done == all {
        BAR.finish_and_clear();
    }
}

/// Form in which a run tells its progress, on stderr.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Form {
    /// A bar on a terminal, lines elsewhere.
    #[default]
    Auto,
    /// A bar.
    Bar,
    /// A line for each evaluation, and at least one in half a minute.
    Log,
    /// The same lines as JSON objects.
    Json,
}

/// Longest time between two lines.
const SILENCE: Duration = Duration::from_secs(30);

/// Display of a run's progress.
pub struct Display {
    form: Form,
    bar: ProgressBar,
    /// PSNR of the last line, and when it was written.
    shown: (Option<f64>, Instant),
}

impl Display {
    /// An empty one.
    pub fn new(asked: Form) -> Self {
        let form = match (asked, std::io::stderr().is_terminal()) {
            (Form::Auto, true) => Form::Bar,
            (Form::Auto, false) => Form::Log,
            (form, _) => form,
        };
        let bar = match form {
            Form::Bar => ProgressBar::new(0),
            _ => ProgressBar::hidden(),
        };
        // What does not fit is cut off, not wrapped.
        if let Ok(style) = ProgressStyle::with_template("{bar:20} {percent}% {wide_msg}") {
            bar.set_style(style);
        }
        Self {
            form,
            bar,
            shown: (None, Instant::now()),
        }
    }

    /// Shows the progress of training, and each decision that it takes.
    pub fn show(&mut self, p: &Progress) {
        if let Some(decided) = p.decided.as_ref().filter(|_| self.form != Form::Json) {
            self.bar.suspend(|| output::info(decided));
        }
        if self.form != Form::Bar {
            self.line(p);
            return;
        }
        self.bar.set_length(u64::from(p.iterations));
        self.bar.set_position(u64::from(p.iteration));
        if p.iteration.is_multiple_of(10) {
            self.bar.set_message(state(p));
        }
    }

    /// Writes a line if there is an evaluation to tell of, or nothing has been said for long.
    fn line(&mut self, p: &Progress) {
        let (psnr, when) = self.shown;
        let evaluated = p.psnr.is_some() && p.psnr != psnr;
        let decided = p.decided.is_some() && self.form == Form::Json;
        if !evaluated && !decided && when.elapsed() < SILENCE {
            return;
        }
        self.shown = (p.psnr, Instant::now());
        output::info(&match self.form {
            Form::Json => json!({
                "iteration": p.iteration, "iterations": p.iterations, "gaussians": p.gaussians, "psnr": p.psnr,
                "train_seconds": p.train_seconds, "rate": p.rate, "left_seconds": p.left, "decided": p.decided,
            })
            .to_string(),
            _ => state(p),
        });
    }

    /// Ends the display, and leaves the bar where it is.
    pub fn end(&self) {
        self.bar.abandon();
    }
}

/// Progress in words, the most important first.
fn state(p: &Progress) -> String {
    let left = p.left.map(|s| format!("{} left", about(s)));
    let psnr = p.psnr.map(|v| format!("{v:.2} dB"));
    let rate = p.rate.map(|v| match v {
        v if v < 10.0 => format!("{v:.2} it/s"),
        v => format!("{v:.0} it/s"),
    });
    let parts = [
        Some(format!("{} of {}", p.iteration, p.iterations)),
        left,
        psnr,
        Some(format!("{} Gaussians", p.gaussians)),
        rate,
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// Prints the result of a run.
///
/// # Errors
/// A record that cannot be written as JSON.
pub fn finish(record: &RunRecord, dir: &Path, common: &Common) -> Result<()> {
    if common.json {
        return output::json(record);
    }
    let planned = record.config.last_iterations();
    if record.iterations < planned {
        let why = match record.stalled {
            Some(n) => {
                format!("the training loss had not fallen for {n} evaluations, which ended the run")
            }
            None => "the time budget ended the run".to_owned(),
        };
        output::note(&format!(
            "{why} after {} of {planned} iterations, before its schedules did",
            record.iterations
        ));
    }
    let scores = match &record.final_scores {
        None => "no held-out view".to_owned(),
        Some(FinalRecord { mean: f, .. }) => {
            let flip = f.flip.map(|v| format!(", FLIP {v:.4}"));
            let fitted = f.cc_psnr.zip(f.cc_ssim).map(|(psnr, ssim)| {
                format!("; colour-corrected PSNR {psnr:.2} dB, SSIM {ssim:.4}")
            });
            let [flip, fitted] = [flip, fitted].map(Option::unwrap_or_default);
            let (psnr, ssim) = (f.psnr, f.ssim);
            format!("held-out PSNR {psnr:.2} dB, SSIM {ssim:.4}{flip}{fitted}")
        }
    };
    output::line(&format!(
        "{scores}; {} Gaussians; {} iterations in {:.1} s ({:.1} CPU s)\nscene: {}\nto see it: {}\nreport: {}",
        record.gaussians,
        record.iterations,
        record.train_seconds,
        record.cpu_seconds,
        dir.join("scene.ply").display(),
        dir.join(SCENE_PAGE).display(),
        dir.join("report.html").display(),
    ));
    Ok(())
}
