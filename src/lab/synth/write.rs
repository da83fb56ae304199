//! Files of a synthetic dataset.

use std::fs;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::base::error::{Error, Result};
use crate::capture::colmap::{ColmapModel, ColmapPoint};
use crate::capture::{Camera, Points};
use crate::lab::synth::trace::Sample;

/// Writes a file, folders included.
pub(super) fn file(path: &Path, bytes: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    }
    fs::write(path, bytes).map_err(|e| Error::io(path, e))
}

/// Writes rows of RGB (or RGBA) bytes as a PNG, with fixed settings so that the same pixels give the same file.
pub(super) fn png(path: &Path, pixels: &[u8], width: u32, height: u32, alpha: bool) -> Result<()> {
    let color = if alpha {
        ExtendedColorType::Rgba8
    } else {
        ExtendedColorType::Rgb8
    };
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::Adaptive)
        .write_image(pixels, width, height, color)
        .map_err(|e| Error::io(path, std::io::Error::other(e)))?;
    file(path, &bytes)
}

/// COLMAP's model of the scene: PINHOLE, one shared camera, no features and no tracks.
pub(super) fn colmap_model(views: &[(String, Camera)], points: &[Sample]) -> ColmapModel {
    let points = points.iter().zip(1..).map(|(s, id)| ColmapPoint {
        id,
        position: s.position.to_array(),
        color: s.color,
        error: 0.0,
    });
    ColmapModel::from_views(views, points.collect())
}

/// The points in single precision.
pub(super) fn cloud(points: &[Sample]) -> Points {
    Points {
        positions: points
            .iter()
            .map(|s| s.position.as_vec3().to_array())
            .collect(),
        colors: points.iter().map(|s| s.color).collect(),
    }
}
