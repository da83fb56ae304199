//! Charts with two logarithmic axes: power laws are straight lines, and errors of any size fit beside each other.

use std::fmt::Write;

use crate::chart::svg::{BOTTOM, COLORS, HEIGHT, LEFT, RIGHT, TOP, WIDTH, pixel_x, pixel_y, short};
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
    /// Whether a line joins them.
    pub line: bool,
}

/// Range of an axis in powers of ten, and its ticks.
#[derive(Debug, Clone, PartialEq)]
pub struct Decades {
    /// Lower end, log10.
    pub low: f64,
    /// Upper end, log10.
    pub high: f64,
    /// Ticks, log10.
    pub at: Vec<f64>,
}

impl Decades {
    /// For positive values: ends at 1, 2 or 5 times a power of ten where fewer than two decades are spanned, at whole
    /// decades beyond. None without a value.
    #[must_use]
    pub fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        let (min, max) = values.fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
        if !(min > 0.0 && max.is_finite() && min <= max) {
            return None;
        }
        // A little room, so that no mark lies on the frame.
        let (low, high) = (min.log10() - 0.06, max.log10() + 0.06);
        let (first, last) = (low.floor() as i32, high.ceil() as i32);
        let fine = high - low < 2.0;
        let every = (last - first).unsigned_abs().div_ceil(6).max(1) as usize;
        let steps: &[f64] = if fine { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let all: Vec<f64> = (first..=last)
            .step_by(if fine { 1 } else { every })
            .flat_map(|d| steps.iter().map(move |s| f64::from(d) + s.log10()))
            .collect();
        let low = all.iter().rev().find(|t| **t <= low).copied();
        let high = all.iter().find(|t| **t >= high).copied();
        let low = low.unwrap_or(f64::from(first));
        let high = high.unwrap_or_else(|| all.last().map_or(low + 1.0, |t| t + every as f64));
        Some(Self {
            low,
            high,
            at: all
                .into_iter()
                .filter(|t| *t >= low && *t <= high)
                .collect(),
        })
    }

    fn place(&self, value: f64) -> f64 {
        (value.log10() - self.low) / (self.high - self.low)
    }
}

/// A power of ten as people write it.
fn spell(log10: f64) -> String {
    let value = 10f64.powf(log10);
    match log10 {
        l if l > 5.99 => format!("{}M", (value * 1e-6).round()),
        l if l > 3.99 => format!("{}k", (value * 1e-3).round()),
        l if l > -0.01 => format!("{}", value.round()),
        l if l > -3.01 => format!("{:.*}", (-l).ceil() as usize, value),
        l => {
            let power = (l + 0.01).floor();
            format!("{}e−{}", (value / 10f64.powf(power)).round(), -power)
        }
    }
}

/// A figure with the series on logarithmic axes; points that are not positive and finite are left out, `no data` where
/// none remains. Axis labels carry their units.
#[must_use]
pub fn log_log_chart(title: &str, x_label: &str, y_label: &str, series: &[LogSeries]) -> String {
    let good = |p: &&LogPoint| p.x > 0.0 && p.y > 0.0 && p.x.is_finite() && p.y.is_finite();
    let all = || series.iter().flat_map(|s| s.points.iter().filter(good));
    let mut out = format!("<figure class=chart><figcaption>{}", escape(title));
    let laid = Decades::of(all().map(|p| p.x)).zip(Decades::of(all().map(|p| p.y)));
    let Some((x, y)) = laid else {
        out.push_str("</figcaption><p class=none>no data</p></figure>\n");
        return out;
    };
    out.push_str("<div>");
    for (index, s) in series
        .iter()
        .enumerate()
        .filter(|(_, s)| !s.name.is_empty())
    {
        let _ = write!(
            out,
            "<span><i class=k{}></i>{}</span>",
            index % COLORS,
            escape(&s.name)
        );
    }
    let _ = write!(
        out,
        "</div></figcaption><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
        escape(title)
    );
    grid(&mut out, &x, &y, [x_label, y_label]);
    for (index, s) in series.iter().enumerate() {
        let points: Vec<&LogPoint> = s.points.iter().filter(good).collect();
        draw(&mut out, index % COLORS, &points, s.line, [&x, &y]);
    }
    out.push_str("</svg></figure>\n");
    out
}

fn grid(out: &mut String, x: &Decades, y: &Decades, labels: [&str; 2]) {
    let (left, right) = (LEFT, WIDTH - RIGHT);
    let (top, bottom) = (TOP, HEIGHT - BOTTOM);
    let (mut path, mut texts) = (String::new(), String::new());
    for tick in &y.at {
        let at = short(pixel_y((tick - y.low) / (y.high - y.low)));
        let _ = write!(path, "M{left} {at}H{right}");
        let _ = write!(
            texts,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>",
            left - 6.0,
            short(at + 4.0),
            spell(*tick)
        );
    }
    for tick in &x.at {
        let at = short(pixel_x((tick - x.low) / (x.high - x.low)));
        let _ = write!(path, "M{at} {top}V{bottom}");
        let _ = write!(
            texts,
            "<text x=\"{at}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            bottom + 15.0,
            spell(*tick)
        );
    }
    let _ = write!(
        out,
        "<path class=\"grid\" d=\"{path}\"/><path class=\"axis\" d=\"M{left} {top}V{bottom}H{right}\"/>{texts}\
         <text x=\"{right}\" y=\"{}\" text-anchor=\"end\" class=\"name\">{}</text>\
         <text x=\"4\" y=\"12\" class=\"name\">{}</text>",
        HEIGHT - 5.0,
        escape(labels[0]),
        escape(labels[1])
    );
}

fn draw(out: &mut String, color: usize, points: &[&LogPoint], line: bool, axes: [&Decades; 2]) {
    let at = |p: &LogPoint| {
        let (x, y) = (axes[0].place(p.x), axes[1].place(p.y));
        (short(pixel_x(x)), short(pixel_y(y)))
    };
    if line {
        let path: Vec<String> = points
            .iter()
            .map(|p| {
                let (x, y) = at(p);
                format!("{x},{y}")
            })
            .collect();
        let _ = write!(
            out,
            "<polyline class=\"line s{color}\" points=\"{}\"/>",
            path.join(" ")
        );
    }
    for (index, p) in points.iter().enumerate() {
        let (x, y) = at(p);
        let _ = write!(
            out,
            "<g class=\"mark m{color}\"><circle cx=\"{x}\" cy=\"{y}\" r=\"4\"><title>{}</title></circle></g>",
            escape(&p.tip)
        );
        if !p.label.is_empty() {
            // Neighbours' texts go above and below in turn, so that close marks do not hide each other's.
            let dy = if index % 2 == 0 { -6.0 } else { 15.0 };
            // Text that would leave the picture at its right end goes to the left of its mark.
            let (text_x, anchor) = if x > WIDTH - 60.0 {
                (short(x - 6.0), "end")
            } else {
                (short(x + 6.0), "start")
            };
            let _ = write!(
                out,
                "<text x=\"{text_x}\" y=\"{}\" text-anchor=\"{anchor}\">{}</text>",
                short(y + dy),
                escape(&p.label)
            );
        }
    }
}
