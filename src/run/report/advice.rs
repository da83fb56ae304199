//! Advice in words: what the figures of a run say about the next one.

use std::fmt::Write;

use crate::chart::text::{escape, fixed, grouped};
use crate::run::record::{FinalRecord, RunRecord};
use crate::run::table::MetricsRow;

/// Rise of PSNR over a doubling of the iterations from which on a longer run is advised, dB, and the shares of the run that are
/// compared: before the rates settle.
const RISE: f64 = 0.3;
const DOUBLING: [f64; 2] = [0.35, 0.7];

/// Largest distance of an evaluation from these shares.
const APART: f64 = 0.08;

/// Fall of PSNR from its best evaluation that is told, dB.
const FALL: f64 = 0.3;

/// Difference of training views from held-out ones that is told, dB.
const BY_HEART: f64 = 6.0;

/// Difference of a view from the mean that is told, dB.
const WORSE: f64 = 5.0;

/// Gain by the colour fit that is told, dB.
const FITTED: f64 = 1.0;

/// PSNR below which the poses are suspected, dB.
const POOR: f64 = 17.0;

/// Writes a list of what the figures say, if they say anything.
pub(super) fn section(out: &mut String, record: &RunRecord, rows: &[MetricsRow]) {
    let scores = record.final_scores.as_ref();
    let said = [
        course(record, rows),
        by_heart(record),
        capped(record),
        scores.and_then(worst),
        scores.and_then(|scores| colors(record, scores)),
        scores.and_then(poor),
        absent(record),
    ];
    let said: Vec<String> = said.into_iter().flatten().collect();
    if said.is_empty() {
        return;
    }
    out.push_str("<h2>What these figures say</h2><ul>\n");
    for sentence in said {
        let _ = writeln!(out, "<li>{}</li>", escape(&sentence));
    }
    out.push_str("</ul>\n");
}

/// Scores that still rose, or that were better before.
fn course(record: &RunRecord, rows: &[MetricsRow]) -> Option<String> {
    let scored: Vec<(u32, f64)> = rows
        .iter()
        .filter_map(|r| r.psnr.map(|v| (r.iteration, v)))
        .collect();
    let (end, last) = scored.last().copied().filter(|l| l.0 > 0)?;
    let best = scored.iter().max_by(|a, b| a.1.total_cmp(&b.1)).copied()?;
    if best.1 - last >= FALL {
        return Some(format!(
            "Held-out PSNR was {} dB higher after {} iterations: since then training has learnt its own photos by heart. A shorter run \
             (--iterations {}), fewer Gaussians (--max-gaussians) or more photos would serve better.",
            fixed(best.1 - last, 1),
            grouped(best.0.into()),
            best.0
        ));
    }
    // Where photos were small in the first of the two, PSNR has risen by their size.
    let small = record.full_size_from as f64 > DOUBLING[0] * f64::from(end);
    if record.stalled.is_some() || small {
        return None;
    }
    let at = |share: f64| {
        let wanted = share * f64::from(end);
        let distance = |row: &&(u32, f64)| (f64::from(row.0) - wanted).abs();
        let near = scored
            .iter()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)));
        near.filter(|row| distance(row) <= APART * f64::from(end))
            .copied()
    };
    let (from, to) = (at(DOUBLING[0])?, at(DOUBLING[1])?);
    (to.1 - from.1 >= RISE).then(|| {
        format!(
            "PSNR rose by {} dB from {} to {} iterations: a run twice as long may bring about as much again.",
            fixed(to.1 - from.1, 1),
            grouped(from.0.into()),
            grouped(to.0.into())
        )
    })
}

/// Training views that look far better than held-out ones.
fn by_heart(record: &RunRecord) -> Option<String> {
    let (training, held_out) = (record.training?, record.final_scores.as_ref()?.mean.psnr);
    (training.psnr - held_out >= BY_HEART).then(|| {
        format!(
            "Training views have {} dB, held-out ones {}: photos are too few or too far apart for places between them. More photos \
             help, more iterations do not.",
            fixed(training.psnr, 1),
            fixed(held_out, 1)
        )
    })
}

/// A number of Gaussians that was held down, unless photos are too few for more.
fn capped(record: &RunRecord) -> Option<String> {
    let most = record.config.max_gaussians? as u64;
    let reached = record.gaussians + record.removed >= most;
    (reached && by_heart(record).is_none()).then(|| {
        format!(
            "--max-gaussians {most} was reached: more would show finer detail, for more time and memory."
        )
    })
}

/// A view much worse than the others.
fn worst(scores: &FinalRecord) -> Option<String> {
    let views = scores.per_view.iter();
    let worst = views.min_by(|a, b| a.scores.psnr.total_cmp(&b.scores.psnr))?;
    let below = scores.mean.psnr - worst.scores.psnr;
    (below >= WORSE).then(|| {
        format!(
            "{} is {} dB below the mean: look at it. It may show what no training view does, be blurred, or be taken in other light.",
            worst.view,
            fixed(below, 1)
        )
    })
}

/// Errors that are a matter of brightness.
fn colors(record: &RunRecord, scores: &FinalRecord) -> Option<String> {
    let gain = scores.mean.cc_psnr? - scores.mean.psnr;
    (gain >= FITTED).then(|| {
        format!(
            "{} dB of the error of {} is brightness and colour: held-out photos were taken in other light than the scene is shown in.",
            fixed(gain, 1),
            if record.dataset.test_views == 1 { "the held-out view" } else { "held-out views" }
        )
    })
}

/// Scores so low that the photos do not fit the cameras.
fn poor(scores: &FinalRecord) -> Option<String> {
    (scores.mean.psnr < POOR).then(|| {
        "Scores are so low that photos and cameras may not belong together: look at the renders. Do the poses come from these photos, and \
         did structure from motion take all of them into one model?"
            .to_owned()
    })
}

/// Photos that the model names and nobody has.
fn absent(record: &RunRecord) -> Option<String> {
    let missing = record.dataset.missing.len();
    (missing > 0).then(|| {
        format!("{missing} photos that the model names were not found (run.json lists them).")
    })
}
