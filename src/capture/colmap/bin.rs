//! Binary COLMAP models (little endian).

use std::path::{Path, PathBuf};

use crate::base::error::{Error, Result};
use crate::capture::colmap::model::{ColmapCamera, ColmapImage, ColmapModel, ColmapPoint, REBUILD};
use crate::capture::colmap::models::{Model, PINHOLE};

/// Reads `cameras.bin`, `images.bin` and, if there is one, `points3D.bin` in `dir`.
///
/// # Errors
/// A missing, truncated or overlong file; a camera model that is not read; a number that is not finite; no image.
pub fn read_bin(dir: &Path) -> Result<ColmapModel> {
    let file = |stem: &str| dir.join(format!("{stem}.bin"));
    let mut cursor = Cursor::open(file("cameras"))?;
    let cameras = cursor.list("camera", 24, camera)?;
    let mut cursor = Cursor::open(file("images"))?;
    let images = cursor.list("image", 73, image)?;
    let points = if file("points3D").is_file() {
        let mut cursor = Cursor::open(file("points3D"))?;
        cursor.list("point", 51, point)?
    } else {
        Vec::new()
    };
    let model = ColmapModel {
        cameras,
        images,
        points,
    };
    model.validate(file)?;
    Ok(model)
}

fn camera(cursor: &mut Cursor) -> Result<ColmapCamera> {
    let id = cursor.u32()?;
    let number = cursor.u32()?.cast_signed();
    let size = (cursor.u64()?, cursor.u64()?);
    let model = Model::from_id(&cursor.path, id, number)?;
    let mut params = Vec::with_capacity(model.count());
    for _ in 0..model.count() {
        params.push(cursor.f64()?);
    }
    model.camera(&cursor.path, id, size, &params)
}

fn image(cursor: &mut Cursor) -> Result<ColmapImage> {
    let image = ColmapImage {
        id: cursor.u32()?,
        rotation: cursor.f64s()?,
        translation: cursor.f64s()?,
        camera_id: cursor.u32()?,
        name: cursor.name()?,
    };
    cursor.skip_list(24)?; // x, y: f64; point: u64
    Ok(image)
}

fn point(cursor: &mut Cursor) -> Result<ColmapPoint> {
    let point = ColmapPoint {
        id: cursor.u64()?,
        position: cursor.f64s()?,
        color: cursor.take()?,
        error: cursor.f64()?,
    };
    cursor.skip_list(8)?; // image, observation: u32
    Ok(point)
}

/// Writes `cameras.bin`, `images.bin` and `points3D.bin` into `dir`, which is created where needed.
///
/// # Errors
/// [`Error::Io`] if the system refuses.
pub fn write_bin(dir: &Path, model: &ColmapModel) -> Result<()> {
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, e))?;
    let mut cameras = (model.cameras.len() as u64).to_le_bytes().to_vec();
    for c in &model.cameras {
        cameras.extend(c.id.to_le_bytes());
        cameras.extend(PINHOLE.to_le_bytes());
        cameras.extend(u64::from(c.width).to_le_bytes());
        cameras.extend(u64::from(c.height).to_le_bytes());
        cameras.extend(c.params.iter().flat_map(|v| v.to_le_bytes()));
    }
    let mut images = (model.images.len() as u64).to_le_bytes().to_vec();
    for i in &model.images {
        images.extend(i.id.to_le_bytes());
        images.extend(i.rotation.iter().flat_map(|v| v.to_le_bytes()));
        images.extend(i.translation.iter().flat_map(|v| v.to_le_bytes()));
        images.extend(i.camera_id.to_le_bytes());
        images.extend(i.name.as_bytes());
        images.push(0);
        images.extend(0_u64.to_le_bytes());
    }
    let mut points = (model.points.len() as u64).to_le_bytes().to_vec();
    for p in &model.points {
        points.extend(p.id.to_le_bytes());
        points.extend(p.position.iter().flat_map(|v| v.to_le_bytes()));
        points.extend(p.color);
        points.extend(p.error.to_le_bytes());
        points.extend(0_u64.to_le_bytes());
    }
    for (name, bytes) in [
        ("cameras.bin", cameras),
        ("images.bin", images),
        ("points3D.bin", points),
    ] {
        let file = dir.join(name);
        std::fs::write(&file, bytes).map_err(|e| Error::io(&file, e))?;
    }
    Ok(())
}

/// A bounds-checked reader with messages about the current record.
struct Cursor {
    path: PathBuf,
    bytes: Vec<u8>,
    at: usize,
    /// "camera 3", for messages.
    reading: String,
}

impl Cursor {
    fn open(path: PathBuf) -> Result<Self> {
        let bytes = std::fs::read(&path).map_err(|e| Error::io(&path, e))?;
        Ok(Self {
            path,
            bytes,
            at: 0,
            reading: "the count".into(),
        })
    }

    fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }

    fn truncated(&self, needed: u64) -> Error {
        Error::input(
            &self.path,
            format!(
                "the file ends within {}: {needed} bytes expected at offset {}, {} left",
                self.reading,
                self.at,
                self.remaining()
            ),
            REBUILD,
        )
    }

    /// All records of the file: a count, then `read` for each. `least` is the smallest size of a record in
    /// bytes; a count that cannot fit into the file is refused before anything is allocated.
    fn list<T>(
        &mut self,
        what: &str,
        least: usize,
        read: impl Fn(&mut Self) -> Result<T>,
    ) -> Result<Vec<T>> {
        let count = self.u64()?;
        if count > (self.remaining() / least) as u64 {
            return Err(Error::input(
                &self.path,
                format!(
                    "{count} records ({what}) are announced, but {} bytes hold at most {}",
                    self.remaining(),
                    self.remaining() / least
                ),
                REBUILD,
            ));
        }
        let mut records = Vec::with_capacity(count as usize);
        for i in 0..count {
            self.reading = format!("{what} {i} of {count}");
            records.push(read(self)?);
        }
        if self.remaining() > 0 {
            let what = format!("{} bytes follow after the last {what}", self.remaining());
            return Err(Error::input(&self.path, what, REBUILD));
        }
        Ok(records)
    }

    fn take<const K: usize>(&mut self) -> Result<[u8; K]> {
        match self.bytes[self.at..].first_chunk::<K>() {
            Some(chunk) => {
                self.at += K;
                Ok(*chunk)
            }
            None => Err(self.truncated(K as u64)),
        }
    }

    fn u32(&mut self) -> Result<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64> {
        self.take().map(f64::from_le_bytes)
    }

    fn f64s<const K: usize>(&mut self) -> Result<[f64; K]> {
        let mut out = [0.0; K];
        for v in &mut out {
            *v = self.f64()?;
        }
        Ok(out)
    }

    /// A string that ends with a zero byte.
    fn name(&mut self) -> Result<String> {
        let rest = &self.bytes[self.at..];
        let Some(length) = rest.iter().position(|&b| b == 0) else {
            return Err(self.truncated(self.remaining() as u64 + 1));
        };
        let Ok(name) = std::str::from_utf8(&rest[..length]) else {
            let what = format!("the name of {} is not UTF-8", self.reading);
            return Err(Error::input(&self.path, what, "rename the photo"));
        };
        let name = name.to_string();
        self.at += length + 1;
        Ok(name)
    }

    /// Skips a count and that many records of `size` bytes.
    fn skip_list(&mut self, size: u64) -> Result<()> {
        let length = self.u64()?.saturating_mul(size);
        if length > self.remaining() as u64 {
            return Err(self.truncated(length));
        }
        self.at += length as usize;
        Ok(())
    }
}
