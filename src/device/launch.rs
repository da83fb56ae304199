//! Kernels whose arguments are checked at every launch.

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ocl_core::{
    self as core, ArgVal, Event, KernelArgInfo, KernelInfo, KernelInfoResult, KernelWorkGroupInfo,
    KernelWorkGroupInfoResult,
};

use crate::base::constants::{GROUP_SPREAD, SHARING_GROUPS, SPLAT_BATCH};
use crate::base::error::{Error, Result};
use crate::device::array::Array;
use crate::device::context::{Enqueued, Inner};
use crate::device::defines::Defines;
use crate::device::error::{BUG, LOST, device_error};
use crate::device::info::DeviceInfo;
use crate::device::layout::{Element, ImageSize, Real};

/// The kernels of one stage and the choices that they were compiled with.
#[derive(Debug)]
pub struct Program {
    pub(super) defines: Defines,
    pub(super) stage: &'static str,
    pub(super) kernels: Vec<Kernel>,
    pub(super) device: Arc<Inner>,
}

/// A compiled kernel.
#[derive(Debug)]
pub(super) struct Kernel {
    kernel: Mutex<core::Kernel>,
    name: String,
    types: Vec<String>,
    /// Work-items of the largest work-group that the kernel can run in on this device.
    most: usize,
    /// True if the kernel runs in work-groups of one size alone.
    fixed: bool,
}

/// Argument list under construction; see [`Program::launch`].
pub struct Launch<'a> {
    owner: &'a Program,
    name: &'static str,
    counted_as: &'static str,
    types: &'a [String],
    kernel: Result<MutexGuard<'a, core::Kernel>>,
    most: usize,
    fixed: bool,
    next: u32,
    /// The first work-item of each axis.
    first: [usize; 2],
}

/// Advice where a device has no room for a work-group per tile.
const WITHOUT_GROUPS: &str = "train without work-groups, slowly: \
                              MHSPLAT_TUNING=vector-width=1,block-width=1,group-style=false,radix-bits=4";

/// A work-group of no more than `most` work-items in the place of a larger one; `None` if the kernel needs the larger one.
fn fitting(local: [usize; 2], most: usize, fixed: bool) -> Option<[usize; 2]> {
    let fits = local[0] * local[1] <= most;
    let smaller = [(most / local[1]).clamp(1, local[0]), local[1]];
    match (fits, fixed) {
        (true, _) => Some(local),
        (false, true) => None,
        (false, false) => Some(smaller),
    }
}

/// Name of an argument's type without what drivers spell in different ways: spaces, qualifiers, `struct`, and C's names of the unsigned
/// types.
fn plain_type(given: &str) -> String {
    let pointer = given.contains('*');
    let given = given.replace('*', " ");
    let apart =
        "const volatile restrict struct __global __private __constant global private constant";
    let apart: Vec<&str> = apart.split(' ').collect();
    let words: Vec<&str> = given
        .split_whitespace()
        .filter(|word| !apart.contains(word))
        .collect();
    let name = match words.as_slice() {
        ["unsigned"] => "uint".to_owned(),
        ["unsigned", name] => format!("u{name}"),
        words => words.join(" "),
    };
    if pointer { format!("{name}*") } else { name }
}

impl Kernel {
    pub(super) fn new(inner: &Inner, program: &core::Program, name: &str) -> Result<Self> {
        let fail = |e: core::Error| device_error(name, &e, BUG);
        let kernel = core::create_kernel(program, name).map_err(fail)?;
        let KernelInfoResult::NumArgs(n) =
            core::get_kernel_info(&kernel, KernelInfo::NumArgs).map_err(fail)?
        else {
            return Err(Error::device(
                name,
                "no number of arguments",
                "update the driver",
            ));
        };
        // Drivers may answer without -cl-kernel-arg-info support; then lengths alone are checked.
        let types = (0..n)
            .map(|i| {
                core::get_kernel_arg_info(&kernel, i, KernelArgInfo::TypeName, None)
                    .map_or_else(|_| String::new(), |t| plain_type(&t.to_string()))
            })
            .collect();
        let of = |what| core::get_kernel_work_group_info(&kernel, inner.id, what);
        let most = match of(KernelWorkGroupInfo::WorkGroupSize) {
            Ok(KernelWorkGroupInfoResult::WorkGroupSize(most)) if most > 0 => most,
            _ => inner.info.max_work_group,
        };
        let size = of(KernelWorkGroupInfo::CompileWorkGroupSize);
        let fixed =
            matches!(size, Ok(KernelWorkGroupInfoResult::CompileWorkGroupSize([n, ..])) if n > 0);
        Ok(Self {
            kernel: Mutex::new(kernel),
            name: name.to_owned(),
            types,
            most,
            fixed,
        })
    }
}

impl Program {
    /// Choices that the kernels were compiled with.
    #[must_use]
    pub fn defines(&self) -> &Defines {
        &self.defines
    }

    /// Number of chunks that a long array is cut into.
    #[must_use]
    pub fn chunks(&self) -> usize {
        self.defines.tuning.chunks
    }

    /// Properties that the device reports.
    #[must_use]
    pub fn info(&self) -> &DeviceInfo {
        &self.device.info
    }

    /// Lanes of a vector.
    #[must_use]
    pub fn lanes(&self) -> usize {
        self.defines.tuning.vector_width as usize
    }

    /// Number of vectors that hold `count` Gaussians.
    #[must_use]
    pub fn vectors(&self, count: usize) -> usize {
        count.div_ceil(self.lanes())
    }

    /// An empty argument list of the kernel of this name; arguments follow in the order of its signature.
    pub fn launch(&self, name: &'static str) -> Launch<'_> {
        let found = self.kernels.iter().find(|k| k.name == name);
        let guard = found.map(|k| k.kernel.lock().unwrap_or_else(PoisonError::into_inner));
        Launch {
            owner: self,
            name,
            counted_as: self.stage,
            types: found.map_or(&[], |k| &k.types),
            most: found.map_or(1, |k| k.most),
            fixed: found.is_some_and(|k| k.fixed),
            kernel: guard.ok_or_else(|| Error::device(name, "no such kernel", BUG)),
            next: 0,
            first: [0, 0],
        }
    }
}

impl Launch<'_> {
    /// Counts the time under another stage's name.
    #[must_use]
    pub fn counted_as(self, stage: &'static str) -> Self {
        Self {
            counted_as: stage,
            ..self
        }
    }

    fn fail(&mut self, what: String) {
        self.kernel = Err(Error::device(self.name, what, BUG));
    }

    fn set(mut self, type_name: &str, pointer: bool, value: ArgVal<'_>) -> Self {
        let Ok(kernel) = &self.kernel else {
            return self;
        };
        let found = self.types.get(self.next as usize).map(String::as_str);
        let matches = match found {
            None => false,
            Some("") => true,
            Some(t) => t.trim_end_matches('*') == type_name && t.ends_with('*') == pointer,
        };
        if !matches {
            let star = if pointer { "*" } else { "" };
            let found = found.unwrap_or("fewer arguments");
            self.fail(format!(
                "argument {} is {type_name}{star}; the kernel takes {found}",
                self.next
            ));
            return self;
        }
        if let Err(e) = core::set_kernel_arg(kernel, self.next, value) {
            self.kernel = Err(device_error(self.name, &e, BUG));
        }
        self.next += 1;
        self
    }

    /// Choices that the kernel was compiled with.
    #[must_use]
    pub fn defines(&self) -> &Defines {
        &self.owner.defines
    }

    /// Adds a device array of at least `len` values.
    #[must_use]
    pub fn array<T: Element>(mut self, array: &Array<T>, len: usize) -> Self {
        if self.kernel.is_ok() && array.len() < len {
            let (name, has) = (array.name(), array.len());
            self.fail(format!("{name} holds {has} values; {len} are needed"));
        }
        self.set(T::NAME, true, ArgVal::mem(&array.mem))
    }

    /// Adds device arrays of at least `len` values each.
    #[must_use]
    pub fn arrays<T: Element, const K: usize>(self, arrays: [&Array<T>; K], len: usize) -> Self {
        arrays.into_iter().fold(self, |l, a| l.array(a, len))
    }

    /// Adds a value.
    #[must_use]
    pub fn value<T: Element>(self, value: T) -> Self {
        self.set(T::NAME, false, ArgVal::scalar(&value))
    }

    /// Adds numbers as `real`.
    #[must_use]
    pub fn reals<R: Real>(self, values: impl IntoIterator<Item = f64>) -> Self {
        values.into_iter().fold(self, |l, v| l.value(R::of(v)))
    }

    /// Adds numbers as `int`.
    #[must_use]
    pub fn ints<const K: usize>(self, values: [usize; K]) -> Self {
        values.into_iter().fold(self, |l, v| l.value(v as i32))
    }

    /// Adds numbers as `uint`.
    #[must_use]
    pub fn uints<const K: usize>(self, values: [usize; K]) -> Self {
        values.into_iter().fold(self, |l, v| l.value(v as u32))
    }

    /// Adds the tiles per row and the tiles in all of an image, as `int`.
    #[must_use]
    pub fn tiles(self, size: ImageSize) -> Self {
        self.ints([size.tiles()[0], size.tile_count()])
    }

    /// Enqueues the kernel with a work-item for each vector of `count` Gaussians. Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn over_gaussians(self, count: usize) -> Result<()> {
        self.over_rows(0..count)
    }

    /// Enqueues the kernel with a work-item for each vector of some Gaussians, the first of which begins a vector. Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn over_rows(self, rows: Range<usize>) -> Result<()> {
        let (lanes, local) = (self.owner.lanes(), self.defines().tuning.lane_local());
        let launch = self.starting_at([rows.start / lanes, 0]);
        launch.run([rows.len().div_ceil(lanes), 1], [local, 1])
    }

    /// Enqueues the kernel with a work-item for each of the optimiser's runs of some Gaussians, the first of which begins one. Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn over_runs(self, rows: Range<usize>) -> Result<()> {
        let tuning = self.defines().tuning;
        let run = tuning.update_run();
        let launch = self.starting_at([rows.start / run, 0]);
        launch.run([rows.len().div_ceil(run), 1], [tuning.run_local(), 1])
    }

    /// Enqueues the kernel with a work-item for each batch of `count` Gaussians whose scattered records it fetches together, to have
    /// their cache misses at one time. Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn over_batches(self, count: usize) -> Result<()> {
        self.run([count.div_ceil(SPLAT_BATCH as usize), 1], [1, 1])
    }

    /// Enqueues the kernel with a work-item, or a work-group, for each tile of some rows of tiles of an image. Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn over_tiles(self, size: ImageSize, rows: &Range<usize>) -> Result<()> {
        let items = self.defines().tuning.tile_pixels();
        self.over_tiles_by(size, rows, items)
    }

    /// Enqueues the kernel with a work-group of so many work-items for each tile of some rows of tiles of an image, or a work-item where
    /// each is a whole core. Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn over_tiles_by(self, size: ImageSize, rows: &Range<usize>, items: usize) -> Result<()> {
        let group = match self.defines().tuning.group_style {
            true => items,
            false => 1,
        };
        let row = size.tiles()[0] * group;
        if rows.is_empty() {
            // A launch has one work-group at least, beyond the image here.
            return self.kernel.map(|_| ());
        }
        let launch = self.starting_at([rows.start * row, 0]);
        launch.run([rows.len() * row, 1], [group, 1])
    }

    /// The same beginning with another work-item than the first of each axis.
    #[must_use]
    pub fn starting_at(self, first: [usize; 2]) -> Self {
        Self { first, ..self }
    }

    /// Enqueues the kernel with so many work-groups of a work-item per pixel of a tile, or work-items where each is a whole core.
    /// Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn over_groups(self, groups: usize) -> Result<()> {
        let group = self.defines().tuning.tile_group();
        self.run([groups * group, 1], [group, 1])
    }

    /// Adds the number of Gaussians that a work-group has, 8 to 256 of `count`, and enqueues the kernel with so many groups that all have
    /// one, of a work-item per pixel of a tile. A group has few where there are few in all: large ones, for which it takes all its
    /// work-items, are shared out over the whole device. Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn over_shared(self, count: usize) -> Result<()> {
        let most = self.defines().tuning.tile_group();
        let owns = count
            .div_ceil(SHARING_GROUPS)
            .next_multiple_of(GROUP_SPREAD);
        let owns = owns.clamp(GROUP_SPREAD, most);
        self.uints([owns]).over_groups(count.div_ceil(owns))
    }

    /// Enqueues the kernel with small work-items, such as one for each Gaussian and plane. Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn over_items(self, items: [usize; 2]) -> Result<()> {
        let local = self.defines().tuning.local;
        self.run(items, [local, 1])
    }

    /// Enqueues the kernel with large work-items, such as one for each chunk of an array or row of an image. Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn over_chunks(self, chunks: [usize; 2]) -> Result<()> {
        let local = self.defines().tuning.coarse_local();
        self.run(chunks, [local, 1])
    }

    /// Enqueues the kernel with one work-item. Does not wait.
    ///
    /// # Errors
    /// Those of [`Launch::run`].
    pub fn once(self) -> Result<()> {
        self.run([1, 1], [1, 1])
    }

    /// Enqueues the kernel over `global` work-items (rounded up to whole work-groups of `local`, or of fewer where the device has no room
    /// for so many: its registers may be too few). Does not wait.
    ///
    /// # Errors
    /// A wrong argument, no room for a work-group per tile, or the driver's.
    pub fn run(mut self, global: [usize; 2], local: [usize; 2]) -> Result<()> {
        let Some(local) = fitting(local, self.most, self.fixed) else {
            let what = format!("the device runs it in work-groups of {} at most", self.most);
            return Err(Error::device(self.name, what, WITHOUT_GROUPS));
        };
        let (given, expected) = (self.next as usize, self.types.len());
        if self.kernel.is_ok() && given != expected {
            self.fail(format!("{given} arguments given; {expected} expected"));
        }
        let kernel = self.kernel?;
        let size = |k: usize| global[k].max(1).next_multiple_of(local[k]);
        let first = [self.first[0], self.first[1], 0];
        let queue = self.owner.device.queue();
        let mut event = Event::null();
        // SAFETY: every argument has been set with its own type; kernels check their bounds against the counts given.
        unsafe {
            core::enqueue_kernel(
                &queue,
                &kernel,
                2,
                (first != [0; 3]).then_some(first),
                &[size(0), size(1), 1],
                Some([local[0], local[1], 1]),
                None::<&Event>,
                queue.is_timed().then_some(&mut event),
            )
        }
        .map_err(|e| device_error(self.name, &e, LOST))?;
        if queue.is_timed() {
            self.owner.device.add_launch(Enqueued {
                kernel: self.name,
                stage: self.counted_as,
                items: size(0) * size(1),
                event,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::{WITHOUT_GROUPS, fitting, plain_type};
    use crate::device::tuning::Tuning;

    #[test]
    fn work_groups_shrink_unless_the_kernel_needs_them_whole() {
        assert_eq!(fitting([128, 1], 1024, false), Some([128, 1]));
        assert_eq!(fitting([128, 1], 96, false), Some([96, 1]));
        assert_eq!(fitting([16, 8], 64, false), Some([8, 8]));
        assert_eq!(fitting([256, 1], 256, true), Some([256, 1]));
        assert_eq!(fitting([256, 1], 128, true), None);
    }

    #[test]
    fn the_advice_names_sizes_that_there_are() {
        let (_, sizes) = WITHOUT_GROUPS.split_once('=').unwrap();
        let known = serde_json::to_value(Tuning::CPU).unwrap();
        for size in sizes.split(',') {
            let (name, _) = size.split_once('=').unwrap();
            assert!(known.get(name).is_some(), "{name}");
        }
    }

    #[test]
    fn types_are_told_apart_however_they_are_spelled() {
        let same = [
            ("float*", "float *"),
            ("float*", "__global const float*"),
            ("uint*", "volatile unsigned int *"),
            ("uchar*", "unsigned char*"),
            ("uint", "const uint"),
            ("uint", "unsigned"),
            ("Camera", "struct Camera"),
            ("Projected*", "global Projected * restrict"),
        ];
        for (plain, spelled) in same {
            assert_eq!(plain_type(spelled), plain);
            assert_eq!(plain_type(plain), plain);
        }
        assert_ne!(plain_type("float *"), plain_type("float"));
        assert_ne!(plain_type("unsigned int"), plain_type("int"));
    }
}
