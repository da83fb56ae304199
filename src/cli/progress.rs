//! Progress bar and summary of `mhsplat train`.

use std::io::IsTerminal;
use std::path::Path;
use std::sync::LazyLock;

use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::common::Common;
use crate::cli::output;
use mhsplat::base::error::Result;
use mhsplat::chart::text::about;
use mhsplat::run::{FinalRecord, Progress, RunRecord};

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

/// Display of a run's progress: a bar on a terminal, and a line for each evaluation where stderr goes elsewhere.
pub struct Display {
    bar: ProgressBar,
    terminal: bool,
    /// PSNR of the last line.
    shown: Option<f64>,
}

impl Display {
    /// An empty one.
    pub fn new() -> Self {
        let bar = ProgressBar::new(0);
        // What does not fit is cut off, not wrapped.
        if let Ok(style) = ProgressStyle::with_template("{bar:20} {percent}% {wide_msg}") {
            bar.set_style(style);
        }
        Self {
            bar,
            terminal: std::io::stderr().is_terminal(),
            shown: None,
        }
    }

    /// Shows the progress of training, and each decision that it takes.
    pub fn show(&mut self, p: &Progress) {
        if let Some(decided) = &p.decided {
            self.bar.suspend(|| output::note(decided));
        }
        if !self.terminal {
            if p.psnr.is_some() && p.psnr != self.shown {
                self.shown = p.psnr;
                output::note(&state(p));
            }
            return;
        }
        self.bar.set_length(u64::from(p.iterations));
        self.bar.set_position(u64::from(p.iteration));
        if p.iteration.is_multiple_of(10) {
            self.bar.set_message(state(p));
        }
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
        "{scores}; {} Gaussians; {} iterations in {:.1} s ({:.1} CPU s)\nscene: {}\nreport: {}",
        record.gaussians,
        record.iterations,
        record.train_seconds,
        record.cpu_seconds,
        dir.join("scene.ply").display(),
        dir.join("report.html").display(),
    ));
    Ok(())
}
