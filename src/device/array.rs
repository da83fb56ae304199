//! Typed, named, length-checked device arrays.

use std::marker::PhantomData;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use ocl_core::{self as core, Event, MEM_COPY_HOST_PTR, MEM_READ_WRITE, Mem};

use crate::base::error::{Error, Result};
use crate::device::context::{Device, Inner};
use crate::device::error::{BUG, LOST, LOWER, device_error};
use crate::device::layout::Element;

/// A device buffer of `len` values of `T`.
#[derive(Debug)]
pub struct Array<T> {
    device: Arc<Inner>,
    pub(super) mem: Mem,
    name: &'static str,
    len: usize,
    _type: PhantomData<T>,
}

/// A read that is under way; [`PendingRead::wait`] blocks until it is done.
#[derive(Debug)]
pub struct PendingRead<T> {
    name: &'static str,
    data: Vec<T>,
    event: Event,
}

impl<T> Drop for Array<T> {
    fn drop(&mut self) {
        let bytes = (self.len.max(1) * size_of::<T>()) as u64;
        self.device.allocated.fetch_sub(bytes, Ordering::Relaxed);
    }
}

impl<T: Element> PendingRead<T> {
    /// Waits for the data.
    pub fn wait(mut self) -> Result<Vec<T>> {
        core::wait_for_event(&self.event)
            .map_err(|e| device_error(&format!("read {}", self.name), &e, LOST))?;
        Ok(std::mem::take(&mut self.data))
    }
}

impl<T> Drop for PendingRead<T> {
    fn drop(&mut self) {
        // The device writes into `data` until the event completes. If that cannot be waited for, the memory must stay.
        if core::wait_for_event(&self.event).is_err() {
            std::mem::forget(std::mem::take(&mut self.data));
        }
    }
}

impl<T: Element> Array<T> {
    /// An array of `len` zeros.
    pub fn zeros(device: &Device, name: &'static str, len: usize) -> Result<Self> {
        let array = Self::create(device, name, len, None)?;
        array.clear()?;
        Ok(array)
    }

    /// A copy of `data`, made at once: it waits for nothing that is enqueued, and any thread may make one.
    pub fn from_slice(device: &Device, name: &'static str, data: &[T]) -> Result<Self> {
        Self::create(device, name, data.len(), Some(data))
    }

    fn create(device: &Device, name: &'static str, len: usize, data: Option<&[T]>) -> Result<Self> {
        let bytes = (len.max(1) * size_of::<T>()) as u64;
        let max = device.info().max_alloc;
        if bytes > max {
            return Err(Error::device(
                format!("allocate {name}"),
                format!("{bytes} bytes asked for; the device allows {max} in one buffer"),
                LOWER,
            ));
        }
        let data = data.filter(|d| !d.is_empty());
        let flags = match data {
            Some(_) => MEM_READ_WRITE | MEM_COPY_HOST_PTR,
            None => MEM_READ_WRITE,
        };
        // SAFETY: a host pointer, if given, is read for `len` values during the call alone; the buffer is owned by `mem`.
        let mem = unsafe { core::create_buffer(&device.inner.context, flags, len.max(1), data) }
            .map_err(|e| device_error(&format!("allocate {name} ({bytes} bytes)"), &e, LOWER))?;
        device.inner.allocated.fetch_add(bytes, Ordering::Relaxed);
        Ok(Self {
            device: device.inner.clone(),
            mem,
            name,
            len,
            _type: PhantomData,
        })
    }

    /// Name, as in `kernels/README.md`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Number of values.
    #[must_use]
    pub fn len(&self) -> usize {
        self.len
    }

    /// True if there are no values.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    fn check(&self, offset: usize, len: usize) -> Result<()> {
        if offset.checked_add(len).is_some_and(|end| end <= self.len) {
            return Ok(());
        }
        Err(Error::device(
            self.name,
            format!(
                "{len} values from {offset} on; the array holds {}",
                self.len
            ),
            BUG,
        ))
    }

    fn failed(&self, what: &str, error: &core::Error) -> Error {
        device_error(&format!("{what} {}", self.name), error, LOST)
    }

    /// Sets every byte to zero. Does not wait.
    pub fn clear(&self) -> Result<()> {
        // By bytes: the pattern of a fill must have a power-of-two size, which the structs do not have.
        core::enqueue_fill_buffer(
            &self.device.queue,
            &self.mem,
            0u8,
            0,
            self.len.max(1) * size_of::<T>(),
            None::<&Event>,
            None::<&mut Event>,
            None,
        )
        .map_err(|e| self.failed("clear", &e))
    }

    /// Writes `data` from `offset` on and waits until it may be reused.
    ///
    /// # Errors
    /// A range beyond the array, or the driver's.
    pub fn write(&self, offset: usize, data: &[T]) -> Result<()> {
        self.check(offset, data.len())?;
        if data.is_empty() {
            return Ok(());
        }
        // SAFETY: a blocking write: `data` outlives it.
        unsafe {
            core::enqueue_write_buffer(
                &self.device.queue,
                &self.mem,
                true,
                offset,
                data,
                None::<&Event>,
                None::<&mut Event>,
            )
        }
        .map_err(|e| self.failed("write", &e))
    }

    /// Reads `len` values from `offset` on, after everything enqueued so far.
    ///
    /// # Errors
    /// A range beyond the array, or the driver's.
    pub fn read(&self, offset: usize, len: usize) -> Result<Vec<T>> {
        self.read_later(offset, len)?.wait()
    }

    /// All values; see [`Array::read`].
    pub fn to_vec(&self) -> Result<Vec<T>> {
        self.read(0, self.len)
    }

    /// Enqueues a read without waiting for it.
    ///
    /// # Errors
    /// A range beyond the array, or the driver's.
    pub fn read_later(&self, offset: usize, len: usize) -> Result<PendingRead<T>> {
        self.check(offset, len)?;
        // One more than asked for nothing keeps the slice non-empty: drivers refuse a read of no bytes.
        let mut data = vec![T::default(); len.max(1)];
        let mut event = Event::null();
        // SAFETY: `data`'s heap block is owned by the PendingRead, which waits for the event before freeing it, or never frees it.
        unsafe {
            core::enqueue_read_buffer(
                &self.device.queue,
                &self.mem,
                false,
                offset.min(self.len.saturating_sub(1)),
                &mut data,
                None::<&Event>,
                Some(&mut event),
            )
        }
        .map_err(|e| self.failed("read", &e))?;
        let mut pending = PendingRead {
            name: self.name,
            data,
            event,
        };
        if len == 0 {
            core::wait_for_event(&pending.event).map_err(|e| self.failed("read", &e))?;
            pending.data.clear();
        }
        Ok(pending)
    }

    /// Copies `len` values from `source` (at `from`) to this array (at `to`). Does not wait.
    ///
    /// # Errors
    /// A range beyond either array, or the driver's.
    pub fn copy_from(&self, to: usize, source: &Self, from: usize, len: usize) -> Result<()> {
        self.check(to, len)?;
        source.check(from, len)?;
        if len == 0 {
            return Ok(());
        }
        core::enqueue_copy_buffer::<T, _, _, _>(
            &self.device.queue,
            &source.mem,
            &self.mem,
            from,
            to,
            len,
            None::<&Event>,
            None::<&mut Event>,
        )
        .map_err(|e| self.failed("copy to", &e))
    }
}
