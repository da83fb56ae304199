//! The end of a run whose loss has stopped improving.

use crate::base::error::{Error, Result};
use crate::config::TrainConfig;
use crate::run::table::MetricsRow;

/// Share of the loss by which it must fall to have improved.
const IMPROVEMENT: f64 = 1e-3;

/// True if none of the last `patience` losses is lower than the best one before them.
pub(super) fn stalled(losses: &[f64], patience: Option<u32>) -> bool {
    let Some(patience) = patience.map(|p| p as usize) else {
        return false;
    };
    if losses.len() <= patience {
        return false;
    }
    let best = |of: &[f64]| of.iter().copied().fold(f64::INFINITY, f64::min);
    let (before, last) = losses.split_at(losses.len() - patience);
    best(last) > best(before) * (1.0 - IMPROVEMENT)
}

/// Training losses at the evaluations of a run (its rows of metrics.csv), of photos of the largest size.
pub(super) fn losses(rows: &[MetricsRow], full_from: u32) -> Vec<f64> {
    let mut rows: Vec<&MetricsRow> = rows.iter().filter(|r| r.iteration > full_from).collect();
    rows.dedup_by_key(|row| row.iteration);
    rows.into_iter().filter_map(|row| row.loss).collect()
}

/// Refuses to go on with a run whose patience is used up.
pub(super) fn check(config: &TrainConfig, losses: &[f64]) -> Result<()> {
    if stalled(losses, config.patience) {
        let what =
            "the training loss has not fallen for so many evaluations already; raise --patience";
        return Err(Error::config("--patience", what));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::stalled;

    #[test]
    fn a_loss_that_falls_is_waited_for() {
        assert!(!stalled(&[3.0, 2.0, 1.0], None));
        assert!(!stalled(&[3.0, 2.0, 1.0], Some(1)));
        assert!(!stalled(&[3.0], Some(1)));
        assert!(!stalled(&[1.0, 1.1, 0.9], Some(2)));
    }

    #[test]
    fn a_loss_that_does_not_is_not() {
        assert!(stalled(&[1.0, 1.0], Some(1)));
        assert!(stalled(&[1.0, 0.9999, 1.2], Some(2)));
        assert!(stalled(&[2.0, 1.0, 1.5, 1.2], Some(2)));
    }
}
