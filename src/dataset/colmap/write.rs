//! Writers, for synthetic scenes.

use std::fmt::Write as _;
use std::path::Path;

use super::{ColmapModel, MODELS};
use crate::error::{Error, Result};

fn put(folder: &Path, name: &str, bytes: &[u8]) -> Result<()> {
    let file = folder.join(name);
    std::fs::write(&file, bytes).map_err(|e| Error::io(file, e))
}

/// Writes `cameras.bin`, `images.bin` and `points3D.bin` into an existing folder. Features and tracks are empty.
///
/// # Errors
/// [`Error::Io`].
pub fn write_bin(folder: &Path, model: &ColmapModel) -> Result<()> {
    let count = |n: usize| (n as u64).to_le_bytes();
    let reals = |v: &[f64]| v.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let mut out = count(model.cameras.len()).to_vec();
    for c in &model.cameras {
        let id = MODELS.iter().position(|(m, _)| *m == c.model).unwrap_or(0) as u32;
        out.extend(c.id.to_le_bytes());
        out.extend(id.to_le_bytes());
        out.extend(c.width.to_le_bytes());
        out.extend(c.height.to_le_bytes());
        out.extend(reals(&c.params));
    }
    put(folder, "cameras.bin", &out)?;
    let mut out = count(model.images.len()).to_vec();
    for i in &model.images {
        out.extend(i.id.to_le_bytes());
        out.extend(reals(&i.rotation));
        out.extend(reals(&i.translation));
        out.extend(i.camera.to_le_bytes());
        out.extend(i.name.as_bytes());
        out.push(0);
        out.extend(count(0));
    }
    put(folder, "images.bin", &out)?;
    let mut out = count(model.points.len()).to_vec();
    for (k, p) in model.points.iter().enumerate() {
        out.extend((k as u64 + 1).to_le_bytes());
        out.extend(reals(&p.position));
        out.extend(p.color);
        out.extend(reals(&[0.0]));
        out.extend(count(0));
    }
    put(folder, "points3D.bin", &out)
}

/// Writes `cameras.txt`, `images.txt` and `points3D.txt` into an existing folder. Numbers are written so that they are
/// read back bit for bit.
///
/// # Errors
/// [`Error::Io`].
pub fn write_txt(folder: &Path, model: &ColmapModel) -> Result<()> {
    let join = |v: &[f64]| {
        v.iter()
            .map(|x| format!("{x:?}"))
            .collect::<Vec<_>>()
            .join(" ")
    };
    let mut out = String::from("# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n");
    for c in &model.cameras {
        let _ = writeln!(
            out,
            "{} {} {} {} {}",
            c.id,
            c.model,
            c.width,
            c.height,
            join(&c.params)
        );
    }
    put(folder, "cameras.txt", out.as_bytes())?;
    let mut out =
        String::from("# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of features\n");
    for i in &model.images {
        let pose = [i.rotation.as_slice(), i.translation.as_slice()].concat();
        let _ = writeln!(out, "{} {} {} {}\n", i.id, join(&pose), i.camera, i.name);
    }
    put(folder, "images.txt", out.as_bytes())?;
    let mut out = String::from("# POINT3D_ID X Y Z R G B ERROR TRACK[]\n");
    for (k, p) in model.points.iter().enumerate() {
        let [r, g, b] = p.color;
        let _ = writeln!(out, "{} {} {r} {g} {b} 0", k + 1, join(&p.position));
    }
    put(folder, "points3D.txt", out.as_bytes())
}
