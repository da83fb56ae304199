//! Room in one buffer of a device: what does not fit is refused with the number that would.

use crate::base::constants::SUMS;
use crate::base::error::{Error, Result};
use crate::device::tuning::Tuning;
use crate::device::{Array, Device, ImageSize, Real};

/// Strides are multiples of this, so that vector loads of a plane never straddle two.
pub(super) const ROUND: usize = 256;

/// The text on an array of `planes` values of `size` bytes for each of `stride` Gaussians that is larger than `most` bytes: what is
/// wrong, and what to do; `None` if it is not.
fn too_many([planes, size]: [usize; 2], stride: usize, most: u64) -> Option<[String; 2]> {
    let each = planes * size;
    let bytes = (each * stride) as u64;
    if bytes <= most {
        return None;
    }
    let fit = (most / each as u64) as usize / ROUND * ROUND;
    // With room to grow into.
    let gaussians = fit - fit.div_ceil(5);
    Some([
        format!(
            "room for {stride} Gaussians is {bytes} bytes; the device allows {most} in one buffer"
        ),
        format!(
            "--max-gaussians {gaussians} keeps a new run to what fits; else lower --sh-degree, or select a device that allows more"
        ),
    ])
}

/// Refuses an array of values for each Gaussian that no buffer of the device can hold.
pub(crate) fn check_room<R: Real>(
    device: &Device,
    name: &'static str,
    planes: usize,
    stride: usize,
) -> Result<()> {
    match too_many([planes, size_of::<R>()], stride, device.info().max_alloc) {
        None => Ok(()),
        Some([what, fix]) => Err(Error::device(format!("allocate {name}"), what, fix)),
    }
}

/// `old` with another stride, the rows beyond the old ones zero.
pub(crate) fn restride<R: Real>(
    device: &Device,
    old: &Array<R>,
    planes: usize,
    from: usize,
    to: usize,
) -> Result<Array<R>> {
    check_room::<R>(device, old.name(), planes, to)?;
    let new = Array::unset(device, old.name(), planes * to)?;
    let kept = from.min(to);
    for p in 0..planes {
        new.copy_from(p * to, old, p * from, kept)?;
        new.clear_range(p * to + kept, to - kept)?;
    }
    Ok(new)
}

/// Refuses Gaussians, with room for so many and so many f32 values each, that take more than the memory of a device, bytes.
pub(crate) fn check_memory([rows, room, planes]: [usize; 3], memory: u64) -> Result<()> {
    let needed = (planes * room * size_of::<f32>()) as u64;
    if needed <= memory {
        return Ok(());
    }
    let [needed, memory] = [needed, memory].map(|bytes| bytes as f64 / 1e9);
    let what = format!(
        "{rows} Gaussians take {needed:.1} GB on one device, which has {memory:.1} GB of memory"
    );
    Err(Error::numerics("gather", what))
}

/// Bytes that the largest array of the pairs of a view takes for each, rounded up.
fn bytes_per_pair<R: Real>(tuning: &Tuning, gradients: bool) -> usize {
    let size = size_of::<R>();
    let segment = tuning.grad_segment as usize;
    let snapshots = (tuning.snapshot_values(segment) * size).div_ceil(segment);
    match (gradients, tuning.group_style) {
        (false, _) => size_of::<u32>(),
        (true, false) => SUMS * size,
        (true, true) => snapshots.max(SUMS * size),
    }
}

/// View whose pairs need room.
pub(super) struct Load {
    /// Pairs that it has.
    pub(super) pairs: usize,
    /// Gaussians of its scene.
    pub(super) gaussians: usize,
    /// Longer side of its image, pixels.
    pub(super) longest: usize,
}

/// Most pairs that buffers of at most `most` bytes have room for, or the text on a view that has more: what is wrong, and what to do. The
/// numbers in it take pairs to be proportional to Gaussians and to pixels.
fn pairs_within(each: usize, view: &Load, most: u64) -> std::result::Result<usize, [String; 2]> {
    // Slots are numbered by 32 bits.
    let fit = ((most / each as u64) as usize).min(u32::MAX as usize) / ROUND * ROUND;
    if view.pairs <= fit {
        return Ok(fit);
    }
    let share = fit as f64 / view.pairs as f64;
    let gaussians = (view.gaussians as f64 * share) as usize;
    let longest = (view.longest as f64 * share.sqrt()) as usize;
    Err([
        format!(
            "a view has {} (tile, Gaussian) pairs, and the device has room for {fit}: it allows {most} bytes in one buffer",
            view.pairs
        ),
        format!(
            "--max-gaussians {gaussians} or --max-size {longest} brings a new run near to what fits; else select a device that allows more"
        ),
    ])
}

/// Most pairs that the device has room for; refuses a view that has more.
pub(super) fn most_pairs<R: Real>(
    device: &Device,
    tuning: &Tuning,
    gradients: bool,
    view: &Load,
) -> Result<usize> {
    let each = bytes_per_pair::<R>(tuning, gradients);
    pairs_within(each, view, device.info().max_alloc)
        .map_err(|[what, fix]| Error::device("allocate pairs", what, fix))
}

/// The text on an array of `bytes` for images of a size that is larger than `most` bytes: what is wrong, and what to do; `None` if it is
/// not.
fn too_large(bytes: impl Fn(ImageSize) -> u64, size: ImageSize, most: u64) -> Option<[String; 2]> {
    if bytes(size) <= most {
        return None;
    }
    let [width, height] = size.pixels;
    let longest = width.max(height);
    let at = |side: usize| ImageSize {
        pixels: size.pixels.map(|s| (s * side).div_ceil(longest)),
        ..size
    };
    let share = (most as f64 / bytes(size) as f64).sqrt();
    let near = (longest as f64 * share) as usize;
    let fits = (1..=near).rev().find(|side| bytes(at(*side)) <= most);
    let fix = match fits {
        Some(side) if side >= size.tile => {
            format!(
                "images of at most {side} pixels a side fit (--max-size {side} in a new run); else select a device that allows more"
            )
        }
        _ => "select a device that allows more".to_owned(),
    };
    let what = format!(
        "{} bytes for images of {width} × {height} pixels; the device allows {most} in one buffer",
        bytes(size)
    );
    Some([what, fix])
}

/// Bytes of planes of `each` bytes a pixel, with the padding of images.
fn plane_bytes(each: usize) -> impl Fn(ImageSize) -> u64 {
    move |size| (each * size.plane()) as u64
}

/// Bytes a pixel of the largest array of an image: the maps of the loss in the group style, three for each channel.
const LARGEST: usize = 9 * size_of::<f32>();

/// Bytes of a photo of so many planes.
pub(super) fn photo_bytes(planes: usize) -> impl Fn(ImageSize) -> u64 {
    move |size| (planes * size.pixels[0] * size.pixels[1]) as u64
}

/// The text on a photo that is larger than `most` bytes: what is wrong, and what to do; `None` if it is not. What fits is an image whose loss
/// can be computed.
fn photo_too_large(planes: usize, size: ImageSize, most: u64) -> Option<[String; 2]> {
    let [what, _] = too_large(photo_bytes(planes), size, most)?;
    let [_, fix] = too_large(plane_bytes(LARGEST), size, most)?;
    Some([what, fix])
}

/// Refuses a photo that no buffer of the device can hold, with the size that would fit.
pub(super) fn check_photo(device: &Device, planes: usize, size: ImageSize) -> Result<()> {
    match photo_too_large(planes, size, device.info().max_alloc) {
        None => Ok(()),
        Some([what, fix]) => Err(Error::device("allocate photo", what, fix)),
    }
}

/// Zeros in so many planes of images of a size.
///
/// # Errors
/// More than a buffer of the device can hold, with the size that would fit, or the driver's.
pub(crate) fn image_planes<R: Real>(
    device: &Device,
    name: &'static str,
    planes: usize,
    size: ImageSize,
) -> Result<Array<R>> {
    match too_large(
        plane_bytes(planes * size_of::<R>()),
        size,
        device.info().max_alloc,
    ) {
        None => Array::zeros(device, name, planes * size.plane()),
        Some([what, fix]) => Err(Error::device(format!("allocate {name}"), what, fix)),
    }
}

#[cfg(test)]
mod tests {
    use super::{Load, ROUND, bytes_per_pair, pairs_within, photo_too_large, plane_bytes};
    use super::{check_memory, too_large, too_many};
    use crate::device::ImageSize;
    use crate::device::tuning::Tuning;
    use crate::pipeline::buffers::GaussianBuffers;

    fn of(pixels: [usize; 2]) -> ImageSize {
        ImageSize { pixels, tile: 16 }
    }

    /// 59 planes and both moments of a million take 708 MB.
    #[test]
    fn a_scene_larger_than_the_memory_of_a_device_is_not_gathered() {
        let check = |memory: u64| check_memory([1_000_000, 1_000_000, 177], memory);
        check(708_000_000).unwrap();
        let said = check(707_999_999).unwrap_err().to_string();
        assert!(said.contains("1000000 Gaussians take 0.7 GB"), "{said}");
    }

    #[test]
    fn a_buffer_that_is_too_large_says_how_many_gaussians_fit() {
        // 59 planes of f32, on a device of 2 GB.
        let (shape, most) = ([59, 4], 2_000_000_000);
        let refused = |n: usize| {
            let stride = GaussianBuffers::<f32>::grown_stride(n);
            too_many(shape, stride, most)
        };
        let [what, fix] = refused(10_000_000).unwrap();
        assert!(what.contains("2950052864 bytes"), "{what}");
        assert!(what.contains("2000000000 in one buffer"), "{what}");
        let (_, number) = fix.split_once("--max-gaussians ").unwrap();
        let n: usize = number.split(' ').next().unwrap().parse().unwrap();
        assert!(n > 6_700_000 && refused(n).is_none(), "{n}");
        assert!(refused(n + ROUND).is_some(), "{n}");
    }

    #[test]
    fn planes_that_no_buffer_holds_are_refused_with_the_size_that_would_fit() {
        let most = 128 << 20;
        let refused = |side: usize| too_large(plane_bytes(9 * 4), of([side, side * 2 / 3]), most);
        let [what, fix] = refused(6000).unwrap();
        assert!(what.contains("6000 × 4000 pixels"), "{what}");
        let (_, number) = fix.split_once("--max-size ").unwrap();
        let side: usize = number.split(' ').next().unwrap().parse().unwrap();
        assert!(refused(side).is_none() && side > 2300, "{side}");
        assert!(refused(side + 32).is_some(), "{side}");
    }

    #[test]
    fn a_photo_that_no_buffer_holds_is_refused_with_the_size_that_would_fit() {
        // A device of 256 MB in all allows a quarter of it in one buffer.
        let most = 64 << 20;
        let refused = |side: usize| photo_too_large(4, of([side, side]), most);
        let [what, fix] = refused(12_000).unwrap();
        assert!(
            what.starts_with("576000000 bytes for images of 12000"),
            "{what}"
        );
        assert!(refused(4096).is_none() && refused(4097).is_some());
        // Nor are the maps of its loss refused then.
        let (_, number) = fix.split_once("--max-size ").unwrap();
        let side: usize = number.split(' ').next().unwrap().parse().unwrap();
        let maps = |side: usize| too_large(plane_bytes(9 * 4), of([side, side]), most);
        assert!(
            side > 1300 && maps(side).is_none() && maps(side + 16).is_some(),
            "{side}"
        );
    }

    #[test]
    fn pairs_that_no_buffer_holds_are_refused_with_the_number_that_would_fit() {
        let view = |pairs| Load {
            pairs,
            gaussians: 1_000_000,
            longest: 2000,
        };
        // Sums of nine f32 each; on GPUs colours and transmittance of a tile for every segment of its pairs.
        let each = bytes_per_pair::<f32>(&Tuning::CPU, true);
        assert_eq!(each, 36);
        assert_eq!(bytes_per_pair::<f32>(&Tuning::GPU, true), 64);
        assert_eq!(bytes_per_pair::<f32>(&Tuning::GPU, false), 4);
        let most = 36 * 1024 * 1024;
        assert_eq!(pairs_within(each, &view(1 << 20), most), Ok(1 << 20));
        let [what, fix] = pairs_within(each, &view(4 << 20), most).unwrap_err();
        assert!(
            what.contains("4194304") && what.contains("1048576"),
            "{what}"
        );
        assert!(fix.contains("--max-gaussians 250000 "), "{fix}");
        assert!(fix.contains("--max-size 1000 "), "{fix}");
    }
}
