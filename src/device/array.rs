//! Typed, named, length-checked device arrays.

use std::marker::PhantomData;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use ocl_core::{self as core, Event, MEM_COPY_HOST_PTR, MEM_READ_WRITE, Mem, OclPrm, Uint4};

use crate::base::error::{Error, Result};
use crate::device::context::{Device, Inner};
use crate::device::error::{BUG, LOST, LOWER, device_error};
use crate::device::layout::Element;
use crate::device::read::PendingRead;
use crate::device::section::{Section, read_sections, write_sections};

/// A device buffer of `len` values of `T`.
#[derive(Debug)]
pub struct Array<T> {
    pub(super) mem: Mem,
    name: &'static str,
    len: usize,
    _type: PhantomData<T>,
    device: Arc<Inner>,
}

impl<T> Drop for Array<T> {
    fn drop(&mut self) {
        let bytes = (self.len.max(1) * size_of::<T>()) as u64;
        self.device.allocated.fetch_sub(bytes, Ordering::Relaxed);
    }
}

impl<T: Element> Array<T> {
    /// An array of `len` zeros.
    pub fn zeros(device: &Device, name: &'static str, len: usize) -> Result<Self> {
        let array = Self::create(device, name, len, None)?;
        array.clear()?;
        Ok(array)
    }

    /// An array of `len` values of no meaning, which the caller is to set before anything reads them.
    pub(crate) fn unset(device: &Device, name: &'static str, len: usize) -> Result<Self> {
        Self::create(device, name, len, None)
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
        let context = &device.inner.compiled.context;
        // SAFETY: a host pointer, if given, is read for `len` values during the call alone; the buffer is owned by `mem`.
        let mem = unsafe { core::create_buffer(context, flags, len.max(1), data) }
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
        self.clear_bytes(0, self.len.max(1) * size_of::<T>())
    }

    /// Sets `len` values from `offset` on to zero. Does not wait.
    ///
    /// # Errors
    /// A range beyond the array, or the driver's.
    pub fn clear_range(&self, offset: usize, len: usize) -> Result<()> {
        self.check(offset, len)?;
        match len {
            0 => Ok(()),
            _ => self.clear_bytes(offset * size_of::<T>(), len * size_of::<T>()),
        }
    }

    /// In pieces as large as may be: some drivers fill one after the other. A piece begins at a multiple of its own size; the structs have no
    /// size that a piece may have.
    fn clear_bytes(&self, first: usize, bytes: usize) -> Result<()> {
        let (at, end) = (first, first + bytes);
        if (at | end).is_multiple_of(16) {
            return self.fill(Uint4::zero(), at, bytes);
        }
        let words = [at.next_multiple_of(4), end / 4 * 4];
        if words[0] >= words[1] {
            return self.fill(0u8, at, bytes);
        }
        for [from, to] in [[at, words[0]], [words[1], end]] {
            if from < to {
                self.fill(0u8, from, to - from)?;
            }
        }
        self.fill(0u32, words[0], words[1] - words[0])
    }

    /// Fills so many bytes from the `first` on.
    fn fill<P: OclPrm>(&self, pattern: P, first: usize, bytes: usize) -> Result<()> {
        let size = size_of::<P>();
        core::enqueue_fill_buffer(
            &self.device.queue(),
            &self.mem,
            pattern,
            first / size,
            bytes / size,
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
                &self.device.queue(),
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
        self.check(offset, len)?;
        let mut values = vec![T::default(); len];
        if values.is_empty() {
            return Ok(values);
        }
        // SAFETY: a blocking read: `values` outlives it.
        unsafe {
            core::enqueue_read_buffer(
                &self.device.queue(),
                &self.mem,
                true,
                offset,
                &mut values,
                None::<&Event>,
                None::<&mut Event>,
            )
        }
        .map_err(|e| self.failed("read", &e))?;
        Ok(values)
    }

    /// 32-bit words of a value.
    const WORDS: usize = size_of::<T>() / size_of::<u32>();

    /// Values of whole words from `offset` on, to be read or written with those of other arrays.
    ///
    /// # Errors
    /// A range beyond the array.
    pub fn section(&self, offset: usize, len: usize) -> Result<Section<'_>> {
        self.check(offset, len)?;
        Ok(Section {
            device: &self.device,
            mem: &self.mem,
            name: self.name,
            first: offset * Self::WORDS,
            len: len * Self::WORDS,
        })
    }

    /// Reads `len` values of whole words from `offset` on, after everything enqueued so far, to the end of `words`.
    ///
    /// # Errors
    /// A range beyond the array, or the driver's.
    pub fn append_words(&self, offset: usize, len: usize, words: &mut Vec<u32>) -> Result<()> {
        read_sections(&[self.section(offset, len)?], words.len(), words)
    }

    /// Writes values from `offset` on that [`Array::append_words`] has read from an array of the same type, and waits until `words` may be
    /// reused.
    ///
    /// # Errors
    /// A range beyond the array, words that are no whole values, or the driver's.
    pub fn write_words(&self, offset: usize, words: &[u32]) -> Result<()> {
        let len = words.len().checked_div(Self::WORDS).unwrap_or(0);
        write_sections(&[(self.section(offset, len)?, words)])
    }

    /// All values; see [`Array::read`].
    pub fn to_vec(&self) -> Result<Vec<T>> {
        self.read(0, self.len)
    }

    /// Enqueues a read without waiting for it, also where a driver can copy to its own memory alone while the host goes on.
    ///
    /// # Errors
    /// A range beyond the array, or the driver's.
    pub fn read_later(&self, offset: usize, len: usize) -> Result<PendingRead<T>> {
        self.check(offset, len)?;
        PendingRead::begin(&self.device, (self.name, &self.mem), offset, len)
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
            &self.device.queue(),
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
