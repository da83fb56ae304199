//! Exclusive prefix sums (`kernels/scan.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Kernel, Kernels, Real};

/// The scan stage.
#[derive(Debug)]
pub struct Scan {
    sums: Kernel,
    chunks: Kernel,
    write: Kernel,
    chunk_count: usize,
    local: usize,
}

/// Arguments of [`Scan::run`].
#[derive(Debug)]
pub struct ScanArgs<'a> {
    /// Values \[n\].
    pub values: &'a Array<u32>,
    /// Status array; `total_slot` receives the total.
    pub status: &'a Array<u32>,
    /// n.
    pub n: Count,
    /// Slot of the total.
    pub total_slot: u32,
    /// A larger total raises the overflow flag.
    pub capacity: usize,
    /// Scratch \[chunks\].
    pub sums: &'a Array<u32>,
    /// Out \[n\].
    pub out: &'a Array<u32>,
}

/// A number of elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Count {
    /// What this slot of the status array holds when the kernel runs.
    Slot(u32),
    /// Known to the host.
    Known(usize),
}

impl Scan {
    /// Builds the kernels.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [sums, chunks, write] =
            kernels.build::<R, 3>("scan", ["scan_sums", "scan_chunks", "scan_write"])?;
        let tuning = kernels.defines().tuning;
        Ok(Self {
            sums,
            chunks,
            write,
            chunk_count: tuning.chunks,
            local: tuning.coarse_local(),
        })
    }

    /// Enqueues the stage.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run(&self, a: &ScanArgs<'_>) -> Result<()> {
        let global = [self.chunk_count, 1];
        let (slot, known) = match a.n {
            Count::Slot(slot) => (slot, 0),
            Count::Known(n) => (SLOTS as u32, n as u32),
        };
        self.sums
            .launch()
            .array(a.values, 1)
            .array(a.status, SLOTS)
            .value(slot)
            .value(known)
            .value(self.chunk_count as u32)
            .array(a.sums, self.chunk_count)
            .run(global, [self.local, 1])?;
        self.totals(a.sums, a.status, a.total_slot, a.capacity)?;
        self.write
            .launch()
            .array(a.values, 1)
            .array(a.status, SLOTS)
            .value(slot)
            .value(known)
            .value(self.chunk_count as u32)
            .array(a.sums, self.chunk_count)
            .array(a.out, 1)
            .run(global, [self.local, 1])
    }

    /// Prefix sums of the chunks' sums alone, the total into `total_slot`.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn totals(
        &self,
        sums: &Array<u32>,
        status: &Array<u32>,
        total_slot: u32,
        capacity: usize,
    ) -> Result<()> {
        self.chunks
            .launch()
            .array(sums, self.chunk_count)
            .value(self.chunk_count as u32)
            .array(status, SLOTS)
            .value(total_slot)
            .value(capacity as u32)
            .run([1, 1], [1, 1])
    }
}

/// Exclusive prefix sums and the total.
#[must_use]
pub fn scan(values: &[u32]) -> (Vec<u32>, u64) {
    let mut total = 0u64;
    let sums = values
        .iter()
        .map(|v| {
            let before = total as u32;
            total += u64::from(*v);
            before
        })
        .collect();
    (sums, total)
}
