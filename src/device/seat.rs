//! [`Seat`]: the number of an open device among those of this process.

use std::collections::BTreeSet;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::device::info::DeviceInfo;

/// Numbers that are taken.
static TAKEN: Mutex<BTreeSet<u32>> = Mutex::new(BTreeSet::new());

/// The smallest number that no other open device of the process has, free again when this is dropped.
///
/// PoCL loads a kernel once for a process, and once more for more work-items or another first one; it counts the uses by
/// kernel, program and work-group size alone. With the same program in the queues of several devices it confuses those counts, and version 3.1
/// aborts (`pocl_release_dlhandle_cache: Assertion found->ref_count > 0`). Programs that differ in one macro are apart.
#[derive(Debug)]
pub(super) struct Seat(u32);

/// The smallest number that is not among these.
fn smallest_free(taken: &BTreeSet<u32>) -> u32 {
    (0..).find(|n| !taken.contains(n)).unwrap_or(u32::MAX)
}

fn taken() -> MutexGuard<'static, BTreeSet<u32>> {
    TAKEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// True for PoCL before version 6. That of Debian 12 (3.1) was seen to abort; sources of 2024 and later release what they took, so that
/// versions between are doubtful.
fn confuses_counts(info: &DeviceInfo) -> bool {
    let major = info.driver.split('.').next().and_then(|v| v.parse().ok());
    info.platform == "Portable Computing Language" && major.is_none_or(|major: u32| major < 6)
}

impl Seat {
    /// A number for a device; `None` if its driver needs none.
    pub fn of(info: &DeviceInfo) -> Option<Self> {
        confuses_counts(info).then(|| {
            let mut taken = taken();
            let number = smallest_free(&taken);
            taken.insert(number);
            Self(number)
        })
    }

    /// Further options that programs of the device are built with; none for the first device, whose compiled kernels all processes share.
    pub fn options(&self) -> String {
        match self.0 {
            0 => String::new(),
            number => format!(" -DMHSPLAT_SEAT={number}"),
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        taken().remove(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::{Seat, confuses_counts, smallest_free, taken};
    use crate::device::info::{DeviceInfo, DeviceKind};

    fn of_driver(platform: &str, driver: &str) -> DeviceInfo {
        DeviceInfo {
            index: 0,
            kind: DeviceKind::Cpu,
            name: "cpu".to_owned(),
            vendor: String::new(),
            platform: platform.to_owned(),
            driver: driver.to_owned(),
            fp64: true,
            compute_units: 2,
            cores: 2,
            global_memory: 1,
            local_memory: 1,
            max_alloc: 1,
            max_work_group: 1,
            vector_width: 8,
        }
    }

    #[test]
    fn drivers_with_right_counts_need_no_seat() {
        let pocl = |driver| confuses_counts(&of_driver("Portable Computing Language", driver));
        assert!(pocl("3.1+debian") && pocl("5.0") && pocl("unknown"));
        assert!(!pocl("6.0-pre") && !pocl("7.1"));
        assert!(!confuses_counts(&of_driver("NVIDIA CUDA", "3.1")));
    }

    #[test]
    fn seats_differ_as_long_as_they_are_held() {
        let info = of_driver("Portable Computing Language", "3.1");
        let seats: Vec<Seat> = (0..4).filter_map(|_| Seat::of(&info)).collect();
        let options: BTreeSet<String> = seats.iter().map(Seat::options).collect();
        assert_eq!(options.len(), 4, "{options:?}");
        let numbers: BTreeSet<u32> = seats.iter().map(|seat| seat.0).collect();
        assert!(taken().is_superset(&numbers));
        drop(seats);
        assert_eq!(smallest_free(&BTreeSet::from([0, 1, 3])), 2);
        assert_eq!(smallest_free(&BTreeSet::from([1])), 0);
    }
}
