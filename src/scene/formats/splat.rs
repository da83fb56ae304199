//! The `.splat` files of antimatter15's viewer: <https://github.com/antimatter15/splat>. 32 bytes per Gaussian without any header:
//! position and scale as f32, colour and opacity, and rotation w, x, y, z, as 8 bits. No SH, no mark of anti-aliasing.

use std::path::Path;

use crate::base::constants::LOG_SCALE;
use crate::base::error::{Error, Result};
use crate::base::math::sigmoid;
use crate::capture::Frame;
use crate::scene::formats::scene_file::{Rounding, SceneFile, limited_logit, localized, unit};
use crate::scene::gaussians::Plane;
use crate::scene::sh::C0;

/// Bytes of a Gaussian.
const STRIDE: usize = 32;

/// Reads a file.
///
/// # Errors
/// [`Error::Input`] for a length that is no multiple of 32 bytes, or a number that is none.
pub(super) fn read(path: &Path, bytes: &[u8], frame: &Frame) -> Result<SceneFile> {
    const FIX: &str = "export the .splat file again";
    let length = bytes.len();
    if !length.is_multiple_of(STRIDE) {
        let what = format!("{length} bytes; a multiple of {STRIDE} expected in a .splat file");
        return Err(Error::input(path, what, FIX));
    }
    let mut planes = vec![Vec::with_capacity(length / STRIDE); Plane::count(0)];
    for (i, row) in bytes.chunks_exact(STRIDE).enumerate() {
        let float = |k: usize| {
            let four = row[4 * k..].first_chunk().copied().unwrap_or_default();
            f32::from_le_bytes(four)
        };
        for k in 0..3 {
            let (position, scale) = (float(k), float(3 + k));
            if !(position.is_finite() && scale.is_finite() && scale >= 0.0) {
                let what = format!(
                    "position {position}, scale {scale} of Gaussian {i}; finite numbers and no negative scale expected"
                );
                return Err(Error::input(path, what, FIX));
            }
            planes[Plane::POSITION + k].push(position);
            let log_scale = f64::from(scale).ln().max(LOG_SCALE[0]);
            planes[Plane::LOG_SCALE + k].push(log_scale as f32);
            let color = f64::from(row[24 + k]) / 255.0;
            planes[Plane::SH + k].push(((color - 0.5) / C0) as f32);
        }
        planes[Plane::OPACITY].push(limited_logit(f64::from(row[27]) / 255.0));
        for k in 0..4 {
            planes[Plane::ROTATION + k].push((f32::from(row[28 + k]) - 128.0) / 128.0);
        }
    }
    localized(path, 0, planes, frame).map(SceneFile::new)
}

/// The bytes of a file, and remarks on what the format cannot hold. The scene is in the dataset's frame.
pub(super) fn encode(scene: &SceneFile) -> (Vec<u8>, Vec<String>) {
    let splats = &scene.splats;
    let mut bytes = Vec::with_capacity(STRIDE * splats.len());
    let [mut opacities, mut colors, mut rotations] = [(); 3].map(|()| Rounding::default());
    let mut scales = 0;
    for i in 0..splats.len() {
        let position: [f32; 3] = splats.gather(Plane::POSITION, i);
        bytes.extend(position.iter().flat_map(|v| v.to_le_bytes()));
        for log_scale in splats.gather::<3>(Plane::LOG_SCALE, i).map(f64::from) {
            let kept = log_scale.clamp(LOG_SCALE[0], LOG_SCALE[1]);
            scales += usize::from(kept != log_scale);
            bytes.extend((kept.exp() as f32).to_le_bytes());
        }
        let color = splats.gather::<3>(Plane::SH, i).map(f64::from);
        bytes.extend(color.map(|v| colors.byte(255.0 * (0.5 + C0 * v))));
        let [opacity] = splats.gather(Plane::OPACITY, i).map(f64::from);
        bytes.push(opacities.byte(255.0 * sigmoid(opacity)));
        // 128 steps up to 1, which the last byte misses by one.
        let rotation = unit(splats.gather(Plane::ROTATION, i));
        bytes.extend(rotation.map(|v| rotations.byte((128.0 * v + 128.0).min(255.0))));
    }
    let [least, most] = LOG_SCALE;
    let bands = splats.sh_degree() > 0;
    let remarks = [
        (scales > 0).then(|| format!("{scales} scales outside of e^{least} to e^{most} were clamped")),
        colors.remark("colours", "0 to 1"),
        bands.then(|| "view-dependent colour is left out: .splat has none".to_owned()),
        scene.anti_aliased.then(|| {
            "the mark of anti-aliasing is left out: .splat has none, and viewers will draw the scene without the 2D filter".to_owned()
        }),
    ];
    (bytes, remarks.into_iter().flatten().collect())
}
