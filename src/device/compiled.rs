//! [`Compiled`]: a context with the programs that were built in it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ocl_core::{self as core, ClDeviceIdPtr};

use crate::device::seat::Seat;

/// A program, and its number among those of the same text; the number goes after it.
#[derive(Debug)]
pub(super) struct Built {
    pub program: core::Program,
    pub _seat: Option<Seat>,
}

/// A context, and the programs built in it so far, by their texts.
#[derive(Debug)]
pub(super) struct Compiled {
    pub context: core::Context,
    pub programs: Mutex<BTreeMap<String, Built>>,
}

impl Compiled {
    /// A new context.
    pub fn new(id: core::DeviceId) -> Result<Arc<Self>, core::Error> {
        let context = core::create_context(None, &[id], None, None)?;
        Ok(Arc::new(Self {
            context,
            programs: Mutex::default(),
        }))
    }
}

/// Contexts by their devices' handles, kept when a device is closed for the next that is opened.
#[derive(Debug)]
pub(super) struct Kept(Mutex<Vec<(usize, Arc<Compiled>)>>);

/// Contexts of whole CPUs, as many as were open at the same time. They hold little but programs, and the driver takes a second for a set of them
/// even where it has compiled their kernels before.
pub(super) static OF_CPUS: Kept = Kept(Mutex::new(Vec::new()));

impl Kept {
    fn list(&self) -> MutexGuard<'_, Vec<(usize, Arc<Compiled>)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A context of a device that nobody else has: the oldest, or a new one.
    pub fn context(&self, id: core::DeviceId) -> Result<Arc<Compiled>, core::Error> {
        let handle = id.as_ptr() as usize;
        let mut list = self.list();
        let free = list
            .iter()
            .find(|(of, one)| *of == handle && Arc::strong_count(one) == 1);
        if let Some((_, free)) = free {
            return Ok(free.clone());
        }
        let new = Compiled::new(id)?;
        list.push((handle, new.clone()));
        Ok(new)
    }

    /// Leaves a context to those who have it.
    pub fn forget(&self, compiled: &Arc<Compiled>) {
        self.list().retain(|(_, one)| !Arc::ptr_eq(one, compiled));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::Kept;
    use crate::device::context::Device;

    #[test]
    fn a_context_is_for_one_at_a_time_and_then_for_the_next() {
        let device = Device::open(None).unwrap();
        let kept = Kept(Mutex::default());
        let [first, second] = [0, 1].map(|_| kept.context(device.inner.id).unwrap());
        assert!(!Arc::ptr_eq(&first, &second));
        let at = Arc::as_ptr(&first);
        drop(first);
        let third = kept.context(device.inner.id).unwrap();
        assert_eq!(Arc::as_ptr(&third), at);
        kept.forget(&third);
        let fourth = kept.context(device.inner.id).unwrap();
        assert!(!Arc::ptr_eq(&fourth, &third) && !Arc::ptr_eq(&fourth, &second));
        drop(third);
        assert_eq!(kept.list().len(), 2);
    }
}
