//! Round numbers along an axis.

/// A range of numbers with round ticks in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Ticks {
    /// Lower end.
    pub low: f64,
    /// Upper end, above `low`.
    pub high: f64,
    /// Distance of the ticks: 1, 2 or 5 times a power of ten.
    pub step: f64,
    /// The ticks, within [`low`, `high`].
    pub at: Vec<f64>,
}

/// Round ticks, about `target` of them, for data in [`low`, `high`]. With `widen` the range is extended to whole ticks.
/// A range without width is given one. `None` where the ends are not finite or no step can tell them apart.
#[must_use]
pub fn ticks(low: f64, high: f64, target: u32, widen: bool) -> Option<Ticks> {
    let (mut low, mut high) = (low.min(high), high.max(low));
    let size = low.abs().max(high.abs());
    if high - low <= size * 1e-9 {
        let pad = if size > 0.0 { size * 0.05 } else { 0.5 };
        (low, high) = if low == 0.0 {
            (0.0, 1.0)
        } else {
            (low - pad, high + pad)
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
