//! Axes of charts: their range, round ticks, and the spelling of their numbers.

use crate::chart::text::escape;

/// Mapping of an axis's values to positions, and the spelling of its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Linear, with k, M, G for thousands.
    Number,
    /// Linear; shares in [0, 1] as percent.
    Percent,
    /// Linear; seconds, shown as s, min or h, whichever suits the range.
    Seconds,
    /// Logarithmic, for positive values.
    Log,
}

/// One axis of a chart.
#[derive(Debug, Clone, Copy)]
pub struct Axis<'a> {
    /// Quantity shown.
    pub label: &'a str,
    /// Unit, empty for none; ignored for [`Scale::Seconds`] and [`Scale::Percent`], which have their own.
    pub unit: &'a str,
    /// Mapping to positions and spelling.
    pub scale: Scale,
    /// True if it starts at zero (all values non-negative); otherwise it frames the data.
    pub from_zero: bool,
}

impl<'a> Axis<'a> {
    /// An axis without a unit that starts at zero.
    #[must_use]
    pub const fn from_zero(label: &'a str, scale: Scale) -> Self {
        Self {
            label,
            unit: "",
            scale,
            from_zero: true,
        }
    }

    /// A linear axis that frames its data.
    #[must_use]
    pub const fn framing(label: &'a str, unit: &'a str) -> Self {
        Self {
            label,
            unit,
            scale: Scale::Number,
            from_zero: false,
        }
    }
}

/// A range of numbers with round ticks in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Ticks {
    /// Lower end.
    pub low: f64,
    /// Upper end, above `low`.
    pub high: f64,
    /// Distance of the ticks: 1, 2 or 5 times a power of ten; in [`decades`] of the labelled powers.
    pub step: f64,
    /// Ticks, within [`low`, `high`].
    pub at: Vec<f64>,
}

/// Round ticks, about `target` of them, for data in [`low`, `high`]. With `widen` the range is extended to whole ticks.
/// A range without width is given one. `None` if an end is not finite or no step can tell the ends apart.
#[must_use]
pub fn ticks(low: f64, high: f64, target: u32, widen: bool) -> Option<Ticks> {
    let (mut low, mut high) = (low.min(high), high.max(low));
    let size = low.abs().max(high.abs());
    if high - low <= size * 1e-9 {
        (low, high) = if size > 0.0 {
            (low - 0.05 * size, high + 0.05 * size)
        } else {
            (0.0, 1.0)
        };
    }
    let rough = (high - low) / f64::from(target.max(1));
    let power = 10f64.powf(rough.log10().floor());
    let step = power
        * match rough / power {
            r if r <= 1.0 => 1.0,
            r if r <= 2.0 => 2.0,
            r if r <= 5.0 => 5.0,
            _ => 10.0,
        };
    if !(step.is_finite() && step > 0.0 && low.is_finite() && high.is_finite()) {
        return None;
    }
    if widen {
        // The slack keeps an end that rounding pushed past a tick from opening another step.
        low = (low / step + 1e-9).floor() * step;
        high = (high / step - 1e-9).ceil() * step;
    }
    let first = (low / step - 1e-9).ceil();
    let count = ((high / step + 1e-9).floor() - first).clamp(0.0, 50.0) as u32;
    let at = (0..=count).map(|i| (first + f64::from(i)) * step).collect();
    Some(Ticks {
        low,
        high,
        step,
        at,
    })
}

/// Ticks in log10 for positive data in [`min`, `max`]: ends at 1, 2 or 5 times a power of ten if fewer than two decades are
/// spanned, at whole decades beyond. `None` if the range is empty or not positive.
#[must_use]
pub fn decades(min: f64, max: f64) -> Option<Ticks> {
    if !(min > 0.0 && max.is_finite() && min <= max) {
        return None;
    }
    // A little room, so that no mark lies on the frame.
    let (low, high) = (min.log10() - 0.06, max.log10() + 0.06);
    let (first, last) = (low.floor() as i32, high.ceil() as i32);
    let (fine, every) = (high - low < 2.0, (last - first).unsigned_abs().div_ceil(6));
    let (every, steps): (u32, &[f64]) = if fine {
        (1, &[1.0, 2.0, 5.0])
    } else {
        (every.max(1), &[1.0])
    };
    let all: Vec<f64> = (first..=last)
        .step_by(every as usize)
        .flat_map(|d| steps.iter().map(move |s| f64::from(d) + s.log10()))
        .collect();
    let below = all.iter().rev().find(|t| **t <= low).copied();
    let above = all.iter().find(|t| **t >= high).copied();
    let low = below.unwrap_or(f64::from(first));
    let step = f64::from(every);
    let high = above.unwrap_or_else(|| all.last().map_or(low + 1.0, |t| t + step));
    let inside = |t: &f64| *t >= low && *t <= high;
    Some(Ticks {
        low,
        high,
        step,
        at: all.into_iter().filter(inside).collect(),
    })
}

/// An axis laid over the range of its data.
pub(super) struct Range<'a> {
    axis: &'a Axis<'a>,
    ticks: Ticks,
    divisor: f64,
    unit: &'a str,
}

impl<'a> Range<'a> {
    /// The range of `values` with about `target` ticks, extended to whole ticks with `widen`; `None` without finite values.
    pub(super) fn new(
        axis: &'a Axis<'a>,
        values: impl Iterator<Item = f64>,
        target: u32,
        widen: bool,
    ) -> Option<Self> {
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
            (l.min(v), h.max(v))
        });
        let low = if axis.from_zero { low.min(0.0) } else { low };
        let (unit, divisor) = match axis.scale {
            Scale::Number | Scale::Log => (axis.unit, 1.0),
            Scale::Percent => ("%", 0.01),
            Scale::Seconds => match high {
                h if h > 7200.0 => ("h", 3600.0),
                h if h > 300.0 => ("min", 60.0),
                _ => ("s", 1.0),
            },
        };
        let ticks = match axis.scale {
            Scale::Log => decades(low, high),
            _ => ticks(low / divisor, high / divisor, target, widen),
        }?;
        Some(Self {
            axis,
            ticks,
            divisor,
            unit,
        })
    }

    /// Position of a value within the range, 0 to 1.
    pub(super) fn place(&self, value: f64) -> f64 {
        self.share(match self.axis.scale {
            Scale::Log => value.log10(),
            _ => value / self.divisor,
        })
    }

    fn share(&self, at: f64) -> f64 {
        (at - self.ticks.low) / (self.ticks.high - self.ticks.low)
    }

    /// Position and label of every tick.
    pub(super) fn ticks(&self) -> impl Iterator<Item = (f64, String)> {
        let largest = self.ticks.low.abs().max(self.ticks.high.abs());
        self.ticks.at.iter().map(move |tick| {
            let label = match self.axis.scale {
                Scale::Log => power_of_ten(*tick),
                _ => spell(*tick, self.ticks.step, largest),
            };
            (self.share(*tick), label)
        })
    }

    /// A value in the axis's unit, two digits finer than its ticks.
    pub(super) fn value_label(&self, value: f64) -> String {
        let shown = value / self.divisor;
        let text = spell(shown, self.ticks.step / 100.0, shown);
        match self.unit {
            "" => text,
            unit => format!("{text} {}", escape(unit)),
        }
    }

    /// The axis for a page's script, as JSON: ends in shown units (their log10 if `log`), each of which is `each` of the data's.
    pub(super) fn data(&self) -> serde_json::Value {
        serde_json::json!({
            "label": self.axis.label, "unit": self.unit, "from": self.ticks.low, "to": self.ticks.high,
            "log": self.axis.scale == Scale::Log, "each": self.divisor,
        })
    }

    /// Label and unit of the axis.
    pub(super) fn title(&self) -> String {
        match self.unit {
            "" => escape(self.axis.label),
            unit => format!("{} ({})", escape(self.axis.label), escape(unit)),
        }
    }
}

/// A number with the decimals that `step` needs, thousands as k, M or G from 10,000 on (judged by `largest`).
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

/// 10 to the power of `log10`, in plain digits between 0.001 and 9999, with k and M or an exponent beyond.
fn power_of_ten(log10: f64) -> String {
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
