//! Files of a synthetic dataset.

use std::fs;
use std::path::Path;

use glam::{DMat3, DVec3};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use serde_json::{Value, json};

use super::trace::Sample;
use crate::dataset::Camera;
use crate::dataset::colmap::{
    ColmapCamera, ColmapImage, ColmapModel, ColmapPoint, write_bin, write_txt,
};
use crate::error::{Error, Result};

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
fn colmap_model(views: &[(String, Camera)], points: &[Sample]) -> ColmapModel {
    let cameras = views.iter().take(1).map(|(_, c)| ColmapCamera {
        id: 1,
        model: "PINHOLE",
        width: c.width.into(),
        height: c.height.into(),
        params: vec![c.fx, c.fy, c.cx, c.cy],
    });
    let images = views.iter().zip(1..).map(|((name, c), id)| ColmapImage {
        id,
        rotation: quaternion(c.rotation),
        translation: c.translation.to_array(),
        camera: 1,
        name: name.clone(),
    });
    let points = points.iter().map(|s| ColmapPoint {
        position: s.position.to_array(),
        color: s.color,
    });
    ColmapModel {
        cameras: cameras.collect(),
        images: images.collect(),
        points: points.collect(),
    }
}

/// Writes `sparse/0`, binary or as text.
pub(super) fn colmap(
    dir: &Path,
    views: &[(String, Camera)],
    points: &[Sample],
    text: bool,
) -> Result<()> {
    let folder = dir.join("sparse/0");
    fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
    let model = colmap_model(views, points);
    if text {
        write_txt(&folder, &model)
    } else {
        write_bin(&folder, &model)
    }
}

/// `transforms_<split>.json` with nerfstudio's keys and OpenGL camera-to-world matrices (x right, y up, z backwards). Names have
/// no extension, as in Blender's sets; readers of those append `.png`.
pub(super) fn transforms(dir: &Path, split: &str, views: &[&(String, Camera)]) -> Result<()> {
    let frames: Vec<Value> = views
        .iter()
        .map(|(name, c)| {
            let (w, o) = (c.rotation, c.center());
            let (x, y, z) = (w.row(0), -w.row(1), -w.row(2));
            let matrix = [
                [x.x, y.x, z.x, o.x],
                [x.y, y.y, z.y, o.y],
                [x.z, y.z, z.z, o.z],
                [0.0, 0.0, 0.0, 1.0],
            ];
            json!({ "file_path": format!("./{}", name.trim_end_matches(".png")), "transform_matrix": matrix })
        })
        .collect();
    let mut document = json!({ "ply_file_path": "points3d.ply", "frames": frames });
    if let (Some((_, c)), Some(map)) = (views.first(), document.as_object_mut()) {
        let angle = 2.0 * (0.5 * f64::from(c.width) / c.fx).atan();
        let numbers = [
            ("fl_x", c.fx),
            ("fl_y", c.fy),
            ("cx", c.cx),
            ("cy", c.cy),
            ("camera_angle_x", angle),
        ];
        map.extend(numbers.map(|(key, value)| (key.to_owned(), json!(value))));
        map.extend(
            [("w", c.width), ("h", c.height)].map(|(key, value)| (key.to_owned(), json!(value))),
        );
    }
    let text = format!("{document:#}\n");
    file(
        &dir.join(format!("transforms_{split}.json")),
        text.as_bytes(),
    )
}

/// Binary PLY with positions, normals and colours, the properties that readers of `points3d.ply` ask for.
pub(super) fn ply(path: &Path, points: &[Sample]) -> Result<()> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n",
        points.len()
    )
    .into_bytes();
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        bytes.extend(format!("property float {name}\n").bytes());
    }
    for name in ["red", "green", "blue"] {
        bytes.extend(format!("property uchar {name}\n").bytes());
    }
    bytes.extend(b"end_header\n");
    for s in points {
        for v in [s.position, s.normal] {
            bytes.extend(v.as_vec3().to_array().map(f32::to_le_bytes).concat());
        }
        bytes.extend(s.color);
    }
    file(path, &bytes)
}

/// Unit quaternion (w, x, y, z) of a rotation, w ≥ 0: the branch with the largest component, after Shepperd (1978).
fn quaternion(m: DMat3) -> [f64; 4] {
    let (a, b, c) = (m.row(0), m.row(1), m.row(2));
    let trace = a.x + b.y + c.z;
    let largest = trace.max(a.x).max(b.y).max(c.z);
    let q = if largest == trace {
        [1.0 + trace, c.y - b.z, a.z - c.x, b.x - a.y]
    } else if largest == a.x {
        [c.y - b.z, 1.0 + a.x - b.y - c.z, a.y + b.x, a.z + c.x]
    } else if largest == b.y {
        [a.z - c.x, a.y + b.x, 1.0 + b.y - a.x - c.z, b.z + c.y]
    } else {
        [b.x - a.y, a.z + c.x, b.z + c.y, 1.0 + c.z - a.x - b.y]
    };
    let xyz = DVec3::new(q[1], q[2], q[3]);
    let norm = (q[0] * q[0] + xyz.length_squared()).sqrt();
    let scale = if q[0] < 0.0 { -1.0 / norm } else { 1.0 / norm };
    q.map(|x| x * scale)
}
