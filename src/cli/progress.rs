//! Progress bar and summary of `mhsplat train`.

use std::io::IsTerminal;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{LazyLock, Mutex};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use console::Term;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use crate::cli::common::Common;
use crate::cli::output;
use mhsplat::base::error::Result;
use mhsplat::chart::text::about;
use mhsplat::run::{FinalRecord, Progress, RunRecord, SCENE_PAGE};

/// True if progress is told in JSON objects.
static OBJECTS: AtomicBool = AtomicBool::new(false);

/// Keeps [`reading`] from telling anything but JSON objects.
pub fn tell_objects() {
    OBJECTS.store(true, Ordering::Relaxed);
}

/// Shows how many photos have been read: a bar on a terminal, elsewhere a line each time that half a minute has passed.
pub fn reading(done: usize, all: usize) {
    static SAID: LazyLock<Mutex<Instant>> = LazyLock::new(|| Mutex::new(Instant::now()));
    if output::is_quiet() {
        return;
    }
    if OBJECTS.load(Ordering::Relaxed) || !std::io::stderr().is_terminal() {
        let Ok(mut said) = SAID.lock() else {
            return;
        };
        if said.elapsed() >= SILENCE && done < all {
            *said = Instant::now();
            output::info(&match OBJECTS.load(Ordering::Relaxed) {
                true => json!({ "photos_read": done, "photos": all }).to_string(),
                false => format!("{done} of {all} photos read"),
            });
        }
        return;
    }
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
        if let Ok(style) = ProgressStyle::with_template("{bar:6} {percent:>3}% {wide_msg}") {
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
            let columns = usize::from(Term::stderr().size().1);
            self.bar
                .set_message(fitting(p, columns.saturating_sub(BESIDE)));
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
                "iteration": p.iteration, "iterations": p.iterations, "gaussians": p.gaussians, "psnr": p.psnr, "loss": p.loss,
                "train_seconds": p.train_seconds, "rate": p.rate, "left_seconds": p.left, "decided": p.decided,
            })
            .to_string(),
            _ => fitting(p, usize::MAX),
        });
    }

    /// Ends the display, and leaves the bar where it is.
    pub fn end(&self) {
        self.bar.abandon();
    }
}

/// Columns that the bar and the percentage take.
const BESIDE: usize = 12;

/// Progress in words, within so many columns: what counts least is left out where there is no room.
fn fitting(p: &Progress, columns: usize) -> String {
    let rate = |v: f64| match v {
        v if v < 10.0 => format!("{v:.2} it/s"),
        v => format!("{v:.0} it/s"),
    };
    let count = match p.gaussians {
        n if n < 10_000 => n.to_string(),
        n if n < 1_000_000 => format!("{}k", n / 1000),
        n => format!("{:.2}M", n as f64 / 1e6),
    };
    // In their order on the line, each with its rank among those that are left out first.
    let mut parts: Vec<(u32, String)> = [
        (0, Some(format!("{}/{}", p.iteration, p.iterations))),
        (1, p.psnr.map(|v| format!("{v:.2} dB"))),
        (5, p.loss.map(|v| format!("loss {v:.3}"))),
        (4, Some(format!("{count} Gaussians"))),
        (3, p.rate.map(rate)),
        (2, p.left.map(|s| format!("{} left", about(s)))),
    ]
    .into_iter()
    .filter_map(|(rank, part)| Some((rank, part?)))
    .collect();
    let line = |parts: &[(u32, String)]| {
        let words: Vec<&str> = parts.iter().map(|(_, part)| part.as_str()).collect();
        words.join(", ")
    };
    while parts.len() > 1 && line(&parts).len() > columns {
        let least = parts.iter().map(|part| part.0).max();
        parts.retain(|part| Some(part.0) != least);
    }
    line(&parts)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_fits_a_terminal() {
        let mut p = Progress {
            iteration: 3500,
            iterations: 7000,
            gaussians: 24_321,
            psnr: Some(29.412),
            loss: Some(0.0312),
            train_seconds: 77.0,
            rate: Some(45.2),
            left: Some(720.0),
            decided: None,
        };
        let whole = "3500/7000, 29.41 dB, loss 0.031, 24k Gaussians, 45 it/s, 12 min left";
        assert_eq!(fitting(&p, 80 - BESIDE), whole);
        let shorter = "3500/7000, 29.41 dB, 24k Gaussians, 45 it/s, 12 min left";
        assert_eq!(fitting(&p, whole.len() - 1), shorter);
        assert_eq!(fitting(&p, 30), "3500/7000, 29.41 dB");
        assert_eq!(fitting(&p, 0), "3500/7000");
        // Nothing of a long run is lost but the loss.
        (p.iteration, p.iterations, p.gaussians) = (29_999, 30_000, 1_234_567);
        let long = fitting(&p, 80 - BESIDE);
        assert!(
            long.ends_with("1.23M Gaussians, 45 it/s, 12 min left"),
            "{long}"
        );
    }
}
