//! [`Cores`]: the number of cores that a process takes, for its own threads and for a device that is a CPU.

use std::num::NonZero;
use std::thread::available_parallelism;

use crate::base::error::{Error, Result};

/// Variable in which Slurm leaves the number of cores of a task.
pub const VARIABLE: &str = "SLURM_CPUS_PER_TASK";

/// Number of cores to take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cores {
    count: usize,
    asked: bool,
}

impl Cores {
    /// The cores that the process may use: those of its affinity mask and of its control group's quota, not of the node, and no more
    /// than Slurm gave its task.
    #[must_use]
    pub fn allowed() -> Self {
        let given = std::env::var(VARIABLE).ok();
        Self {
            count: bounded(usable(), given.as_deref()),
            asked: false,
        }
    }

    /// So many cores, or those of [`Cores::allowed`] without a number.
    ///
    /// # Errors
    /// None, or more than the process may use.
    pub fn new(asked: Option<usize>) -> Result<Self> {
        let Some(count) = asked else {
            return Ok(Self::allowed());
        };
        let most = usable();
        let what = format!("{count}; 1 to {most} expected, the cores that this process may use");
        Error::unless((1..=most).contains(&count), "--threads", &what)?;
        Ok(Self { count, asked: true })
    }

    /// Number of cores.
    #[must_use]
    pub fn count(self) -> usize {
        self.count
    }

    /// True if the user asked for this number, so that another one is an error.
    #[must_use]
    pub fn is_asked(self) -> bool {
        self.asked
    }
}

/// Cores of the affinity mask and of the control group's quota; 1 if the system does not tell.
fn usable() -> usize {
    available_parallelism().map_or(1, NonZero::get)
}

/// Number of usable cores, no more than a scheduler gave; what is no number of cores bounds nothing.
fn bounded(usable: usize, given: Option<&str>) -> usize {
    let given = given.and_then(|text| text.trim().parse().ok());
    usable.min(given.filter(|n| *n > 0).unwrap_or(usable))
}

#[cfg(test)]
mod tests {
    use super::{Cores, bounded, usable};

    #[test]
    fn a_scheduler_bounds_the_cores_and_adds_none() {
        for (given, expected) in [
            (None, 8),
            (Some("3"), 3),
            (Some("64"), 8),
            (Some("0"), 8),
            (Some(""), 8),
            (Some("many"), 8),
        ] {
            assert_eq!(bounded(8, given), expected, "{given:?}");
        }
    }

    #[test]
    fn numbers_that_cannot_be_are_refused_with_those_that_can() {
        let most = usable();
        for wrong in [0, most + 1] {
            let said = Cores::new(Some(wrong)).unwrap_err().to_string();
            let both = said.contains(&format!("{wrong}; 1 to {most} "));
            assert!(both && said.starts_with("--threads: "), "{said}");
        }
        let all = Cores::new(Some(most)).unwrap();
        assert!(all.is_asked() && all.count() == most);
        assert!(!Cores::new(None).unwrap().is_asked());
    }
}
