//! All scenes side by side: the first setting against each other one, run by run.

use serde::Serialize;

use crate::chart::text::fixed;
use crate::lab::compare::{Clock, Counts, FINAL_BELOW, Paired, Verdict, decibels};
use crate::lab::experiment::file::Experiment;
use crate::lab::experiment::scene::SceneSummary;
use crate::lab::stats::{Spread, geometric_mean};
use crate::lab::table::{Table, few, or_dash};

/// The reference against one other setting in one scene.
#[derive(Debug, Clone, Serialize)]
pub struct SceneAgainst {
    /// Name of the scene.
    pub scene: String,
    /// Clock of the times.
    pub clock: Option<Clock>,
    /// The figures; `None` if one of the two has no run.
    pub figures: Option<Paired>,
}

/// The reference against one other setting.
#[derive(Debug, Clone, Serialize)]
pub struct Against {
    /// The other setting.
    pub setting: String,
    /// Scene by scene.
    pub scenes: Vec<SceneAgainst>,
    /// Geometric mean of the scenes' means, of medians and of the ends of their ranges; its samples are the fewest of a scene.
    pub mean: Option<Spread>,
    /// Number of scenes in that mean.
    pub mean_of: usize,
    /// Thresholds of all scenes.
    pub counts: Counts,
    /// Scenes in which the reference is no later at every threshold.
    pub no_later: Verdict,
    /// Scenes in which the reference does not end below.
    pub final_holds: Verdict,
}

/// The first setting against all others. A time is that of the other setting over that of the reference: above 1, the reference
/// is sooner. A difference is that of the reference less that of the other.
#[derive(Debug, Clone, Serialize)]
pub struct Overview {
    /// The first setting.
    pub reference: String,
    /// Setting by setting.
    pub against: Vec<Against>,
}

impl Overview {
    /// The overview of all scenes; `None` without a second setting.
    pub(super) fn of(e: &Experiment, scenes: &[SceneSummary]) -> Option<Self> {
        let (first, others) = e.settings.split_first()?;
        let all = others
            .iter()
            .map(|s| against(&first.name, &s.name, scenes))
            .collect();
        (!others.is_empty()).then(|| Self {
            reference: first.name.clone(),
            against: all,
        })
    }

    /// One table per setting.
    pub(super) fn tables(&self) -> Vec<Table> {
        self.against.iter().map(|a| self.table(a)).collect()
    }

    fn table(&self, a: &Against) -> Table {
        let (reference, other) = (&self.reference, &a.setting);
        let time = format!("time of {other} / {reference}");
        let below = format!("≥ −{FINAL_BELOW} dB");
        let columns = [
            "scene",
            "pairs",
            &time,
            "worst",
            "no later",
            "Δ PSNR, dB",
            &below,
            "Δ SSIM",
            "Δ FLIP",
            "Gaussians",
            "values reached by",
        ];
        let scenes = |v: Verdict| match v.of {
            0 => "–".into(),
            _ => format!("{} scenes", v.text()),
        };
        let mut last = vec!["–".to_owned(); columns.len()];
        "geometric mean".clone_into(&mut last[0]);
        last[2] = or_dash(a.mean.as_ref(), |mean| {
            let all = a.scenes.len();
            format!("{}, {} of {all} scenes", few(mean, times), a.mean_of)
        });
        last[4] = scenes(a.no_later);
        last[6] = scenes(a.final_holds);
        last[10] = a.counts.text(reference, other);
        let rows = a.scenes.iter().map(|s| row(reference, other, s));
        Table::new(
            format!("{reference} against {other}"),
            format!(
                "Run by run, of the seeds that both have; median, and the range of three pairs and more. Time to equal PSNR of \
                 {other} over that of {reference}: above 1, {reference} is sooner; geometric mean over the values at which every pair \
                 has a ratio. Worst: the value at which {reference} does worst. Δ: final figure of {reference} less that of {other} \
                 (more PSNR and SSIM, and less FLIP, are better). \"No later\": {reference} in most pairs, at every value at which that \
                 is known; a finished run that has not reached a value never does."
            ),
            &columns,
            rows.chain([last]),
        )
    }
}

fn times(v: f64) -> String {
    fixed(v, 2)
}

fn row(reference: &str, other: &str, s: &SceneAgainst) -> Vec<String> {
    let Some(p) = &s.figures else {
        let mut row = vec!["–".to_owned(); 11];
        row[0].clone_from(&s.scene);
        "not compared".clone_into(&mut row[1]);
        return row;
    };
    let change = |s: Option<Spread>, decimals: usize| {
        let signed = |v: f64| {
            let plus = if v > 0.0 { "+" } else { "" };
            format!("{plus}{}", fixed(v, decimals))
        };
        or_dash(s, |s| few(&s, signed))
    };
    let worst = |(psnr, ratio): (f64, Option<f64>)| match ratio {
        Some(ratio) => format!("{} at {}", times(ratio), decibels(psnr)),
        None => format!("later or never at {}", decibels(psnr)),
    };
    vec![
        s.scene.clone(),
        p.pairs_text(),
        or_dash(p.mean.as_ref(), |m| few(m, times)),
        or_dash(p.worst, worst),
        p.no_later.text(),
        change(p.psnr, 2),
        or_dash(p.final_holds, |holds| {
            if holds { "yes" } else { "no" }.into()
        }),
        change(p.ssim, 4),
        change(p.flip, 4),
        or_dash(p.gaussians.as_ref(), |(own, others)| {
            let count = |s: &Spread| few(s, |v| fixed(v, 0));
            format!("{} against {}", count(own), count(others))
        }),
        p.counts.text(reference, other),
    ]
}

fn against(reference: &str, other: &str, scenes: &[SceneSummary]) -> Against {
    let one = |s: &SceneSummary| {
        let found = s.comparison.as_ref().filter(|c| c.reference == reference);
        let paired = found.and_then(|c| c.relative.iter().find(|p| p.label == other));
        SceneAgainst {
            scene: s.name.clone(),
            clock: s.comparison.as_ref().map(|c| c.clock),
            figures: paired.cloned(),
        }
    };
    let scenes: Vec<SceneAgainst> = scenes.iter().map(one).collect();
    let figures = || scenes.iter().filter_map(|s| s.figures.as_ref());
    let means: Vec<Spread> = figures().filter_map(|p| p.mean).collect();
    let mut counts = Counts::default();
    figures().for_each(|p| counts.join(&p.counts));
    Against {
        setting: other.to_owned(),
        mean: mean(&means),
        mean_of: means.len(),
        counts,
        no_later: Verdict::count(figures().map(|p| p.no_later.all())),
        final_holds: Verdict::count(figures().map(|p| p.final_holds)),
        scenes,
    }
}

/// Geometric means of medians and of the ends of the ranges.
fn mean(all: &[Spread]) -> Option<Spread> {
    let of = |pick: fn(&Spread) -> f64| {
        let figures: Vec<f64> = all.iter().map(pick).collect();
        geometric_mean(&figures)
    };
    Some(Spread {
        median: of(|s| s.median)?,
        min: of(|s| s.min)?,
        max: of(|s| s.max)?,
        samples: all.iter().map(|s| s.samples).min()?,
    })
}
