//! [`Staging`]: buffers in the host's memory by way of which arrays are read.

use std::sync::{Mutex, MutexGuard, PoisonError};

use ocl_core::{self as core, MEM_ALLOC_HOST_PTR, MEM_READ_WRITE, Mem};

/// Bytes that are kept for large reads to come: a million Gaussians' parameters and pictures of some megapixels.
const KEPT: usize = 256 << 20;
/// Bytes of a small buffer, which is always kept.
const SMALL: usize = 64 << 10;

/// Buffers in the host's memory, which drivers pin: a device writes there by itself, while a copy to ordinary memory can keep the host
/// until it is done. To make one takes long, so that they are used again.
#[derive(Debug, Default)]
pub(super) struct Staging {
    idle: Mutex<Vec<Slot>>,
}

/// A buffer in the host's memory.
#[derive(Debug)]
pub(super) struct Slot {
    pub mem: Mem,
    bytes: usize,
}

impl Staging {
    fn idle(&self) -> MutexGuard<'_, Vec<Slot>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A buffer of at least so many bytes that nobody uses.
    pub fn take(&self, context: &core::Context, bytes: usize) -> core::Result<Slot> {
        // Powers of two, so that a read somewhat larger than the last one finds its buffer; those that are not kept as they are.
        let bytes = match bytes.next_power_of_two() {
            rounded if rounded <= KEPT => rounded,
            _ => bytes,
        };
        let mut idle = self.idle();
        if let Some(at) = idle.iter().position(|slot| slot.bytes == bytes) {
            return Ok(idle.swap_remove(at));
        }
        let flags = MEM_READ_WRITE | MEM_ALLOC_HOST_PTR;
        // SAFETY: no host pointer is given; the buffer is owned by `mem`.
        let mem = unsafe { core::create_buffer(context, flags, bytes, None::<&[u8]>) }?;
        Ok(Slot { mem, bytes })
    }

    /// Takes a buffer back.
    pub fn give(&self, slot: Slot) {
        let mut idle = self.idle();
        let large = idle.iter().filter(|slot| slot.bytes > SMALL);
        let kept: usize = large.map(|slot| slot.bytes).sum();
        if slot.bytes <= SMALL || kept + slot.bytes <= KEPT {
            idle.push(slot);
        }
    }
}
