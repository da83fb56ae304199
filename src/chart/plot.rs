//! The drawing area that line charts share: frame, grid, lines, bands, marks and legend, as hand-made SVG.
//!
//! A chart is drawn in a view box 380 wide, which is about a phone's column in CSS pixels, so that its 12-unit text is
//! readable at 390 px and larger on wider pages. Colours are CSS variables of the page (`--s0` …).

use std::fmt::Write;

use crate::chart::axis::{Axis, Range};
use crate::chart::text::escape;

/// Width of every chart's view box.
pub(super) const WIDTH: f64 = 380.0;
const HEIGHT: f64 = 226.0;
const LEFT: f64 = 44.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 24.0;
const BOTTOM: f64 = 38.0;
/// Number of colours (`--s0` to `--s5`); series beyond them start over.
const COLORS: usize = 6;

/// A coordinate to a tenth of a unit, without needless digits.
pub(super) fn short(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

/// The opening of a figure up to its title.
pub(super) fn open(class: &str, title: &str) -> String {
    format!("<figure class=\"{class}\"><figcaption>{}", escape(title))
}

/// A figure without a chart.
pub(super) fn empty(class: &str, title: &str) -> String {
    open(class, title) + "</figcaption><p class=none>no data</p></figure>\n"
}

/// A chart's axes, and what has been drawn so far.
pub(super) struct Plot<'a> {
    x: Range<'a>,
    y: Range<'a>,
    legend: String,
    body: String,
}

impl<'a> Plot<'a> {
    /// A grid around points; `None` if an axis has no finite value.
    pub(super) fn new(x: &'a Axis<'a>, y: &'a Axis<'a>, points: &[(f64, f64)]) -> Option<Self> {
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
    pub(super) fn figure(self, title: &str) -> String {
        format!(
            "{}<div>{}</div></figcaption><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">{}</svg></figure>\n",
            open("chart", title),
            self.legend,
            escape(title),
            self.body
        )
    }

    /// Pixel coordinates of a point.
    pub(super) fn at(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let (x, y) = (self.x.place(x), self.y.place(y));
        (short(pixel_x(x)), short(pixel_y(y)))
    }

    /// A value with the unit of the vertical axis.
    pub(super) fn value(&self, value: f64) -> String {
        self.y.value_label(value)
    }

    /// A point's coordinates with their units, for a tooltip.
    pub(super) fn tip(&self, (x, y): (f64, f64)) -> String {
        format!("{}: {}", self.x.value_label(x), self.y.value_label(y))
    }

    /// Adds a series to the legend: its colour and name unless the name is empty, and a value.
    pub(super) fn key(&mut self, index: usize, name: &str, value: Option<&str>) {
        let key = match name {
            "" => String::new(),
            _ => format!("<i class=\"{}\"></i>{} ", class('k', index), escape(name)),
        };
        let value = value.map_or_else(String::new, |v| format!("<b>{v}</b>"));
        let _ = write!(self.legend, "<span>{key}{value}</span>");
    }

    /// Draws a line in a series' colour; `style` adds a CSS class.
    pub(super) fn line(&mut self, index: usize, style: &str, line: &[(f64, f64)]) {
        let class = class('s', index) + style;
        let points = self.corners(line.iter().copied());
        let _ = write!(
            self.body,
            "<polyline class=\"line {class}\" points=\"{points}\"/>"
        );
    }

    /// Fills the area between the low and high values (x, low, high) in a series' colour.
    pub(super) fn band(&mut self, index: usize, band: &[(f64, f64, f64)]) {
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
    pub(super) fn marks(&mut self, index: usize, marks: &[((f64, f64), String)]) {
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
    pub(super) fn text(&mut self, (x, y): (f64, f64), anchor: &str, text: &str) {
        let _ = write!(
            self.body,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"{anchor}\">{text}</text>",
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
            self.text((left - 6.0, pixel_y(share) + 4.0), "end", &label);
        }
        for (share, label) in columns {
            self.text((pixel_x(share), bottom + 15.0), "middle", &label);
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
