//! The device at its best: fused multiply-adds in registers, and a copy through memory (`kernels/peak.cl`).

use crate::base::constants::PEAK_CHAINS;
use crate::base::error::Result;
use crate::device::{Array, Kernel, Kernels, Real};

/// Values that a group of the copy moves on a CPU, at least.
const GROUP_LANES: usize = 1024;

/// The two kernels.
#[derive(Debug)]
pub struct Peak {
    fma: Kernel,
    copy: Kernel,
    lanes: usize,
    fma_local: usize,
    copy_local: usize,
}

/// Arguments of [`Peak::fma`].
#[derive(Debug)]
pub struct FmaArgs<'a, R: Real> {
    /// Work-items.
    pub items: usize,
    /// Multiply-adds of each chain.
    pub steps: u32,
    /// Factor a and term b of x → a·x + b.
    pub factors: [f64; 2],
    /// Out \[items, lanes\]: sum of the chains.
    pub out: &'a Array<R>,
}

impl Peak {
    /// Builds the kernels.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [fma, copy] = kernels.build::<R, 2>("peak", ["peak_fma", "peak_copy"])?;
        let tuning = kernels.defines().tuning;
        let lanes = tuning.vector_width as usize;
        // A CPU's thread takes a whole group: one large enough that starting it costs nothing.
        let group = tuning.local.max(GROUP_LANES / lanes);
        Ok(Self {
            fma,
            copy,
            lanes,
            // As the splat kernels: a CPU's thread takes one work-item at a time.
            fma_local: if tuning.group_style { tuning.local } else { 1 },
            copy_local: if tuning.group_style {
                tuning.local
            } else {
                group.min(kernels.device().info().max_work_group.max(1))
            },
        })
    }

    /// Lanes of a vector.
    #[must_use]
    pub fn lanes(&self) -> usize {
        self.lanes
    }

    /// FLOP of one launch of [`Peak::fma`] (a multiply-add is two).
    #[must_use]
    pub fn flop(&self, items: usize, steps: u32) -> f64 {
        2.0 * f64::from(PEAK_CHAINS) * self.lanes as f64 * items as f64 * f64::from(steps)
    }

    /// Enqueues the multiply-adds.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn fma<R: Real>(&self, a: &FmaArgs<'_, R>) -> Result<()> {
        self.fma
            .launch()
            .value(a.items as u32)
            .value(a.steps)
            .value(R::of(a.factors[0]))
            .value(R::of(a.factors[1]))
            .array(a.out, a.items * self.lanes)
            .run([a.items, 1], [self.fma_local, 1])
    }

    /// Enqueues a copy of as many whole vectors as `from` holds.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn copy<R: Real>(&self, from: &Array<R>, to: &Array<R>) -> Result<()> {
        let vectors = from.len() / self.lanes;
        self.copy
            .launch()
            .array(from, vectors * self.lanes)
            .value(vectors as u32)
            .array(to, vectors * self.lanes)
            .run([vectors, 1], [self.copy_local, 1])
    }
}

/// Sum of `chains` chains that go x → a·x + b `steps` times from 1, 2, 3 …
#[must_use]
pub fn fma_chains(chains: u32, steps: u32, a: f64, b: f64) -> f64 {
    (1..=chains)
        .map(|c| (0..steps).fold(f64::from(c), |x, _| a.mul_add(x, b)))
        .sum()
}
