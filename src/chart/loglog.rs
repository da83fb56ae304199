//! Charts with two logarithmic axes: power laws are straight lines, and errors of any size fit beside each other.

use crate::chart::axis::{Axis, Scale};
use crate::chart::plot::{Plot, WIDTH, empty};
use crate::chart::text::escape;

/// A point with the text next to it (empty for none) and the one shown when pointed at.
#[derive(Debug, Clone, PartialEq)]
pub struct LogPoint {
    /// Position, > 0.
    pub x: f64,
    /// Position, > 0.
    pub y: f64,
    /// Text beside the mark.
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
    for (index, s) in series.iter().enumerate() {
        if !s.name.is_empty() {
            plot.key(index, &s.name, None);
        }
        let good: Vec<_> = s.points.iter().filter(good).collect();
        let marks = good.iter().map(|p| ((p.x, p.y), escape(&p.tip)));
        let marks: Vec<_> = marks.collect();
        if s.line {
            let line: Vec<_> = marks.iter().map(|m| m.0).collect();
            plot.line(index, "", &line);
        }
        plot.marks(index, &marks);
        for (place, p) in good.iter().enumerate().filter(|(_, p)| !p.label.is_empty()) {
            let (x, y) = plot.at((p.x, p.y));
            // Neighbours' texts go above and below in turn, so that close marks do not hide each other's.
            let y = y + if place % 2 == 0 { -6.0 } else { 15.0 };
            // Text that would leave the picture at its right end goes to the left of its mark.
            let (x, anchor) = if x > WIDTH - 60.0 {
                (x - 6.0, "end")
            } else {
                (x + 6.0, "start")
            };
            plot.text((x, y), anchor, &escape(&p.label));
        }
    }
    plot.figure(title)
}
