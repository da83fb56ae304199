//! The report as Markdown and as one HTML page.

use std::fmt::Write;

use crate::chart::axis::{Axis, Scale};
use crate::chart::svg::{Banded, band_chart};
use crate::chart::text::{escape, fixed, grouped};
use crate::lab::page::GENERATOR;
use crate::lab::surrogate::Report;
use crate::lab::surrogate::candidates::Draw;
use crate::lab::surrogate::outcome::{Calibration, Correlation, FormOutcome};
use crate::lab::surrogate::rank::Estimate;
use crate::lab::table::{Table, digits, write_html, write_markdown};
use crate::run::report::page;

/// Gains are told in millionths: one birth of many thousands changes little.
const MILLION: f64 = 1e6;
/// Subset of the tables that both pages show first.
const ALL: &str = "all";

fn title(report: &Report) -> String {
    let path = report.dataset.trim_end_matches(['/', '\\']);
    let name = path.rsplit(['/', '\\']).next().unwrap_or(path);
    format!("{name}: what births do to the loss, and what foretells it")
}

fn headline(r: &Report) -> String {
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
    e.map_or_else(
        || "–".into(),
        |e| {
            format!(
                "{} ({} to {})",
                fixed(e.value, 2),
                fixed(e.low, 2),
                fixed(e.high, 2)
            )
        },
    )
}

fn gain(value: f64) -> String {
    digits(MILLION * value).replace('-', "−")
}

/// Correlations of a form, over all candidates or over each of the other subsets.
fn correlations(form: &FormOutcome, all: bool) -> Table {
    let subset = |c: &&Correlation| (c.subset == ALL) == all;
    let rows = form.correlations.iter().filter(subset).map(|c| {
        let top = c.top_gain.map_or_else(|| "–".into(), gain);
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
    let [good, bad] = form
        .lowering_by_probe
        .map(|share| share.map_or_else(|| "–".into(), percent));
    Table {
        title: match all {
            true => format!("Birth {}", form.birth),
            false => format!("Birth {}, by subset", form.birth),
        },
        note: match all {
            true => format!(
                "{} % of the candidates lower the loss ({} % of those drawn as proposals): {good} % of those whose probe \
                 foretells a gain, {bad} % of the others. Gain in millionths: mean {}, quartiles {q1}, {q2}, {q3}.",
                percent(form.lowering),
                percent(form.lowering_proposals),
                gain(form.mean_gain),
            ),
            false => String::new(),
        },
        columns: columns.map(String::from).to_vec(),
        rows: rows.collect(),
    }
}

/// The terminal's tables.
#[must_use]
pub fn markdown(report: &Report) -> String {
    let mut out = format!("# {}\n\n{}\n\n{NOTE}\n", title(report), headline(report));
    for form in &report.forms {
        write_markdown(&mut out, &correlations(form, true), "##");
    }
    out
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

/// Every candidate by the ranks of what was foretold and of what came.
fn scatter(report: &Report, form: usize, name: &str, of: &dyn Fn(usize) -> f64) -> String {
    let n = report.candidates.len();
    let x: Vec<f64> = (0..n).map(of).collect();
    let y: Vec<f64> = report.candidates.iter().map(|j| j.gain[form]).collect();
    let ranks = crate::lab::surrogate::rank::ranks(&x)
        .into_iter()
        .zip(crate::lab::surrogate::rank::ranks(&y));
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
        &axis("rank of what was foretold"),
        &axis("rank of the true gain"),
        &[series],
    )
}

fn charts(out: &mut String, report: &Report, form: usize) {
    let f = &report.forms[form];
    let by_importance = Axis {
        label: "importance I",
        unit: "",
        scale: Scale::Number,
        from_zero: false,
    };
    let by_probe = Axis {
        label: "gain foretold by the probe",
        unit: "10⁻⁶",
        scale: Scale::Number,
        from_zero: false,
    };
    out.push_str("<div class=charts>\n");
    let birth = f.birth;
    out.push_str(&calibration(
        &format!("{birth}: gain by tenths of I"),
        &by_importance,
        1.0,
        &f.by_importance,
    ));
    out.push_str(&calibration(
        &format!("{birth}: gain by tenths of the probe"),
        &by_probe,
        MILLION,
        &f.by_probe,
    ));
    let c = &report.candidates;
    let ranks = |name: &str| format!("{birth}: ranks, {name}");
    out.push_str(&scatter(report, form, &ranks("importance I"), &|k| {
        c[k].candidate.importance
    }));
    out.push_str(&scatter(report, form, &ranks("probe"), &|k| {
        c[k].probe[form]
    }));
    out.push_str("</div>\n");
}

/// The page, complete.
#[must_use]
pub fn page(report: &Report) -> String {
    let title = title(report);
    let mut body = format!(
        "{GENERATOR}\n<h1>{}</h1><p class=sub>{}</p><p class=note>{}</p>\n",
        escape(&title),
        escape(&headline(report)),
        escape(NOTE)
    );
    for (k, form) in report.forms.iter().enumerate() {
        write_html(&mut body, &correlations(form, true), "h2");
        charts(&mut body, report, k);
    }
    body.push_str("<details><summary>By draw and by phase</summary>");
    for form in &report.forms {
        write_html(&mut body, &correlations(form, false), "h3");
    }
    let views: Vec<String> = report.views.iter().map(|v| escape(v)).collect();
    let _ = writeln!(
        body,
        "</details><p class=note>Run {}. Views: {}.</p>",
        escape(&report.run),
        views.join(", ")
    );
    page::page(&format!("{title} · mhsplat"), &body)
}
