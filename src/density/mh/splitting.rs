//! Splits of a Gaussian into two along one of its axes that keep its mean, its covariance and what it paints at right angles to the axis. Along the
//! axis the two lie one behind the other, narrower and more opaque.
//!
//! The split move of reversible-jump sampling over mixtures (Richardson and Green 1997, section 3.2, with equal weights and in the Gaussian's own
//! axes): parts at ±α standard deviations of the axis and of √(1 − α²) times its scale there have together the mean and covariance of what was
//! split.

use crate::base::math::ln_sigmoid;
use crate::density::draw::birth_position;
use crate::density::state::SceneState;
use crate::scene::{Edit, OptionalColor};

/// Two parts in the place of a Gaussian, one of which is to be a birth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Parts {
    /// The part that replaces the source, in its row.
    pub(super) source: Edit,
    /// The part that is born; `dst` is set once it is known which births are accepted.
    pub(super) birth: Edit,
}

/// Splits row `row` of this log-scale and opacity logit, `distance` standard deviations from its centre: along an axis drawn in proportion to
/// its variance, by two uniform numbers in [0, 1), the second of which says on which side the birth is. `None` if the row does not exist, the
/// opacity logit is not finite, or the positions are not both finite and apart from each other in f32.
pub(super) fn parts(
    scene: &SceneState<'_>,
    row: u32,
    (mut log_scale, opacity_logit): ([f32; 3], f32),
    distance: f64,
    [which, side]: [f64; 2],
) -> Option<Parts> {
    let i = row as usize;
    // Over the largest, so that no square overflows.
    let largest = log_scale.iter().fold(f32::NEG_INFINITY, |m, s| m.max(*s));
    let variances = log_scale.map(|s| (2.0 * f64::from(s - largest)).exp());
    let drawn = which * variances.iter().sum::<f64>();
    let axis = match drawn {
        d if d < variances[0] => 0,
        d if d < variances[0] + variances[1] => 1,
        _ => 2,
    };
    let mut offset = [0.0; 3];
    offset[axis] = if side < 0.5 { -distance } else { distance };
    let birth = birth_position(scene, i, log_scale, 1.0, offset)?;
    let source = birth_position(scene, i, log_scale, 1.0, offset.map(|v| -v))?;
    if source == birth || !opacity_logit.is_finite() {
        return None;
    }
    let shrink = shrinkage(distance);
    log_scale[axis] = (f64::from(log_scale[axis]) + shrink.ln()) as f32;
    let part = |dst, position| Edit {
        src: row,
        dst,
        position,
        log_scale,
        opacity_logit: part_logit(f64::from(opacity_logit), distance) as f32,
        color: OptionalColor::NONE,
    };
    Some(Parts {
        source: part(row, source),
        birth: part(row, birth),
    })
}

/// Scale of a part along the axis of the split, over that of the source.
fn shrinkage(distance: f64) -> f64 {
    (1.0 - distance * distance).sqrt()
}

/// Largest opacity of a part. The equation of [`part_logit`] exceeds it for distances above 0.85 and opaque sources, of 0.86 and more at 0.9: the most
/// opaque ones paint 0.86 times as much there.
const MOST_OPACITY: f64 = 0.99;

/// Opacity logit of each part. Seen at right angles to the axis, the two blended over each other paint as much as the source does: with β the
/// shrinkage, o and o′ the opacities of source and part, and areas in the unit of the source's,
///
/// 2·β·o′ − β·c·o′² = o with c = exp(−α²/β²)/2,
///
/// where β·c is the integral of the product of the two footprints.
fn part_logit(source_logit: f64, distance: f64) -> f64 {
    let shrink = shrinkage(distance);
    let overlap = (-(distance / shrink).powi(2)).exp() / 2.0;
    let ln_ratio = ln_sigmoid(source_logit) - shrink.ln();
    let root = (1.0 - overlap * ln_ratio.exp()).max(0.0).sqrt();
    // The root of the equation in a form that keeps its digits as o → 0.
    let ln_part = (ln_ratio - (1.0 + root).ln()).min(MOST_OPACITY.ln());
    ln_part - (-ln_part.exp()).ln_1p()
}

#[cfg(test)]
mod tests {
    use super::{MOST_OPACITY, part_logit};
    use crate::base::math::sigmoid;

    #[test]
    fn parts_of_any_opacity_are_finite_and_rise_with_it() {
        for distance in [1e-9, 0.5, 0.9, 0.95] {
            let mut last = f64::NEG_INFINITY;
            for step in -3000..=3000 {
                let part = part_logit(f64::from(step) * 0.2, distance);
                assert!(part.is_finite() && part >= last, "{step} {distance} {part}");
                assert!(sigmoid(part) <= MOST_OPACITY + 1e-12);
                last = part;
            }
        }
        // Two that hide nothing of each other paint as much: o / (2 * sqrt(1 - 0.81)) each.
        let faint = part_logit(-100.0, 0.9) - (-100.0);
        assert!(
            (faint + (2.0 * 0.19f64.sqrt()).ln()).abs() < 1e-9,
            "{faint}"
        );
        // Of two in one place each has half of the opacity, but for what they hide of each other.
        assert!((part_logit(-100.0, 1e-9) + 100.0 + 2f64.ln()).abs() < 1e-9);
    }
}
