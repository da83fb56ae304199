//! The device at its best: fused multiply-adds in registers, and a copy through memory (`kernels/peak.cl`).

use crate::base::constants::PEAK_CHAINS;
use crate::base::error::Result;
use crate::device::{Array, Kernels, Program, Real};

/// Smallest number of values that a group of the copy moves on a CPU.
const GROUP_LANES: usize = 1024;

/// The kernels.
#[derive(Debug)]
pub struct Peak {
    program: Program,
    copy_local: usize,
}

impl Peak {
    /// Builds the kernels.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let tuning = kernels.defines().tuning;
        // A CPU's thread takes a whole group: one large enough that starting it costs nothing.
        let group = tuning.local.max(GROUP_LANES / tuning.vector_width as usize);
        let copy_local = if tuning.group_style {
            tuning.local
        } else {
            group.min(kernels.device().info().max_work_group.max(1))
        };
        Ok(Self {
            program: kernels.build::<R>("peak")?,
            copy_local,
        })
    }

    /// Lanes of a vector.
    #[must_use]
    pub fn lanes(&self) -> usize {
        self.program.defines().tuning.vector_width as usize
    }

    /// FLOP of one launch of [`Peak::fma`] (a multiply-add is two).
    #[must_use]
    pub fn flop(&self, items: usize, steps: u32) -> f64 {
        2.0 * f64::from(PEAK_CHAINS) * self.lanes() as f64 * items as f64 * f64::from(steps)
    }

    /// Runs the chains x → a·x + b for `steps` steps in each of `items` work-items and writes the sum of each lane to `out`.
    pub fn fma<R: Real>(
        &self,
        items: usize,
        steps: u32,
        [a, b]: [f64; 2],
        out: &Array<R>,
    ) -> Result<()> {
        // A CPU's thread takes one work-item at a time, as in the splat kernels.
        let local = self.program.defines().tuning.batch_local();
        self.program
            .launch("peak_fma")
            .uints([items, steps as usize])
            .reals::<R>([a, b])
            .array(out, items * self.lanes())
            .run([items, 1], [local, 1])
    }

    /// Copies as many whole vectors as `from` holds.
    pub fn copy<R: Real>(&self, from: &Array<R>, to: &Array<R>) -> Result<()> {
        let vectors = from.len() / self.lanes();
        self.program
            .launch("peak_copy")
            .array(from, vectors * self.lanes())
            .uints([vectors])
            .array(to, vectors * self.lanes())
            .run([vectors, 1], [self.copy_local, 1])
    }
}

// Definition in f64.

/// Sum of `chains` chains that go x → a·x + b `steps` times from 1, 2, 3 …
#[must_use]
pub fn fma_chains(chains: u32, steps: u32, a: f64, b: f64) -> f64 {
    (1..=chains)
        .map(|c| (0..steps).fold(f64::from(c), |x, _| a.mul_add(x, b)))
        .sum()
}
