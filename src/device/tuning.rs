//! Constants that only the device side knows, and the sizes that depend on the class of device.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::base::constants::{GROUP_BATCH, RECORD_BYTES, SUMS};
use crate::device::info::{DeviceInfo, DeviceKind};

/// Key of a Gaussian that is not visible.
pub const KEY_CULLED: u32 = u32::MAX;

/// Gaussians that a work-item of the optimiser takes where it is a whole core: of 32 it takes nearly twice as long (docs/results/speed.md).
const UPDATE_RUN: usize = 64;

/// Parts of the names of vendors whose GPUs have [`Tuning::GPU_WIDE`] by default.
const WIDE_VENDORS: [&str; 3] = ["Advanced Micro Devices", "AMD", "Intel"];

/// Slots of the device's status array.
pub mod status {
    /// Visible Gaussians.
    pub const VISIBLE: u32 = 0;
    /// Pairs (0 after an overflow).
    pub const INTERSECTIONS: u32 = 1;
    /// Pairs needed when they did not fit; sticky until the host clears it.
    pub const OVERFLOW: u32 = 2;
    /// Gradient values that were not finite.
    pub const NON_FINITE: u32 = 3;
    /// Number of slots.
    pub const SLOTS: usize = 8;
}

/// Sizes that kernels are built with. The defaults of its class were measured for CPUs; for GPUs the number of chunks and those of the
/// compositing kernels were (docs/results/gpu-measured.md), the others are conservative. A choice for the device at hand can be measured and passed with `Device::with_tuning`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Tuning {
    /// Lanes of realV.
    pub vector_width: u32,
    /// Width of a block of `vector_width` pixels.
    pub block_width: u32,
    /// A work-group per tile instead of a work-item per tile.
    pub group_style: bool,
    /// Edge of a tile, pixels. Of 32 a work-item has the pixels in its first cache, and a Gaussian falls into fewer tiles (docs/results/speed.md); a
    /// work-group takes 16.
    #[serde(default = "usual_tile")]
    pub tile: u32,
    /// Gaussians per group of the kernels that take them one by one or by vectors.
    pub local: usize,
    /// Chunks of the scan and sort kernels.
    pub chunks: usize,
    /// Bits per radix pass.
    pub radix_bits: u32,
    /// Columns per strip of the loss kernels; without meaning in the group style, in which they go by tiles.
    pub strip: u32,
    /// Work-items that share a tile in splat in the group style: each takes the pixels of a column that lie as many rows apart as fit
    /// into the group. This and the following have no meaning where a work-item takes a tile.
    #[serde(default = "usual_splat_group")]
    pub splat_group: u32,
    /// The same in splat_grad.
    #[serde(default = "usual_grad_group")]
    pub grad_group: u32,
    /// Pairs of a tile that a work-group of splat_grad takes.
    #[serde(default = "usual_grad_segment")]
    pub grad_segment: u32,
    /// Pairs whose sums by work-item wait in local memory for the sum over the group.
    #[serde(default = "usual_grad_sums")]
    pub grad_sums: u32,
}

/// The syntax of `MHSPLAT_TUNING`, without sizes that have no meaning in this style.
impl fmt::Display for Tuning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = serde_json::to_string(self).map_err(|_| fmt::Error)?;
        let text = text.replace(['{', '}', '"'], "").replace(':', "=");
        let means =
            |f: &&str| self.group_style || !f.starts_with("splat-") && !f.starts_with("grad-");
        let fields: Vec<&str> = text.split(',').filter(means).collect();
        f.write_str(&fields.join(","))
    }
}

impl Tuning {
    /// Explicit vectors, a work-item per tile: for CPUs.
    pub const CPU: Self = Self {
        vector_width: 16,
        block_width: 4,
        group_style: false,
        tile: 32,
        local: 64,
        chunks: 16,
        radix_bits: 12,
        strip: 416,
        ..Self::GPU
    };

    /// Work-groups for tiles or parts of them, with a few pixels a work-item: for GPUs.
    pub const GPU: Self = Self {
        vector_width: 1,
        block_width: 1,
        group_style: true,
        tile: 16,
        local: 128,
        chunks: 1024,
        radix_bits: 8,
        strip: 8,
        splat_group: 128,
        grad_group: 64,
        grad_segment: 64,
        grad_sums: 5,
    };

    /// The same for GPUs of AMD and Intel, where local memory or registers leave groups of 64 too few in number (docs/results/gpu.md).
    pub const GPU_WIDE: Self = Self {
        grad_group: 128,
        grad_sums: 2,
        ..Self::GPU
    };

    /// The default for a device.
    #[must_use]
    pub fn for_device(info: &DeviceInfo) -> Self {
        match info.kind {
            DeviceKind::Cpu if info.vector_width < 16 && info.vector_width > 0 => Self {
                vector_width: 8,
                ..Self::CPU
            },
            DeviceKind::Cpu => Self::CPU,
            // Too small for a work-group per tile: one pixel at a time, slow but right.
            _ if info.max_work_group < Self::GPU.tile_pixels() => Self {
                group_style: false,
                radix_bits: 4,
                local: info.max_work_group.clamp(1, Self::GPU.local),
                ..Self::GPU
            },
            _ if WIDE_VENDORS.iter().any(|v| info.vendor.contains(v)) => Self::GPU_WIDE,
            _ => Self::GPU,
        }
    }

    /// The first rule that these sizes break for a device; `None` if kernels can be built with them.
    #[must_use]
    pub fn fault(&self, info: &DeviceInfo) -> Option<&'static str> {
        let (lanes, block) = (self.vector_width, self.block_width);
        let checks = [
            (
                matches!(lanes, 1 | 4 | 8 | 16),
                "vector-width is 1, 4, 8 or 16",
            ),
            (
                block > 0
                    && lanes.is_multiple_of(block)
                    && matches!(lanes / block, 1 | 2 | 4)
                    && self.tile.is_multiple_of(block)
                    && (block > 1 || lanes == 1),
                "a block is one, two or four rows of block-width pixels and holds vector-width of them",
            ),
            (
                !self.group_style || lanes == 1,
                "group-style goes with vector-width 1",
            ),
            (
                matches!(self.tile, 16 | 32) && (self.tile == 16 || !self.group_style),
                "tile is 16 or 32, with group-style 16",
            ),
            (
                !self.group_style || info.max_work_group >= Self::GPU.tile_pixels(),
                "the device has no room for a work-group per tile",
            ),
            (
                (1..=info.max_work_group).contains(&self.local),
                "local is between 1 and the device's largest work-group",
            ),
            (
                (1..=1 << 16).contains(&self.chunks),
                "chunks is between 1 and 65536",
            ),
            (
                (1..=16).contains(&self.radix_bits),
                "radix-bits is between 1 and 16",
            ),
            (
                !self.group_style || self.radix_bits <= Self::GPU.tile_pixels().ilog2(),
                "with group-style radix-bits is 8 at most",
            ),
            (
                self.strip > 0 && self.strip.is_multiple_of(lanes.max(1)) && self.strip <= 4096,
                "strip is a multiple of vector-width, up to 4096",
            ),
            (
                matches!(self.splat_group, 64 | 128 | 256),
                "splat-group is 64, 128 or 256",
            ),
            (
                matches!(self.grad_group, 64 | 128 | 256),
                "grad-group is 64, 128 or 256",
            ),
            (
                self.grad_segment > 0
                    && self.grad_segment.is_multiple_of(GROUP_BATCH)
                    && self.grad_segment <= 4096,
                "grad-segment is a multiple of 64, up to 4096",
            ),
            (
                (1..=self.grad_group / SUMS as u32).contains(&self.grad_sums),
                "grad-sums is between 1 and a ninth of grad-group",
            ),
            (
                !self.group_style || self.grad_local_bytes(info.fp64) <= info.local_memory,
                "grad-group and grad-sums need no more than the device's local memory",
            ),
        ];
        checks
            .into_iter()
            .find(|(good, _)| !good)
            .map(|(_, what)| what)
    }

    /// Numbers that splat keeps of the segments of so many pairs, for splat_grad: three colours and the transmittance of each pixel of a tile.
    #[must_use]
    pub fn snapshot_values(&self, pairs: usize) -> usize {
        pairs.div_ceil(self.grad_segment as usize) * 4 * self.tile_pixels()
    }

    /// Bytes of local memory that a work-group of splat_grad takes at most, in f64 where that is to be built: records and slots of a batch, and
    /// sums by work-item in rows that are padded by four.
    #[must_use]
    pub fn grad_local_bytes(&self, in_double: bool) -> u64 {
        let real = if in_double { 2 } else { 1 };
        let staged = u64::from(GROUP_BATCH) * (real * RECORD_BYTES + size_of::<u32>()) as u64;
        let row = u64::from(self.grad_group + 4) * (real * size_of::<f32>()) as u64;
        staged + u64::from(self.grad_sums) * SUMS as u64 * row
    }

    /// Pixels of a tile.
    #[must_use]
    pub const fn tile_pixels(&self) -> usize {
        (self.tile * self.tile) as usize
    }

    /// Local size of kernels in which a work-item takes a vector of Gaussians.
    #[must_use]
    pub fn lane_local(&self) -> usize {
        (self.local / self.vector_width as usize).max(1)
    }

    /// Gaussians that a work-item of the optimiser takes: those of a vector, or, where it is a whole core, of as many as make
    /// consecutive reads of a plane long enough for the hardware to fetch ahead, with their gradients in the first cache
    /// (docs/results/speed.md).
    #[must_use]
    pub fn update_run(&self) -> usize {
        if self.vector_width == 1 {
            1
        } else {
            UPDATE_RUN
        }
    }

    /// Local size of the optimiser's kernel: one work-item where it holds the gradients of a run in private memory.
    #[must_use]
    pub fn run_local(&self) -> usize {
        if self.vector_width == 1 {
            self.local
        } else {
            1
        }
    }

    /// Local size of kernels with a work-item per tile or per chunk.
    #[must_use]
    pub fn coarse_local(&self) -> usize {
        if self.group_style { 32 } else { 1 }
    }

    /// Work-items per tile of the kernels that go through the pixels of a tile.
    #[must_use]
    pub fn tile_group(&self) -> usize {
        if self.group_style {
            self.tile_pixels()
        } else {
            1
        }
    }

    /// Sets of error maps that the loss writes: one, of the means of the channels, or one for each channel, which their readers add up.
    #[must_use]
    pub fn error_sets(&self) -> usize {
        if self.group_style { 3 } else { 1 }
    }
}

/// The value in records that are older than the field.
const fn usual_tile() -> u32 {
    Tuning::GPU.tile
}

/// The value in records that are older than the field.
const fn usual_splat_group() -> u32 {
    Tuning::GPU.splat_group
}

/// The value in records that are older than the field.
const fn usual_grad_group() -> u32 {
    Tuning::GPU.grad_group
}

/// The value in records that are older than the field.
const fn usual_grad_segment() -> u32 {
    Tuning::GPU.grad_segment
}

/// The value in records that are older than the field.
const fn usual_grad_sums() -> u32 {
    Tuning::GPU.grad_sums
}
