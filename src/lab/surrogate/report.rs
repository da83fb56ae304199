//! The report of a check: correlations of every form of birth, and charts of its calibration.

use crate::chart::axis::{Axis, Scale};
use crate::chart::svg::{Banded, band_chart};
use crate::chart::text::{fixed, grouped};
use crate::lab::report::{Report, Section};
use crate::lab::surrogate::candidates::Draw;
use crate::lab::surrogate::check::Assessment;
use crate::lab::surrogate::outcome::{Calibration, Correlation, FormOutcome};
use crate::lab::surrogate::rank::{Estimate, ranks};
use crate::lab::table::{Table, digits, folder_name, or_dash};

/// Unit of the gains, millionths: one birth of many thousands changes little.
const MILLION: f64 = 1e6;
/// Subset of the tables that are shown first.
const ALL: &str = "all";

/// State of the run and size of the check in one line.
fn headline(r: &Assessment) -> String {
    let proposals = r.candidates.iter();
    let proposals = proposals.filter(|j| j.candidate.draw == Draw::Proposal);
    format!(
        "{} of {} iterations, {} Gaussians, {} views of up to {} × {} px, loss {} · {} candidates ({} drawn as proposals, the \
         others evenly over I), {} more that no view sees · seed {} · {}-bit kernels on {} · mhsplat {}",
        grouped(r.iterations[0].into()),
        grouped(r.iterations[1].into()),
        grouped(r.gaussians as u64),
        r.views.len(),
        r.size[0],
        r.size[1],
        fixed(r.loss, 5),
        r.candidates.len(),
        proposals.count(),
        r.unseen,
        r.seed,
        r.bits,
        r.device,
        r.version
    )
}

const NOTE: &str = "The gain −ΔL is the loss before less the loss after one birth, mean of the views, measured by rendering again. \
     ρ_S is Spearman's, τ_b Kendall's rank correlation with it (95 % bootstrap interval over the candidates): 1 orders births \
     perfectly, 0 is a coin, below 0 the order is wrong. “Best tenth” is the mean gain, in millionths, of the tenth of the \
     candidates that a predictor puts first. The acceptance ρ is σ(I)·D in the form of the run at temperature 1, with the voxels as they are, all of one size.";

fn estimate(e: Option<Estimate>) -> String {
    or_dash(e, |e| {
        let [value, low, high] = [e.value, e.low, e.high].map(|v| fixed(v, 2));
        format!("{value} ({low} to {high})")
    })
}

fn gain(value: f64) -> String {
    digits(MILLION * value).replace('-', "−")
}

/// Correlations of a form, over all candidates or over each of the other subsets.
fn correlations(form: &FormOutcome, all: bool) -> Table {
    let subset = |c: &&Correlation| (c.subset == ALL) == all;
    let rows = form.correlations.iter().filter(subset).map(|c| {
        let top = or_dash(c.top_gain, gain);
        let name = match all {
            true => c.predictor.to_owned(),
            false => format!("{}: {}", c.subset, c.predictor),
        };
        let figures = [estimate(c.spearman), estimate(c.kendall), top];
        [vec![name, c.count.to_string()], figures.to_vec()].concat()
    });
    let [q1, q2, q3] = form.quartiles.unwrap_or([f64::NAN; 3]).map(gain);
    let columns = ["predictor", "candidates", "ρ_S", "τ_b", "best tenth, 10⁻⁶"];
    let percent = |share: f64| fixed(100.0 * share, 0);
    let [good, bad] = form.lowering_by_probe.map(|share| or_dash(share, percent));
    let (title, note) = match all {
        true => (
            format!("Birth {}", form.birth),
            format!(
                "{} % of the candidates lower the loss ({} % of those drawn as proposals): {good} % of those for which the probe \
                 predicts a gain, {bad} % of the others. Gain in millionths: mean {}, quartiles {q1}, {q2}, {q3}.",
                percent(form.lowering),
                percent(form.lowering_proposals),
                gain(form.mean_gain),
            ),
        ),
        false => (format!("Birth {}, by subset", form.birth), String::new()),
    };
    Table::new(title, note, &columns, rows)
}

fn calibration(name: &str, axis: &Axis<'_>, unit: f64, bins: &[Calibration]) -> String {
    let x = |b: &Calibration| unit * b.predicted;
    let y = |v: f64| MILLION * v;
    let series = [
        Banded {
            name: "mean".into(),
            line: bins.iter().map(|b| (x(b), y(b.mean))).collect(),
            ..Banded::default()
        },
        Banded {
            name: "median and quartiles".into(),
            line: bins.iter().map(|b| (x(b), y(b.quartiles[1]))).collect(),
            band: bins
                .iter()
                .map(|b| (x(b), y(b.quartiles[0]), y(b.quartiles[2])))
                .collect(),
            ..Banded::default()
        },
    ];
    let gains = Axis {
        label: "true gain −ΔL",
        unit: "10⁻⁶",
        scale: Scale::Number,
        from_zero: true,
    };
    band_chart(name, axis, &gains, &series)
}

/// Every candidate by the ranks of its predicted and of its true gain.
fn scatter(report: &Assessment, form: usize, name: &str, of: &dyn Fn(usize) -> f64) -> String {
    let n = report.candidates.len();
    let x: Vec<f64> = (0..n).map(of).collect();
    let y: Vec<f64> = report.candidates.iter().map(|j| j.gain[form]).collect();
    let ranks = ranks(&x).into_iter().zip(ranks(&y));
    let series = Banded {
        name: format!("{n} candidates"),
        samples: ranks.map(|p| vec![p]).collect(),
        ..Banded::default()
    };
    let axis = |label| Axis {
        label,
        unit: "",
        scale: Scale::Number,
        from_zero: true,
    };
    band_chart(
        name,
        &axis("rank of the prediction"),
        &axis("rank of the true gain"),
        &[series],
    )
}

/// Calibration and ranks of a form, by importance and by probe.
fn charts(report: &Assessment, form: usize) -> Section {
    let (f, c) = (&report.forms[form], &report.candidates);
    let axis = |label, unit| Axis {
        label,
        unit,
        scale: Scale::Number,
        from_zero: false,
    };
    let birth = f.birth;
    let importance = axis("importance I", "");
    let tenths = |of: &str| format!("{birth}: gain by tenths of {of}");
    let ranks = |of: &str| format!("{birth}: ranks, {of}");
    let probe = axis("predicted gain", "10⁻⁶");
    let figures = vec![
        calibration(&tenths("I"), &importance, 1.0, &f.by_importance),
        calibration(&tenths("the probe"), &probe, MILLION, &f.by_probe),
        scatter(report, form, &ranks("importance I"), &|k| {
            c[k].candidate.importance
        }),
        scatter(report, form, &ranks("probe"), &|k| c[k].probe[form]),
    ];
    Section::Charts {
        title: String::new(),
        note: String::new(),
        figures,
    }
}

/// The whole check as a report.
#[must_use]
pub fn report(check: &Assessment) -> Report {
    let mut sections = Vec::new();
    for (k, form) in check.forms.iter().enumerate() {
        sections.push(Section::Table(correlations(form, true)));
        sections.push(charts(check, k));
    }
    let subsets = check.forms.iter().map(|f| correlations(f, false));
    sections.push(Section::Details {
        summary: "By draw and by phase".into(),
        sections: subsets.map(Section::Table).collect(),
    });
    let views = check.views.join(", ");
    sections.push(Section::Text(format!("Run {}. Views: {views}.", check.run)));
    let name = folder_name(&check.dataset);
    Report {
        title: format!("{name}: true and predicted gain of births"),
        subtitle: headline(check),
        note: NOTE.into(),
        sections,
        ..Report::default()
    }
}
