//! All scenes side by side: the other settings against the first, seed by seed.

use serde::Serialize;

use crate::chart::text::fixed;
use crate::lab::compare;
use crate::lab::compare::Clock;
use crate::lab::compare::{Bounded, Counts};
use crate::lab::compare::{FINAL_BELOW, Paired, Verdict, few};
use crate::lab::experiment::file::Experiment;
use crate::lab::experiment::summary::SceneSummary;
use crate::lab::stats::Spread;
use crate::lab::table::Table;

/// The reference against one other setting in one scene.
#[derive(Debug, Clone, Serialize)]
pub struct SceneAgainst {
    /// The scene.
    pub scene: String,
    /// What times are told by.
    pub clock: Option<Clock>,
    /// The figures; none where the two have no seed in common.
    pub figures: Option<Paired>,
}

/// The reference against one other setting.
#[derive(Debug, Clone, Serialize)]
pub struct Against {
    /// The other setting.
    pub setting: String,
    /// By scene.
    pub scenes: Vec<SceneAgainst>,
    /// Geometric mean of the scenes' means, of medians and of the ends of their ranges; its samples are the fewest of a scene.
    pub mean: Option<Spread>,
    /// Of how many scenes.
    pub mean_of: usize,
    /// Thresholds of all scenes.
    pub counts: Counts,
    /// Geometric mean of the scenes' bounded means.
    pub bounded: Option<Bounded>,
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
    /// By setting.
    pub against: Vec<Against>,
}

impl Overview {
    /// Of all scenes; none without a second setting.
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
        let columns = [
            "scene".to_owned(),
            "seeds".into(),
            format!("time of {other} / {reference}"),
            "worst".into(),
            "no later".into(),
            "Δ PSNR, dB".into(),
            format!("≥ −{FINAL_BELOW} dB"),
            "Δ SSIM".into(),
            "Δ FLIP".into(),
            "Gaussians".into(),
            "bounded mean".into(),
            "values reached by".into(),
        ];
        let mut rows: Vec<Vec<String>> =
            a.scenes.iter().map(|s| row(reference, other, s)).collect();
        let mut last = vec!["–".to_owned(); columns.len()];
        "geometric mean".clone_into(&mut last[0]);
        if let Some(mean) = &a.mean {
            last[1] = seeds(mean.samples);
            last[2] = format!(
                "{}, {} of {} scenes",
                few(mean, times),
                a.mean_of,
                a.scenes.len()
            );
        }
        last[4] = scenes_text(a.no_later);
        last[6] = scenes_text(a.final_holds);
        if let Some(mean) = &a.bounded {
            last[10] = compare::bounded(mean);
        }
        last[11] = a.counts.text(reference, other);
        rows.push(last);
        Table {
            title: format!("{reference} against {other}"),
            note: format!(
                "Of the seeds that both have, seed by seed; median, and the range where they are three and more. Time to equal \
                 PSNR of {other} over that of {reference}: above 1, {reference} is sooner; geometric mean over the values that \
                 both reach with all seeds. In the bounded mean the side that has not reached a value counts with the last \
                 reading of its clock; values that neither reaches are left out. Worst: the lowest ratio of a value. Δ: final \
                 figure of {reference} less that of {other} (more PSNR and SSIM, and less FLIP, are better). \"No later\": \
                 {reference} at every value at which it is known, where a finished run that has not reached a value never does."
            ),
            columns: columns.to_vec(),
            rows,
        }
    }
}

fn times(v: f64) -> String {
    fixed(v, 2)
}

fn seeds(n: usize) -> String {
    match n {
        1 => "1 seed".into(),
        n => format!("{n} seeds"),
    }
}

fn scenes_text(v: Verdict) -> String {
    match v.of {
        0 => "–".into(),
        _ => format!("{} scenes", v.text()),
    }
}

fn row(reference: &str, other: &str, s: &SceneAgainst) -> Vec<String> {
    let Some(p) = &s.figures else {
        let mut row = vec!["–".to_owned(); 12];
        row[0].clone_from(&s.scene);
        "no seed of both".clone_into(&mut row[1]);
        return row;
    };
    let none = || "–".to_owned();
    let change = |s: &Option<Spread>, decimals: usize| {
        let signed = |v: f64| {
            let plus = if v > 0.0 { "+" } else { "" };
            format!("{plus}{}", fixed(v, decimals))
        };
        s.as_ref().map_or_else(none, |s| few(s, signed))
    };
    let worst = p.worst.map(|(psnr, limit)| {
        let at = compare::decibels(psnr);
        format!("{} at {at}", compare::limit(&limit))
    });
    vec![
        s.scene.clone(),
        seeds(p.seeds.len()),
        p.mean.as_ref().map_or_else(none, |m| few(m, times)),
        worst.unwrap_or_else(none),
        p.no_later.text(),
        change(&p.psnr, 2),
        match p.final_holds {
            None => none(),
            Some(true) => "yes".into(),
            Some(false) => "no".into(),
        },
        change(&p.ssim, 4),
        change(&p.flip, 4),
        p.gaussians.as_ref().map_or_else(none, |(own, others)| {
            let count = |s: &Spread| few(s, |v| fixed(v, 0));
            format!("{} against {}", count(own), count(others))
        }),
        p.bounded.as_ref().map_or_else(none, compare::bounded),
        p.counts.text(reference, other),
    ]
}

fn against(reference: &str, other: &str, scenes: &[SceneSummary]) -> Against {
    let one = |s: &SceneSummary| SceneAgainst {
        scene: s.name.clone(),
        clock: s.comparison.as_ref().map(|c| c.clock),
        figures: s.against(reference, other).cloned(),
    };
    let scenes: Vec<SceneAgainst> = scenes.iter().map(one).collect();
    let figures = || scenes.iter().filter_map(|s| s.figures.as_ref());
    let means: Vec<Spread> = figures().filter_map(|p| p.mean).collect();
    let bounded: Vec<Bounded> = figures().filter_map(|p| p.bounded).collect();
    let mut counts = Counts::default();
    figures().for_each(|p| counts.join(&p.counts));
    Against {
        setting: other.to_owned(),
        mean: geometric_mean(&means),
        mean_of: means.len(),
        counts,
        bounded: Bounded::mean(&bounded),
        no_later: Verdict::count(figures().map(|p| p.no_later.all())),
        final_holds: Verdict::count(figures().map(|p| p.final_holds)),
        scenes,
    }
}

fn geometric_mean(all: &[Spread]) -> Option<Spread> {
    let samples = all.iter().map(|s| s.samples).min()?;
    let mean = |pick: fn(&Spread) -> f64| {
        let logs = all.iter().map(|s| pick(s).ln());
        (logs.sum::<f64>() / all.len() as f64).exp()
    };
    Some(Spread {
        median: mean(|s| s.median),
        min: mean(|s| s.min),
        max: mean(|s| s.max),
        samples,
    })
}

/// Ratios of one scene at every threshold.
pub(super) fn ratios(scene: &SceneSummary, c: &compare::Comparison) -> Table {
    let mut columns = vec!["setting".to_owned(), "seeds".into()];
    columns.extend(c.thresholds.iter().map(|t| compare::decibels(*t)));
    let row = |p: &Paired| {
        let cell = |t: &compare::PairedTime| match &t.spread {
            None => "–".to_owned(),
            Some(s) => format!("{}{}", t.bound.sign(), few(s, times)),
        };
        let mut row = vec![p.label.clone(), seeds(p.seeds.len())];
        row.extend(p.to_psnr.iter().map(cell));
        row
    };
    Table {
        title: format!("Time over that of {}, {}", c.reference, c.clock.name()),
        note: format!(
            "Seed by seed; median, and the range where they are three and more. Above 1: {} is sooner. ≥ and ≤: one side has \
             not reached it with every seed, and counts with the last reading of its clock; –: neither has.",
            c.reference
        ),
        columns,
        rows: scene.paired.iter().map(row).collect(),
    }
}
