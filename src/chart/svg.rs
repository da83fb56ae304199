//! Figures as hand-made SVG: line charts, with bands around the lines if there are several samples; charts with two logarithmic
//! axes, on which power laws are straight lines and errors of any size fit beside each other; horizontal bars. Numbers that are
//! not finite are skipped.
//!
//! A chart is drawn in a view box 380 wide, which is about a phone's column in CSS pixels, so that its 12-unit text is
//! readable at 390 px and larger on wider pages. Colours are CSS variables of the page (`--s0` …).

use std::fmt::Write;

use crate::chart::axis::{Axis, Range, Scale};
use crate::chart::labels::Labels;
use crate::chart::text::escape;

/// Above this many points a series is drawn without marks.
const MARKED: usize = 24;
/// Above this many points a series is thinned to the extremes of each of `MAX_POINTS / 2` columns.
const MAX_POINTS: usize = 480;

/// A line with the range of the samples that it is the median of, and single points.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Banded {
    /// Name in the legend.
    pub name: String,
    /// Points (x, y) in drawing order.
    pub line: Vec<(f64, f64)>,
    /// Ranges (x, low, high), x rising; may be empty.
    pub band: Vec<(f64, f64, f64)>,
    /// Samples, drawn as thin lines that end in a mark; without any, the points of a short line are marked.
    pub samples: Vec<Vec<(f64, f64)>>,
    /// Value in the legend; `None`: the last of the line, or nothing if there are samples without a line.
    pub value: Option<f64>,
}

impl Banded {
    /// A line without band or samples.
    #[must_use]
    pub fn line(name: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            line: points,
            ..Self::default()
        }
    }

    /// The same without points that are not finite.
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

    /// All points of line, samples and band.
    fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        let edges = |b: &(f64, f64, f64)| [(b.0, b.1), (b.0, b.2)];
        let points = self.line.iter().chain(self.samples.iter().flatten());
        points.copied().chain(self.band.iter().flat_map(edges))
    }
}

/// A figure with a line for every series, its band and marks; `no data` if there is no finite point.
#[must_use]
pub fn band_chart(title: &str, x: &Axis<'_>, y: &Axis<'_>, series: &[Banded]) -> String {
    let series: Vec<Banded> = series.iter().map(Banded::finite).collect();
    let points: Vec<_> = series.iter().flat_map(Banded::points).collect();
    let Some(mut plot) = Plot::new(x, y, &points) else {
        return empty("chart", title);
    };
    for (index, series) in series.iter().enumerate() {
        let last = series.value.or(series.line.last().map(|p| p.1));
        // Points alone have no last value.
        let without = ["", "no data"][usize::from(series.samples.is_empty())];
        let last = last.map_or_else(|| without.to_owned(), |v| plot.value(v));
        plot.key(index, &series.name, Some(&last));
        plot.band(index, &series.band);
        for sample in &series.samples {
            plot.line(index, " thin", &thin(sample));
        }
    }
    for (index, series) in series.iter().enumerate() {
        plot.line(index, "", &thin(&series.line));
        let ends = series.samples.iter().filter_map(|s| s.last()).copied();
        let mut marks: Vec<_> = ends.collect();
        if marks.is_empty() && series.line.len() <= MARKED {
            marks.clone_from(&series.line);
        }
        let tips = marks.into_iter().map(|p| (p, plot.tip(p)));
        let tips: Vec<_> = tips.collect();
        plot.marks(index, &tips);
    }
    plot.figure(title)
}

/// The smallest and largest point of each of `MAX_POINTS / 2` runs of points, in order: peaks survive, bytes do not.
fn thin(line: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let n = line.len();
    if n <= MAX_POINTS {
        return line.to_vec();
    }
    let by_y = |a: &usize, b: &usize| line[*a].1.total_cmp(&line[*b].1);
    let length = n.div_ceil(MAX_POINTS / 2);
    let extremes = (0..n).step_by(length).flat_map(|first| {
        let run = first..n.min(first + length);
        [run.clone().min_by(by_y), run.max_by(by_y)]
    });
    let mut kept: Vec<usize> = extremes.flatten().chain([n - 1]).collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|i| line[i]).collect()
}

/// A point with the text next to it (empty for none) and the one shown when pointed at.
#[derive(Debug, Clone, PartialEq)]
pub struct LogPoint {
    /// Position, > 0.
    pub x: f64,
    /// Position, > 0.
    pub y: f64,
    /// Text beside the mark, left out where there is no room for it.
    pub label: String,
    /// Text of the tooltip.
    pub tip: String,
}

/// Points of one colour.
#[derive(Debug, Clone, PartialEq)]
pub struct LogSeries {
    /// Name in the legend.
    pub name: String,
    /// Points in drawing order.
    pub points: Vec<LogPoint>,
    /// True if a line joins them.
    pub line: bool,
}

/// A figure with the series on logarithmic axes; points that are not positive and finite are left out, `no data` if none
/// remains. Axis labels carry their units.
#[must_use]
pub fn log_log_chart(title: &str, x_label: &str, y_label: &str, series: &[LogSeries]) -> String {
    let [x, y] = [x_label, y_label].map(|label| Axis {
        label,
        unit: "",
        scale: Scale::Log,
        from_zero: false,
    });
    let good = |p: &&LogPoint| p.x > 0.0 && p.y > 0.0 && p.x.is_finite() && p.y.is_finite();
    let all = series.iter().flat_map(|s| s.points.iter().filter(good));
    let points: Vec<_> = all.map(|p| (p.x, p.y)).collect();
    let Some(mut plot) = Plot::new(&x, &y, &points) else {
        return empty("chart", title);
    };
    let mut labels = Labels::new([LEFT, TOP - 8.0, WIDTH, pixel_y(0.0)]);
    for (index, s) in series.iter().enumerate() {
        if !s.name.is_empty() {
            plot.key(index, &s.name, None);
        }
        let good: Vec<_> = s.points.iter().filter(good).collect();
        let at: Vec<_> = good.iter().map(|p| plot.at((p.x, p.y))).collect();
        at.iter().for_each(|at| labels.mark(*at));
        if s.line {
            labels.line(&at);
        }
        let marks = good.iter().map(|p| ((p.x, p.y), escape(&p.tip)));
        let marks: Vec<_> = marks.collect();
        if s.line {
            let line: Vec<_> = marks.iter().map(|m| m.0).collect();
            plot.line(index, "", &line);
        }
        plot.marks(index, &marks);
    }
    let labelled = series.iter().flat_map(|s| s.points.iter().filter(good));
    for p in labelled.filter(|p| !p.label.is_empty()) {
        if let Some((at, anchor)) = labels.place(plot.at((p.x, p.y)), &p.label) {
            plot.text(at, "label", anchor, &escape(&p.label));
        }
    }
    plot.figure(title)
}

/// One bar of a bar chart.
#[derive(Debug, Clone)]
pub struct Bar {
    /// Name at the left.
    pub name: String,
    /// Length.
    pub value: f64,
    /// Text at the right.
    pub text: String,
}

/// A figure with one horizontal bar per entry, the longest over the full width; `no data` if there is none.
#[must_use]
pub fn bar_chart(title: &str, bars: &[Bar]) -> String {
    const ROW: f64 = 24.0;
    const NAMES: f64 = 104.0;
    const TEXTS: f64 = 120.0;
    let good: Vec<&Bar> = bars
        .iter()
        .filter(|b| b.value.is_finite() && b.value >= 0.0)
        .collect();
    let longest = good.iter().fold(0.0f64, |l, b| l.max(b.value));
    if good.is_empty() {
        return empty("chart bars", title);
    }
    let height = good.len() as f64 * ROW + 4.0;
    let mut out = open("chart bars", title);
    let _ = write!(
        out,
        "</figcaption><svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{}\">",
        escape(title)
    );
    for (row, bar) in good.iter().enumerate() {
        let y = row as f64 * ROW + 4.0;
        let share = if longest > 0.0 {
            bar.value / longest
        } else {
            0.0
        };
        let width = short((share * (WIDTH - NAMES - TEXTS)).max(1.0));
        // 12-unit text is about 6.2 units a character: what does not fit is cut, and whole in the tooltip.
        let name: String = match bar.name.chars().count() {
            0..=16 => bar.name.clone(),
            _ => bar.name.chars().take(15).chain(['…']).collect(),
        };
        let _ = write!(
            out,
            "<g><title>{}</title><text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>\
             <rect class=\"bar\" x=\"{NAMES}\" y=\"{y}\" width=\"{width}\" height=\"16\" rx=\"2\"/>\
             <text x=\"{}\" y=\"{}\" class=\"value\">{}</text></g>",
            escape(&bar.name),
            NAMES - 8.0,
            y + 12.5,
            escape(&name),
            short(NAMES + width + 6.0),
            y + 12.5,
            escape(&bar.text)
        );
    }
    out.push_str("</svg></figure>\n");
    out
}

/// Width of every chart's view box.
const WIDTH: f64 = 380.0;
const HEIGHT: f64 = 226.0;
const LEFT: f64 = 48.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 24.0;
const BOTTOM: f64 = 38.0;
/// Number of colours (`--s0` to `--s5`); series beyond them start over.
const COLORS: usize = 6;

/// A coordinate to a tenth of a unit, without needless digits.
fn short(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

/// The opening of a figure up to its title.
fn open(class: &str, title: &str) -> String {
    format!("<figure class=\"{class}\"><figcaption>{}", escape(title))
}

/// A figure without a chart.
fn empty(class: &str, title: &str) -> String {
    open(class, title) + "</figcaption><p class=none>no data</p></figure>\n"
}

/// A chart's axes, and what has been drawn so far.
struct Plot<'a> {
    x: Range<'a>,
    y: Range<'a>,
    legend: String,
    body: String,
}

impl<'a> Plot<'a> {
    /// A grid around points; `None` if an axis has no finite value.
    fn new(x: &'a Axis<'a>, y: &'a Axis<'a>, points: &[(f64, f64)]) -> Option<Self> {
        // Lines may end anywhere along x; along y a range of whole ticks keeps them off the frame.
        let mut plot = Self {
            x: Range::new(x, points.iter().map(|p| p.0), 5, false)?,
            y: Range::new(y, points.iter().map(|p| p.1), 4, true)?,
            legend: String::new(),
            body: String::new(),
        };
        plot.grid();
        Some(plot)
    }

    /// The figure with everything drawn.
    fn figure(self, title: &str) -> String {
        let axes = serde_json::json!([self.x.data(), self.y.data()]).to_string();
        let (left, top, right, bottom) = (pixel_x(0.0), pixel_y(1.0), pixel_x(1.0), pixel_y(0.0));
        format!(
            "{}<div>{}</div></figcaption><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\" data-axes=\"{}\" \
             data-frame=\"[{left},{top},{right},{bottom}]\">{}</svg></figure>\n",
            open("chart", title),
            self.legend,
            escape(title),
            escape(&axes),
            self.body
        )
    }

    /// Pixel coordinates of a point.
    fn at(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let (x, y) = (self.x.place(x), self.y.place(y));
        (short(pixel_x(x)), short(pixel_y(y)))
    }

    /// A value with the unit of the vertical axis.
    fn value(&self, value: f64) -> String {
        self.y.value_label(value)
    }

    /// A point's coordinates with their units, for a tooltip.
    fn tip(&self, (x, y): (f64, f64)) -> String {
        format!("{}: {}", self.x.value_label(x), self.y.value_label(y))
    }

    /// Adds a series to the legend: its colour and name unless the name is empty, and a value.
    fn key(&mut self, index: usize, name: &str, value: Option<&str>) {
        let key = match name {
            "" => String::new(),
            _ => format!("<i class=\"{}\"></i>{} ", class('k', index), escape(name)),
        };
        let value = value.map_or_else(String::new, |v| format!("<b>{v}</b>"));
        let _ = write!(self.legend, "<span>{key}{value}</span>");
    }

    /// Draws a line in a series' colour; `style` adds a CSS class.
    fn line(&mut self, index: usize, style: &str, line: &[(f64, f64)]) {
        let class = class('s', index) + style;
        let points = self.corners(line.iter().copied());
        let _ = write!(
            self.body,
            "<polyline class=\"line {class}\" points=\"{points}\"/>"
        );
    }

    /// Fills the area between the low and high values (x, low, high) in a series' colour.
    fn band(&mut self, index: usize, band: &[(f64, f64, f64)]) {
        if band.is_empty() {
            return;
        }
        let upper = band.iter().map(|b| (b.0, b.2));
        let lower = band.iter().rev().map(|b| (b.0, b.1));
        let points = self.corners(upper.chain(lower));
        let color = index % COLORS;
        let _ = write!(
            self.body,
            "<polygon class=\"band s{color}\" points=\"{points}\"/>"
        );
    }

    /// Draws circles with their tooltips in a series' colour.
    fn marks(&mut self, index: usize, marks: &[((f64, f64), String)]) {
        if marks.is_empty() {
            return;
        }
        let _ = write!(self.body, "<g class=\"mark m{}\">", index % COLORS);
        for (point, tip) in marks {
            let (x, y) = self.at(*point);
            let _ = write!(
                self.body,
                "<circle cx=\"{x}\" cy=\"{y}\" r=\"3\"><title>{tip}</title></circle>"
            );
        }
        self.body.push_str("</g>");
    }

    /// Writes escaped text at pixel coordinates; `anchor` is SVG's `start`, `middle` or `end`.
    fn text(&mut self, (x, y): (f64, f64), class: &str, anchor: &str, text: &str) {
        let _ = write!(
            self.body,
            "<text x=\"{}\" y=\"{}\" class=\"{class}\" text-anchor=\"{anchor}\">{text}</text>",
            short(x),
            short(y)
        );
    }

    fn corners(&self, points: impl Iterator<Item = (f64, f64)>) -> String {
        let corner = |p| {
            let (x, y) = self.at(p);
            format!("{x},{y}")
        };
        points.map(corner).collect::<Vec<_>>().join(" ")
    }

    fn grid(&mut self) {
        let (left, right) = (pixel_x(0.0), pixel_x(1.0));
        let (bottom, top) = (pixel_y(0.0), pixel_y(1.0));
        let rows: Vec<_> = self.y.ticks().collect();
        let columns: Vec<_> = self.x.ticks().collect();
        let lines = rows
            .iter()
            .map(|(share, _)| format!("M{left} {}H{right}", short(pixel_y(*share))));
        let across = columns
            .iter()
            .map(|(share, _)| format!("M{} {top}V{bottom}", short(pixel_x(*share))));
        let path: String = lines.chain(across).collect();
        let _ = write!(
            self.body,
            "<path class=\"grid\" d=\"{path}\"/><path class=\"axis\" d=\"M{left} {top}V{bottom}H{right}\"/>"
        );
        for (share, label) in rows {
            self.text((left - 6.0, pixel_y(share) + 4.0), "tick", "end", &label);
        }
        for (share, label) in columns {
            self.text((pixel_x(share), bottom + 15.0), "tick", "middle", &label);
        }
        let _ = write!(
            self.body,
            "<text x=\"{right}\" y=\"{}\" text-anchor=\"end\" class=\"name\">{}</text>\
             <text x=\"4\" y=\"12\" class=\"name\">{}</text>",
            HEIGHT - 5.0,
            self.x.title(),
            self.y.title()
        );
    }
}

fn pixel_x(share: f64) -> f64 {
    LEFT + share * (WIDTH - LEFT - RIGHT)
}

fn pixel_y(share: f64) -> f64 {
    HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM)
}

/// CSS class of a series: its colour, and dashes from the second round of colours on.
fn class(kind: char, index: usize) -> String {
    let dashed = if index >= COLORS { " dashed" } else { "" };
    format!("{kind}{}{dashed}", index % COLORS)
}
