//! [`Seat`]: the number of a program among those of the same text in this process.

use std::collections::{BTreeMap, BTreeSet};
use std::hash::{Hash, Hasher};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rustc_hash::FxHasher;

use crate::device::info::DeviceInfo;

/// Numbers that are taken, by the hash of a program's text.
type Taken = BTreeMap<u64, BTreeSet<u32>>;

static TAKEN: Mutex<Taken> = Mutex::new(BTreeMap::new());

/// The smallest number that no other program of the process with the same text has, free again when this is dropped.
///
/// PoCL loads a kernel once for a process, and once more for more work-items or another first one; it counts the uses by
/// kernel, program and work-group size alone. With the same program in the queues of several devices it confuses those counts, and version 3.1
/// aborts (`pocl_release_dlhandle_cache: Assertion found->ref_count > 0`). Programs that differ in one macro are apart.
#[derive(Debug)]
pub(super) struct Seat {
    program: u64,
    number: u32,
}

/// The smallest number that is not among these.
fn smallest_free(taken: &BTreeSet<u32>) -> u32 {
    (0..).find(|n| !taken.contains(n)).unwrap_or(u32::MAX)
}

fn taken() -> MutexGuard<'static, Taken> {
    TAKEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// True for PoCL before version 6. That of Debian 12 (3.1) was seen to abort; sources of 2024 and later release what they took, so that
/// versions between are doubtful.
fn confuses_counts(info: &DeviceInfo) -> bool {
    let major = info.driver.split('.').next().and_then(|v| v.parse().ok());
    info.platform == "Portable Computing Language" && major.is_none_or(|major: u32| major < 6)
}

impl Seat {
    /// True if programs of a device need numbers.
    pub fn is_needed(info: &DeviceInfo) -> bool {
        confuses_counts(info)
    }

    fn hash(text: &str) -> u64 {
        let mut hasher = FxHasher::default();
        text.hash(&mut hasher);
        hasher.finish()
    }

    /// A number for a device's program of this text; `None` if the driver needs none.
    pub fn of(info: &DeviceInfo, text: &str) -> Option<Self> {
        Self::is_needed(info).then(|| {
            let (program, mut taken) = (Self::hash(text), taken());
            let numbers = taken.entry(program).or_default();
            let number = smallest_free(numbers);
            numbers.insert(number);
            Self { program, number }
        })
    }

    /// Further options that the program is built with; none for the smallest, whose compiled kernels all processes share.
    pub fn options(&self) -> String {
        match self.number {
            0 => String::new(),
            number => format!(" -DMHSPLAT_SEAT={number}"),
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut taken = taken();
        if let Some(numbers) = taken.get_mut(&self.program) {
            numbers.remove(&self.number);
            if numbers.is_empty() {
                taken.remove(&self.program);
            }
        }
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
    fn seats_of_a_program_differ_as_long_as_they_are_held() {
        let info = of_driver("Portable Computing Language", "3.1");
        let at = |text| Seat::of(&info, text);
        let seats: Vec<Seat> = (0..4).filter_map(|_| at("one of its own")).collect();
        let options: BTreeSet<String> = seats.iter().map(Seat::options).collect();
        assert_eq!(options.len(), 4, "{options:?}");
        assert_eq!(at("another of its own").unwrap().options(), "");
        let held: Vec<&Seat> = seats.iter().filter(|seat| seat.number == 2).collect();
        assert_eq!(held[0].options(), " -DMHSPLAT_SEAT=2");
        drop(seats);
        assert_eq!(at("one of its own").unwrap().options(), "");
        let program = Seat::hash("one of its own");
        assert!(
            !taken().contains_key(&program),
            "what nobody holds is forgotten"
        );
        assert_eq!(smallest_free(&BTreeSet::from([0, 1, 3])), 2);
        assert_eq!(smallest_free(&BTreeSet::from([1])), 0);
    }
}
