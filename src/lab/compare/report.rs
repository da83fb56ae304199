//! The report of a comparison: tables, and charts of every group over every clock.

use crate::chart::axis::{Axis, Scale};
use crate::chart::svg::{Banded, band_chart};
use crate::lab::compare::comparison::Comparison;
use crate::lab::compare::curve::{Curve, band};
use crate::lab::compare::load::{Clock, Loaded};
use crate::lab::compare::outcome::GroupOutcome;
use crate::lab::compare::tables::{differences, finals, relative, runs, shares, times};
use crate::lab::report::{Report, Section};
use crate::lab::stats::Spread;
use crate::lab::table::{Table, folder_name};
use crate::run::MetricsRow;

/// The whole comparison as a report.
#[must_use]
pub fn report(c: &Comparison) -> Report {
    let d = &c.dataset;
    let clocks = clocks(c);
    let timed = !c.thresholds.is_empty();
    let mut sections = vec![Section::Table(finals(c))];
    if timed {
        sections.extend([times(c, c.clock), relative(c)].map(Section::Table));
    }
    sections.extend(QUANTITIES.iter().map(|q| charts(c, q, &clocks)));
    sections.extend([shares(c), differences(c)].map(Section::Table));
    let others = clocks.iter().skip(1).filter(|_| timed);
    let more: Vec<Table> = others.map(|k| times(c, *k)).chain([runs(c)]).collect();
    sections.push(Section::Details {
        summary: "Other clocks, and every run".into(),
        sections: more.into_iter().map(Section::Table).collect(),
    });
    Report {
        title: format!("{}: error against run time", folder_name(&d.path)),
        subtitle: format!(
            "{} training and {} held-out views, {} × {} px · {} runs in {} groups · mhsplat {}",
            d.train_views,
            d.test_views,
            d.width,
            d.height,
            c.runs.len(),
            c.groups.len(),
            c.version
        ),
        note: clock_note(c.clock).into(),
        warnings: c.warnings.clone(),
        sections,
    }
}

/// The clock of the tables, and what it includes.
fn clock_note(clock: Clock) -> &'static str {
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

/// Clocks that all runs have, the comparison's own first.
fn clocks(c: &Comparison) -> Vec<Clock> {
    let has = |clock: &Clock| c.runs.iter().all(|r| *clock != Clock::Cpu || r.has_cpu());
    let others = Clock::ALL.into_iter().filter(|k| *k != c.clock);
    std::iter::once(c.clock).chain(others.filter(has)).collect()
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

impl Quantity {
    const fn new(
        label: &'static str,
        unit: &'static str,
        from_zero: bool,
        of: fn(&MetricsRow) -> Option<f64>,
    ) -> Self {
        let axis = Axis {
            label,
            unit,
            scale: Scale::Number,
            from_zero,
        };
        Self { axis, of }
    }
}

const QUANTITIES: [Quantity; 3] = [
    Quantity::new("PSNR", "dB", false, |r| r.psnr),
    Quantity::new("SSIM", "", false, |r| r.ssim),
    Quantity::new("Gaussians", "", true, |r| Some(r.gaussians as f64)),
];

/// Every group as a line: the median of its runs, the range around it, and each run.
fn lines(c: &Comparison, clock: Clock, of: fn(&MetricsRow) -> Option<f64>) -> Vec<Banded> {
    // Groups list their runs in the order in which they were read, each once.
    let find = |path: &str| {
        let same = |r: &&Loaded| r.source.path.display().to_string() == path;
        c.runs.iter().find(same)
    };
    let line = |g: &GroupOutcome| {
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

/// One quantity against each clock.
fn charts(c: &Comparison, quantity: &Quantity, clocks: &[Clock]) -> Section {
    let several = c.groups.iter().any(|g| g.runs.len() > 1);
    let heading = quantity.axis.label;
    let figure = |clock: &Clock| {
        let axis = clock_axis(*clock);
        let name = format!("{heading} against {}", axis.label);
        band_chart(&name, &axis, &quantity.axis, &lines(c, *clock, quantity.of))
    };
    let note = match several {
        true => {
            "Line: median of the runs, as far as all of them go; band: their range; thin: each run to its end. The figure is the \
             median of the ends."
        }
        false => "",
    };
    Section::Charts {
        title: heading.into(),
        note: note.into(),
        figures: clocks.iter().map(figure).collect(),
    }
}
