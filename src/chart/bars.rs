//! Horizontal bars.

use std::fmt::Write;

use crate::chart::plot::{WIDTH, empty, open, short};
use crate::chart::text::escape;

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
