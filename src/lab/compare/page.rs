//! `compare.html`: the whole comparison on one page.

use std::fmt::Write;

use crate::chart::axis::{Axis, Scale};
use crate::chart::svg::{Banded, band_chart};
use crate::chart::text::escape;
use crate::lab::compare::Comparison;
use crate::lab::compare::curve::{Curve, band};
use crate::lab::compare::load::{Clock, Loaded};
use crate::lab::compare::tables::{clocks, tables};
use crate::lab::page::GENERATOR;
use crate::lab::stats::Spread;
use crate::lab::table::write_html;
use crate::run::MetricsRow;
use crate::run::report::page;

/// Heading of a comparison: the scene.
pub(super) fn title(c: &Comparison) -> String {
    let path = c.dataset.path.trim_end_matches(['/', '\\']);
    let name = path.rsplit(['/', '\\']).next().unwrap_or(path);
    format!("{name}: error against run time")
}

/// The page, complete.
#[must_use]
pub fn page(c: &Comparison) -> String {
    let (title, d) = (title(c), &c.dataset);
    let mut body = format!(
        "{GENERATOR}\n<h1>{}</h1><p class=sub>{} training and {} held-out views, {} × {} px · {} runs in {} groups · \
         mhsplat {}</p>\n",
        escape(&title),
        d.train_views,
        d.test_views,
        d.width,
        d.height,
        c.runs.len(),
        c.groups.len(),
        c.version
    );
    let _ = writeln!(body, "<p class=note>{}</p>", clock_note(c.clock));
    warnings(&mut body, &c.warnings);
    let [first, rest, more] = tables(c);
    for table in &first {
        write_html(&mut body, table, "h2");
    }
    charts(&mut body, c);
    for table in &rest {
        write_html(&mut body, table, "h2");
    }
    body.push_str("<details><summary>Other clocks, and every run</summary>");
    for table in &more {
        write_html(&mut body, table, "h3");
    }
    body.push_str("</details>\n");
    page::page(&format!("{title} · mhsplat"), &body)
}

/// Which clock the tables tell, and why.
pub(super) fn clock_note(clock: Clock) -> &'static str {
    match clock {
        Clock::Cpu => {
            "Times are CPU seconds of the process while training, loading included, evaluations and kernels compiled in mid-run left out: other \
             programs on the machine change them least."
        }
        Clock::Train => {
            "Times are seconds of training, loading included, evaluations and kernels compiled in mid-run left out; other programs on the machine delay \
             them."
        }
        Clock::Wall => "Times are seconds since the start, evaluations included.",
        Clock::Iterations => "Times are iterations, whatever one of them takes.",
    }
}

/// A box with what the reader has to know.
pub fn warnings(out: &mut String, warnings: &[String]) {
    if warnings.is_empty() {
        return;
    }
    out.push_str("<div class=warn><b>To be known</b><ul>");
    for warning in warnings {
        let _ = write!(out, "<li>{}</li>", escape(warning));
    }
    out.push_str("</ul></div>\n");
}

fn clock_axis(clock: Clock) -> Axis<'static> {
    let (label, scale) = match clock {
        Clock::Cpu => ("CPU time", Scale::Seconds),
        Clock::Train => ("training time", Scale::Seconds),
        Clock::Wall => ("wall time", Scale::Seconds),
        Clock::Iterations => ("iterations", Scale::Number),
    };
    Axis {
        label,
        unit: if scale == Scale::Seconds { "s" } else { "" },
        scale,
        from_zero: true,
    }
}

/// A quantity of an evaluation, as it is drawn.
struct Quantity {
    axis: Axis<'static>,
    of: fn(&MetricsRow) -> Option<f64>,
}

const PSNR: Quantity = Quantity {
    axis: Axis {
        label: "PSNR",
        unit: "dB",
        scale: Scale::Number,
        from_zero: false,
    },
    of: |r| r.psnr,
};
const SSIM: Quantity = Quantity {
    axis: Axis {
        label: "SSIM",
        unit: "",
        scale: Scale::Number,
        from_zero: false,
    },
    of: |r| r.ssim,
};
const GAUSSIANS: Quantity = Quantity {
    axis: Axis {
        label: "Gaussians",
        unit: "",
        scale: Scale::Number,
        from_zero: true,
    },
    of: |r| Some(r.gaussians as f64),
};

/// Every group as a line: the median of its runs, the range around it, and each run.
fn lines(c: &Comparison, clock: Clock, of: fn(&MetricsRow) -> Option<f64>) -> Vec<Banded> {
    // Groups list their runs in the order in which they were read, each once.
    let find = |path: &str| {
        let same = |r: &&Loaded| r.source.path.display().to_string() == path;
        c.runs.iter().find(same)
    };
    let line = |g: &crate::lab::compare::outcome::GroupOutcome| {
        let members = g.runs.iter().filter_map(|r| find(&r.path));
        let curves: Vec<Curve> = members.map(|r| r.curve(clock, of)).collect();
        let median = band(&curves);
        let several = curves.len() > 1;
        let ends: Option<Vec<f64>> = curves.iter().map(Curve::last).collect();
        let samples = curves.iter().filter(|_| several);
        Banded {
            name: g.label.clone(),
            line: median.iter().map(|(x, s)| (*x, s.median)).collect(),
            band: match several {
                true => median.iter().map(|(x, s)| (*x, s.min, s.max)).collect(),
                false => Vec::new(),
            },
            samples: samples.map(|k| k.points().to_vec()).collect(),
            value: ends.and_then(|v| Spread::of(&v)).map(|s| s.median),
        }
    };
    c.groups.iter().map(line).collect()
}

fn charts(out: &mut String, c: &Comparison) {
    let clocks = clocks(c);
    let several = c.groups.iter().any(|g| g.runs.len() > 1);
    for (heading, quantity) in [("PSNR", &PSNR), ("SSIM", &SSIM), ("Gaussians", &GAUSSIANS)] {
        let _ = write!(out, "<h2>{heading}</h2>");
        if several {
            out.push_str(
                "<p class=note>Line: median of the runs, as far as all of them go; band: their range; thin: each run to its \
                 end. The figure is the median of the ends.</p>",
            );
        }
        out.push_str("<div class=charts>\n");
        for clock in &clocks {
            let axis = clock_axis(*clock);
            let name = format!("{heading} against {}", axis.label);
            let series = lines(c, *clock, quantity.of);
            out.push_str(&band_chart(&name, &axis, &quantity.axis, &series));
        }
        out.push_str("</div>\n");
    }
}
