//! [`PendingRead`]: a read that is under way, by way of buffers in the host's memory.

use std::ops::Deref;
use std::sync::Arc;

use ocl_core::{self as core, Event, MapFlags, Mem, MemMap};

use crate::base::error::Result;
use crate::device::context::Inner;
use crate::device::error::{LOST, LOWER, device_error};
use crate::device::layout::Element;
use crate::device::staging::Slot;

/// A read that is under way; [`PendingRead::wait`] blocks until it is done.
#[derive(Debug)]
pub struct PendingRead<T: Element> {
    name: &'static str,
    len: usize,
    slot: Option<Slot>,
    map: MemMap<T>,
    /// End of the mapping.
    event: Event,
    device: Arc<Inner>,
}

impl<T: Element> PendingRead<T> {
    /// Enqueues a read of `len` values of a buffer from `offset` on, all of them within it, without waiting.
    pub(super) fn begin(
        device: &Arc<Inner>,
        (name, mem): (&'static str, &Mem),
        offset: usize,
        len: usize,
    ) -> Result<Self> {
        let what = format!("read {name}");
        let (offset, values) = match len {
            // Drivers refuse to copy nothing; every array has room for a value.
            0 => (0, 1),
            _ => (offset, len),
        };
        let slot = device
            .staging
            .take(&device.compiled.context, values * size_of::<T>())
            .map_err(|e| device_error(&what, &e, LOWER))?;
        let queue = device.queue();
        core::enqueue_copy_buffer::<T, _, _, _>(
            &queue,
            mem,
            &slot.mem,
            offset,
            0,
            values,
            None::<&Event>,
            None::<&mut Event>,
        )
        .map_err(|e| device_error(&what, &e, LOST))?;
        let mut event = Event::null();
        // SAFETY: the memory is read after `event` alone, and belongs to `slot`, which nobody else has until it is no longer mapped.
        let map = unsafe {
            core::enqueue_map_buffer::<T, _, _, _>(
                &queue,
                &slot.mem,
                false,
                MapFlags::READ,
                0,
                values,
                None::<&Event>,
                Some(&mut event),
            )
        }
        .map_err(|e| device_error(&what, &e, LOST))?;
        drop(queue);
        Ok(Self {
            device: device.clone(),
            name,
            len,
            slot: Some(slot),
            map,
            event,
        })
    }

    /// Waits for the data, and copies it.
    ///
    /// # Errors
    /// The driver's.
    pub fn wait(self) -> Result<Vec<T>> {
        Ok(self.arrived()?.to_vec())
    }

    /// Waits for the data, which stays where it has arrived.
    ///
    /// # Errors
    /// The driver's.
    pub fn arrived(self) -> Result<Arrived<T>> {
        core::wait_for_event(&self.event)
            .map_err(|e| device_error(&format!("read {}", self.name), &e, LOST))?;
        Ok(Arrived { read: self })
    }
}

/// Values that have been read, in the buffer that they were transferred to.
#[derive(Debug)]
pub struct Arrived<T: Element> {
    read: PendingRead<T>,
}

impl<T: Element> Deref for Arrived<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        // SAFETY: the mapping is done and has at least `len` values, of a type of which any bits are one; it ends with `read`.
        unsafe { self.read.map.as_slice(self.read.len) }
    }
}

impl<T: Element> Drop for PendingRead<T> {
    fn drop(&mut self) {
        let Some(slot) = self.slot.take() else {
            return;
        };
        let done = core::wait_for_event(&self.event).and_then(|()| {
            core::enqueue_unmap_mem_object(
                &self.device.queue(),
                &slot.mem,
                &self.map,
                None::<&Event>,
                None::<&mut Event>,
            )
        });
        // Of a buffer that may still be mapped the driver disposes, with its last command.
        if done.is_ok() {
            self.device.staging.give(slot);
        }
    }
}
