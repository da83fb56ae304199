//! A quick check of a device before a run: every stage of one scene, in the precision and style of training.

use crate::base::error::{Error, Result};
use crate::device::Device;
use crate::lab::cache;
use crate::lab::verify::cases::mild;
use crate::lab::verify::check::{Row, check};
use crate::lab::verify::definition::Reference;
use crate::lab::verify::pass;

/// Refuses a device that computes wrong results. A device that passed is not checked again: the result is kept per
/// device, driver, kernels and tuning.
///
/// # Errors
/// [`Error::Device`] that names the stage and its error; a build failure, or the driver's.
pub fn self_test(device: &Device) -> Result<()> {
    let of = (device.tuning(), env!("CARGO_PKG_VERSION"));
    let kept = cache::file("selftest", device.info(), of);
    if kept.as_ref().is_some_and(|f| f.is_file()) {
        return Ok(());
    }
    judge(&rows(device)?)?;
    if let Some(file) = kept {
        cache::keep(&file, b"\"passed\"\n");
    }
    Ok(())
}

/// Comparisons of every stage of one scene.
pub fn rows(device: &Device) -> Result<Vec<Row>> {
    // The SH degree of training, whose kernels are needed anyway.
    let mut case = mild("self-test", 300, [75, 50], 3, 7);
    case.family = "self-test";
    let reference = Reference::new(&case);
    let out = pass::run::<f32>(device, device.tuning(), &case, Some(&reference))?;
    Ok(check(&case, &out, "f32", case.bound))
}

/// Fails if a comparison failed.
///
/// # Errors
/// [`Error::Device`] for the first that failed.
pub fn judge(rows: &[Row]) -> Result<()> {
    match rows.iter().find(|r| !r.pass) {
        None => Ok(()),
        Some(r) => Err(Error::device(
            "self-test",
            format!(
                "this device computes wrong results: stage {}, {}: error {:.1e} where {:.0e} is allowed, {} elements beyond it, {} not finite",
                r.stage, r.quantity, r.max_rel_error, r.bound, r.flips, r.non_finite
            ),
            "select another device with --device, or update the driver; `mhsplat verify` shows every stage",
        )),
    }
}
