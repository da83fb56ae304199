//! Charts as hand-made SVG: lines over an axis of time or iterations, with bands around them where there are several samples.
//!
//! A chart is drawn in a view box 380 wide, which is about a phone's column in CSS pixels, so that its 12-unit text is
//! readable at 390 px and larger on wider pages. Colours are CSS variables of the page (`--s0` …). Numbers that are not
//! finite are skipped.

pub use crate::chart::bars::{Bar, bar_chart};
pub use crate::chart::ticks::{Ticks, ticks};

use std::fmt::Write;

use crate::chart::text::escape;

pub(super) const WIDTH: f64 = 380.0;
pub(super) const HEIGHT: f64 = 226.0;
pub(super) const LEFT: f64 = 44.0;
pub(super) const RIGHT: f64 = 14.0;
pub(super) const TOP: f64 = 24.0;
pub(super) const BOTTOM: f64 = 38.0;
/// Above this many points a series is drawn without marks.
const MARKED: usize = 24;
/// Above this many points a series is thinned to the extremes of each of `MOST / 2` columns.
const MOST: usize = 480;
/// Number of colours (`--s0` to `--s5`); series beyond them start over.
pub(super) const COLORS: usize = 6;

/// How an axis spells its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// As they are, with k, M, G for thousands.
    Number,
    /// Shares in [0, 1] as percent.
    Percent,
    /// Seconds, shown as s, min or h, whichever suits the range.
    Seconds,
}

/// One axis of a chart.
#[derive(Debug, Clone, Copy)]
pub struct Axis<'a> {
    /// What it shows.
    pub label: &'a str,
    /// Unit, empty for none; ignored for [`Scale::Seconds`] and [`Scale::Percent`], which know theirs.
    pub unit: &'a str,
    /// How its numbers are spelt.
    pub scale: Scale,
    /// Whether it starts at zero (all values non-negative); otherwise it frames the data.
    pub from_zero: bool,
}

/// One line of a chart.
#[derive(Debug, Clone)]
pub struct Series<'a> {
    /// Name in the legend.
    pub name: &'a str,
    /// Points (x, y) in drawing order.
    pub points: Vec<(f64, f64)>,
}

/// A number with at most `decimals` places, thousands as k, M or G from 10,000 on (judged by `largest`).
fn spell(value: f64, step: f64, largest: f64) -> String {
    let (divisor, suffix) = match largest.abs() {
        a if a >= 1e10 => (1e9, "G"),
        a if a >= 1e7 => (1e6, "M"),
        a if a >= 1e4 => (1e3, "k"),
        _ => (1.0, ""),
    };
    let decimals = (-(step / divisor).log10() - 1e-9).ceil().clamp(0.0, 9.0) as usize;
    let text = format!("{:.decimals$}", value / divisor);
    match text.trim_start_matches('-').trim_matches(['0', '.']) {
        "" => "0".to_owned(),
        _ => text.replace('-', "−") + suffix,
    }
}

/// The unit seconds are best shown in up to `high`, and its length in seconds.
fn time_unit(high: f64) -> (&'static str, f64) {
    match high {
        h if h > 7200.0 => ("h", 3600.0),
        h if h > 300.0 => ("min", 60.0),
        _ => ("s", 1.0),
    }
}

/// An axis with its range, in the numbers that its labels show.
struct Laid<'a> {
    axis: &'a Axis<'a>,
    ticks: Ticks,
    divisor: f64,
    unit: &'a str,
}

impl<'a> Laid<'a> {
    fn new(axis: &'a Axis<'a>, values: impl Iterator<Item = f64>, x: bool) -> Option<Self> {
        let (mut low, mut high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
            (l.min(v), h.max(v))
        });
        if axis.from_zero {
            low = low.min(0.0);
        }
        let (unit, divisor) = match axis.scale {
            Scale::Number => (axis.unit, 1.0),
            Scale::Percent => ("%", 0.01),
            Scale::Seconds => time_unit(high),
        };
        (low, high) = (low / divisor, high / divisor);
        // Lines may end anywhere along x; along y a range of whole ticks keeps them off the frame.
        let ticks = ticks(low, high, if x { 5 } else { 4 }, !x)?;
        Some(Self {
            axis,
            ticks,
            divisor,
            unit,
        })
    }

    /// Position of `value` within the range, 0 to 1.
    fn place(&self, value: f64) -> f64 {
        (value / self.divisor - self.ticks.low) / (self.ticks.high - self.ticks.low)
    }

    fn tick_label(&self, tick: f64) -> String {
        let largest = self.ticks.low.abs().max(self.ticks.high.abs());
        spell(tick, self.ticks.step, largest)
    }

    /// `value` in the axis's unit, two digits finer than its ticks.
    fn value_label(&self, value: f64) -> String {
        let shown = value / self.divisor;
        let text = spell(shown, self.ticks.step / 100.0, shown);
        match self.unit {
            "" => text,
            unit => format!("{text} {}", escape(unit)),
        }
    }

    fn title(&self) -> String {
        match self.unit {
            "" => escape(self.axis.label),
            unit => format!("{} ({})", escape(self.axis.label), escape(unit)),
        }
    }
}

/// A line with the range of the samples that it is the median of, and single points.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Banded {
    /// Name in the legend.
    pub name: String,
    /// Points (x, y) in drawing order.
    pub line: Vec<(f64, f64)>,
    /// Ranges (x, low, high), x rising; may be empty.
    pub band: Vec<(f64, f64, f64)>,
    /// The samples, as thin lines that end in a mark; without any, the points of a short line are marked.
    pub samples: Vec<Vec<(f64, f64)>>,
    /// Value in the legend; none for the last of the line, and for nothing where there are samples without a line.
    pub value: Option<f64>,
}

impl Banded {
    /// Without what is not finite.
    fn finite(&self) -> Self {
        let clean = |line: &Vec<(f64, f64)>| -> Vec<(f64, f64)> {
            let good = |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite();
            line.iter().filter(good).copied().collect()
        };
        let whole = |p: &&(f64, f64, f64)| p.0.is_finite() && p.1.is_finite() && p.2.is_finite();
        Self {
            name: self.name.clone(),
            line: clean(&self.line),
            band: self.band.iter().filter(whole).copied().collect(),
            samples: self.samples.iter().map(clean).collect(),
            value: self.value,
        }
    }

    /// Every point of it.
    fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        let edges = |b: &(f64, f64, f64)| [(b.0, b.1), (b.0, b.2)];
        let ends = self.band.iter().flat_map(edges);
        let lone = self
            .line
            .iter()
            .chain(self.samples.iter().flatten())
            .copied();
        lone.chain(ends)
    }
}

/// A figure with a line for every series; `no data` where there is no finite point.
#[must_use]
pub fn line_chart(title: &str, x: &Axis<'_>, y: &Axis<'_>, series: &[Series<'_>]) -> String {
    let plain = |s: &Series<'_>| Banded {
        name: s.name.to_owned(),
        line: s.points.clone(),
        ..Banded::default()
    };
    let all: Vec<Banded> = series.iter().map(plain).collect();
    band_chart(title, x, y, &all)
}

/// [`line_chart`] with bands and marks.
#[must_use]
pub fn band_chart(title: &str, x: &Axis<'_>, y: &Axis<'_>, series: &[Banded]) -> String {
    let series: Vec<Banded> = series.iter().map(Banded::finite).collect();
    let all = || series.iter().flat_map(Banded::points);
    let laid_x = Laid::new(x, all().map(|p| p.0), true);
    let laid_y = Laid::new(y, all().map(|p| p.1), false);
    let mut out = format!("<figure class=chart><figcaption>{}", escape(title));
    let (Some(laid_x), Some(laid_y)) = (laid_x, laid_y) else {
        out.push_str("</figcaption><p class=none>no data</p></figure>\n");
        return out;
    };
    out.push_str("<div>");
    for (index, series) in series.iter().enumerate() {
        let last = series.value.or(series.line.last().map(|p| p.1));
        // Points alone have no last value.
        let without = ["", "no data"][usize::from(series.samples.is_empty())];
        let last = last.map_or_else(|| without.to_owned(), |v| laid_y.value_label(v));
        let name = escape(&series.name);
        let key = match name.as_str() {
            "" => String::new(),
            _ => format!("<i class=\"{}\"></i>{name} ", color_class('k', index)),
        };
        let _ = write!(out, "<span>{key}<b>{last}</b></span>");
    }
    let _ = write!(
        out,
        "</div></figcaption><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
        escape(title)
    );
    grid(&mut out, &laid_x, &laid_y);
    for (index, series) in series.iter().enumerate() {
        draw_band(&mut out, index, &series.band, &laid_x, &laid_y);
        for sample in &series.samples {
            let class = format!("{} thin", color_class('s', index));
            draw(&mut out, &class, sample, &laid_x, &laid_y);
        }
    }
    for (index, series) in series.iter().enumerate() {
        let class = color_class('s', index);
        draw(&mut out, &class, &series.line, &laid_x, &laid_y);
        let ends: Vec<_> = series
            .samples
            .iter()
            .filter_map(|s| s.last())
            .copied()
            .collect();
        let own = ends.is_empty() && series.line.len() <= MARKED;
        let marks = if own { &series.line } else { &ends };
        draw_marks(&mut out, index, marks, &laid_x, &laid_y);
    }
    out.push_str("</svg></figure>\n");
    out
}

/// CSS class of a series: its colour, and dashes from the second round of colours on.
fn color_class(kind: char, index: usize) -> String {
    let dashed = if index >= COLORS { " dashed" } else { "" };
    format!("{kind}{}{dashed}", index % COLORS)
}

pub(super) fn pixel_x(share: f64) -> f64 {
    LEFT + share * (WIDTH - LEFT - RIGHT)
}

pub(super) fn pixel_y(share: f64) -> f64 {
    HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM)
}

/// A coordinate to a tenth of a unit, without needless digits.
pub(super) fn short(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

fn grid(out: &mut String, x: &Laid<'_>, y: &Laid<'_>) {
    let (left, right) = (short(pixel_x(0.0)), short(pixel_x(1.0)));
    let (bottom, top) = (short(pixel_y(0.0)), short(pixel_y(1.0)));
    let mut path = String::new();
    let mut labels = String::new();
    for &tick in &y.ticks.at {
        let at = short(pixel_y(y.place(tick * y.divisor)));
        let _ = write!(path, "M{left} {at}H{right}");
        let (text_x, text_y, text) = (left - 6.0, short(at + 4.0), y.tick_label(tick));
        let _ = write!(
            labels,
            "<text x=\"{text_x}\" y=\"{text_y}\" text-anchor=\"end\">{text}</text>"
        );
    }
    for &tick in &x.ticks.at {
        let at = short(pixel_x(x.place(tick * x.divisor)));
        let _ = write!(path, "M{at} {top}V{bottom}");
        let (text_y, text) = (bottom + 15.0, x.tick_label(tick));
        let _ = write!(
            labels,
            "<text x=\"{at}\" y=\"{text_y}\" text-anchor=\"middle\">{text}</text>"
        );
    }
    let _ = write!(
        out,
        "<path class=\"grid\" d=\"{path}\"/><path class=\"axis\" d=\"M{left} {top}V{bottom}H{right}\"/>{labels}\
         <text x=\"{right}\" y=\"{}\" text-anchor=\"end\" class=\"name\">{}</text>\
         <text x=\"4\" y=\"12\" class=\"name\">{}</text>",
        HEIGHT - 5.0,
        x.title(),
        y.title()
    );
}

fn draw_band(out: &mut String, index: usize, band: &[(f64, f64, f64)], x: &Laid<'_>, y: &Laid<'_>) {
    if band.is_empty() {
        return;
    }
    let upper = band.iter().map(|b| (b.0, b.2));
    let lower = band.iter().rev().map(|b| (b.0, b.1));
    let corners: Vec<String> = upper
        .chain(lower)
        .map(|(px, py)| {
            let (at_x, at_y) = (pixel_x(x.place(px)), pixel_y(y.place(py)));
            format!("{},{}", short(at_x), short(at_y))
        })
        .collect();
    let color = index % COLORS;
    let _ = write!(
        out,
        "<polygon class=\"band s{color}\" points=\"{}\"/>",
        corners.join(" ")
    );
}

fn draw(out: &mut String, class: &str, line: &[(f64, f64)], x: &Laid<'_>, y: &Laid<'_>) {
    let mut points = String::new();
    for (px, py) in thin(line) {
        let (at_x, at_y) = (pixel_x(x.place(px)), pixel_y(y.place(py)));
        let _ = write!(points, "{},{} ", short(at_x), short(at_y));
    }
    let _ = write!(
        out,
        "<polyline class=\"line {class}\" points=\"{}\"/>",
        points.trim_end()
    );
}

fn draw_marks(out: &mut String, index: usize, marks: &[(f64, f64)], x: &Laid<'_>, y: &Laid<'_>) {
    if marks.is_empty() {
        return;
    }
    let _ = write!(out, "<g class=\"mark m{}\">", index % COLORS);
    for &(px, py) in marks {
        let (at_x, at_y) = (short(pixel_x(x.place(px))), short(pixel_y(y.place(py))));
        let (tip_x, tip_y) = (x.value_label(px), y.value_label(py));
        let _ = write!(
            out,
            "<circle cx=\"{at_x}\" cy=\"{at_y}\" r=\"3\"><title>{tip_x}: {tip_y}</title></circle>"
        );
    }
    out.push_str("</g>");
}

/// The smallest and largest point of each of `MOST / 2` runs of points, in order: peaks survive, bytes do not.
fn thin(line: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if line.len() <= MOST {
        return line.to_vec();
    }
    let mut kept = Vec::with_capacity(MOST + 2);
    for run in line.chunks(line.len().div_ceil(MOST / 2)) {
        let by_y = |a: &(usize, &(f64, f64)), b: &(usize, &(f64, f64))| a.1.1.total_cmp(&b.1.1);
        let low = run.iter().enumerate().min_by(by_y);
        let high = run.iter().enumerate().max_by(by_y);
        let (Some(low), Some(high)) = (low, high) else {
            continue;
        };
        let (first, second) = if low.0 <= high.0 {
            (low, high)
        } else {
            (high, low)
        };
        kept.push(*first.1);
        if first.0 != second.0 {
            kept.push(*second.1);
        }
    }
    if let (Some(last), true) = (line.last(), kept.last() != line.last()) {
        kept.push(*last);
    }
    kept
}
