//! Progress bar and summary of `mhsplat train`.

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::common::Common;
use crate::cli::output;
use mhsplat::base::error::Result;
use mhsplat::run::{FinalRecord, Progress, RunRecord};

/// Returns an empty progress bar.
pub fn progress_bar() -> ProgressBar {
    let bar = ProgressBar::new(0);
    let style = "{bar:24} {pos}/{len} {per_sec} {msg} {eta} left";
    if let Ok(style) = ProgressStyle::with_template(style) {
        bar.set_style(style);
    }
    bar
}

/// Shows the progress of training, and each decision that it takes.
pub fn show(bar: &ProgressBar, p: &Progress) {
    if let Some(decided) = &p.decided {
        bar.suspend(|| output::note(decided));
    }
    bar.set_length(u64::from(p.iterations));
    bar.set_position(u64::from(p.iteration));
    if p.iteration.is_multiple_of(10) {
        let psnr = p.psnr.map_or_else(String::new, |v| format!("{v:.2} dB, "));
        bar.set_message(format!(
            "{psnr}{} Gaussians, {:.0} s,",
            p.gaussians, p.train_seconds
        ));
    }
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
