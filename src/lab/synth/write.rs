//! Files of a synthetic dataset.

use std::fs;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::base::error::{Error, Result};
use crate::capture::colmap::{ColmapModel, ColmapPoint};
use crate::capture::transforms::write_transforms;
use crate::capture::{Camera, Frame, Points, point_cloud};
use crate::lab::synth::options::SynthLayout;
use crate::lab::synth::render::Sample;

/// Number of photos from one held-out photo to the next.
pub(super) const TEST_EVERY: usize = 8;

/// Path of photo `i` below the dataset's folder.
pub(super) fn photo_name(layout: SynthLayout, i: usize) -> String {
    match layout {
        SynthLayout::Transforms if i.is_multiple_of(TEST_EVERY) => format!("test/r_{i:04}.png"),
        SynthLayout::Transforms => format!("train/r_{i:04}.png"),
        _ => format!("images/view_{i:04}.png"),
    }
}

/// Writes rows of RGB (or RGBA) bytes as a PNG, folders included, with fixed settings so that the same pixels give the same
/// file.
pub(super) fn png(path: &Path, pixels: &[u8], camera: &Camera, alpha: bool) -> Result<()> {
    let color = if alpha {
        ExtendedColorType::Rgba8
    } else {
        ExtendedColorType::Rgb8
    };
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::Adaptive)
        .write_image(pixels, camera.width, camera.height, color)
        .map_err(|e| Error::io(path, std::io::Error::other(e)))?;
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    }
    fs::write(path, bytes).map_err(|e| Error::io(path, e))
}

/// Writes cameras and points in a layout; photos are named by their paths below `dir`.
pub(super) fn model(
    dir: &Path,
    layout: SynthLayout,
    views: &[(String, Camera)],
    points: &[Sample],
) -> Result<()> {
    if layout == SynthLayout::Transforms {
        return transforms(dir, views, points);
    }
    let folder = dir.join("sparse/0");
    fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
    // COLMAP knows photos by their paths below images/.
    let bare = |(name, camera): &(String, Camera)| {
        (name.trim_start_matches("images/").to_owned(), *camera)
    };
    let views: Vec<(String, Camera)> = views.iter().map(bare).collect();
    let points = points.iter().zip(1..).map(|(s, id)| ColmapPoint {
        id,
        position: s.position.to_array(),
        color: s.color,
        error: 0.0,
    });
    let model = ColmapModel::from_views(&views, points.collect());
    model.write(&folder, layout != SynthLayout::ColmapTxt)
}

/// Writes `transforms_train.json`, `transforms_test.json` and `points3d.ply`.
fn transforms(dir: &Path, views: &[(String, Camera)], points: &[Sample]) -> Result<()> {
    for (split, test) in [("train", false), ("test", true)] {
        let part: Vec<(String, Camera)> = views
            .iter()
            .enumerate()
            .filter(|(i, _)| i.is_multiple_of(TEST_EVERY) == test)
            .map(|(_, view)| view.clone())
            .collect();
        let file = dir.join(format!("transforms_{split}.json"));
        write_transforms(&file, &part, Some("points3d.ply"))?;
    }
    let position = |s: &Sample| s.position.as_vec3().to_array();
    let cloud = Points {
        positions: points.iter().map(position).collect(),
        colors: points.iter().map(|s| s.color).collect(),
    };
    point_cloud::write(&dir.join("points3d.ply"), &cloud, &Frame::IDENTITY)
}
