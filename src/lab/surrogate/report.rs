//! The report of a check: correlations of every form of birth, and charts of its calibration.

use crate::chart::axis::{Axis, Scale};
use crate::chart::svg::{Banded, band_chart};
use crate::chart::text::{fixed, grouped};
use crate::lab::report::{Report, Section};
use crate::lab::surrogate::births::Draw;
use crate::lab::surrogate::check::Assessment;
use crate::lab::surrogate::rank::{Calibration, FormOutcome, Interval};
use crate::lab::table::{Table, digits, folder_name, or_dash};

/// Unit of the gains, millionths: one birth of many thousands changes little.
const MILLION: f64 = 1e6;

/// State of the run and size of the check in one line.
fn headline(r: &Assessment) -> String {
    let proposals = r.candidates.iter().filter(|c| c.draw == Draw::Proposal);
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
     candidates that a predictor puts first. “probe” is the first-order estimate of a birth. The acceptance ρ is σ(I)·D in the form of the run at temperature 1, with the voxels as they are, all of one size. Births that split their sources, the default, are not judged.";

fn interval(e: Option<Interval>) -> String {
    or_dash(e, |e| {
        let [value, low, high] = [e.value, e.low, e.high].map(|v| fixed(v, 2));
        format!("{value} ({low} to {high})")
    })
}

fn gain(value: f64) -> String {
    digits(MILLION * value).replace('-', "−")
}

/// Correlations of a form by subset and predictor.
fn correlations(form: &FormOutcome) -> Table {
    let rows = form.correlations.iter().map(|c| {
        vec![
            c.predictor.to_owned(),
            c.subset.to_owned(),
            c.count.to_string(),
            interval(c.spearman),
            interval(c.kendall),
            or_dash(c.top_gain, gain),
        ]
    });
    let [q1, q2, q3] = form.quartiles.unwrap_or([f64::NAN; 3]).map(gain);
    let percent = |share: f64| fixed(100.0 * share, 0);
    let [good, bad] = form
        .lowering_by_estimate
        .map(|share| or_dash(share, percent));
    let note = format!(
        "{} % of the candidates lower the loss ({} % of those drawn as proposals): {good} % of those whose \
         first-order estimate is a gain, {bad} % of the others. Gain in millionths: mean {}, quartiles {q1}, {q2}, {q3}.",
        percent(form.lowering),
        percent(form.lowering_proposals),
        gain(form.mean_gain),
    );
    let columns = [
        "predictor",
        "subset",
        "candidates",
        "ρ_S",
        "τ_b",
        "best tenth, 10⁻⁶",
    ];
    Table::new(format!("Birth {}", form.birth), note, &columns, rows)
}

/// The true gain along a predictor of this label and unit, of which `scale` are one.
fn calibration(
    name: &str,
    (label, unit, scale): (&str, &str, f64),
    bins: &[Calibration],
) -> String {
    let axis = |label, unit, from_zero| Axis {
        label,
        unit,
        scale: Scale::Number,
        from_zero,
    };
    let x = |b: &Calibration| scale * b.predicted;
    let band = |b: &Calibration| (x(b), MILLION * b.quartiles[0], MILLION * b.quartiles[2]);
    let mean = bins.iter().map(|b| (x(b), MILLION * b.mean));
    let median = bins.iter().map(|b| (x(b), MILLION * b.quartiles[1]));
    let series = [
        Banded::line("mean", mean.collect()),
        Banded {
            band: bins.iter().map(band).collect(),
            ..Banded::line("median and quartiles", median.collect())
        },
    ];
    let gains = axis("true gain −ΔL", "10⁻⁶", true);
    band_chart(name, &axis(label, unit, false), &gains, &series)
}

/// Calibration of a form, by importance and by first-order estimate.
fn charts(form: &FormOutcome) -> Section {
    let tenths = |of: &str| format!("{}: gain by tenths of {of}", form.birth);
    let importance = ("importance I", "", 1.0);
    let estimate = ("estimated gain", "10⁻⁶", MILLION);
    Section::Charts {
        title: String::new(),
        note: String::new(),
        figures: vec![
            calibration(&tenths("I"), importance, &form.by_importance),
            calibration(&tenths("the estimate"), estimate, &form.by_estimate),
        ],
    }
}

/// The whole check as a report.
#[must_use]
pub fn report(check: &Assessment) -> Report {
    let of_form = |form| [Section::Table(correlations(form)), charts(form)];
    let mut sections: Vec<Section> = check.forms.iter().flat_map(of_form).collect();
    let views = check.views.join(", ");
    sections.push(Section::Text(format!("Run {}. Views: {views}.", check.run)));
    let name = folder_name(&check.dataset);
    Report {
        title: format!("{name}: true and estimated gain of births"),
        subtitle: headline(check),
        note: NOTE.into(),
        sections,
        ..Report::default()
    }
}
