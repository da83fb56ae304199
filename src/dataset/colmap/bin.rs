//! The binary form. Every count is checked against what is left of the file before anything is allocated.

use std::path::{Path, PathBuf};

use super::{ColmapCamera, ColmapImage, ColmapModel, ColmapPoint, MODELS};
use crate::error::{Error, Result};

struct Reader {
    path: PathBuf,
    data: Vec<u8>,
    at: usize,
}

impl Reader {
    fn open(path: PathBuf) -> Result<Self> {
        let data = std::fs::read(&path).map_err(|e| {
            Error::input(
                &path,
                format!("cannot be read: {e}"),
                "copy the whole sparse/0 folder",
            )
        })?;
        Ok(Self { path, data, at: 0 })
    }

    fn truncated(&self, what: &str) -> Error {
        Error::input(
            &self.path,
            format!(
                "ends within {what} (byte {} of {})",
                self.at,
                self.data.len()
            ),
            "the file is cut short or damaged; copy or export it again",
        )
    }

    fn take<const N: usize>(&mut self, what: &str) -> Result<[u8; N]> {
        let bytes = self
            .data
            .get(self.at..)
            .and_then(|rest| rest.first_chunk::<N>())
            .copied();
        match bytes {
            Some(b) => {
                self.at += N;
                Ok(b)
            }
            None => Err(self.truncated(what)),
        }
    }

    fn skip(&mut self, count: u64, size: u64, what: &str) -> Result<()> {
        let left = (self.data.len() - self.at) as u64;
        match count.checked_mul(size).filter(|n| *n <= left) {
            Some(n) => {
                self.at += n as usize;
                Ok(())
            }
            None => Err(self.truncated(what)),
        }
    }

    fn u32(&mut self, what: &str) -> Result<u32> {
        self.take(what).map(u32::from_le_bytes)
    }

    fn u64(&mut self, what: &str) -> Result<u64> {
        self.take(what).map(u64::from_le_bytes)
    }

    fn f64(&mut self, what: &str) -> Result<f64> {
        self.take(what).map(f64::from_le_bytes)
    }

    fn reals<const N: usize>(&mut self, what: &str) -> Result<[f64; N]> {
        let mut out = [0.0; N];
        for v in &mut out {
            *v = self.f64(what)?;
        }
        Ok(out)
    }

    /// A count of entries of at least `size` bytes each.
    fn count(&mut self, size: usize, what: &str) -> Result<usize> {
        let n = self.u64(what)?;
        let left = (self.data.len() - self.at) as u64;
        if n.checked_mul(size as u64).is_none_or(|bytes| bytes > left) {
            return Err(Error::input(
                &self.path,
                format!("announces {n} {what}, but {left} bytes are left"),
                "the file is cut short or damaged; copy or export it again",
            ));
        }
        Ok(n as usize)
    }

    fn name(&mut self) -> Result<String> {
        let rest = self.data.get(self.at..).unwrap_or(&[]);
        let Some(len) = rest.iter().position(|b| *b == 0) else {
            return Err(self.truncated("an image name"));
        };
        let name = String::from_utf8_lossy(&rest[..len]).into_owned();
        self.at += len + 1;
        Ok(name)
    }
}

pub(super) fn read(folder: &Path) -> Result<ColmapModel> {
    Ok(ColmapModel {
        cameras: cameras(Reader::open(folder.join("cameras.bin"))?)?,
        images: images(Reader::open(folder.join("images.bin"))?)?,
        points: match folder.join("points3D.bin") {
            file if file.exists() => points(Reader::open(file)?)?,
            _ => Vec::new(),
        },
    })
}

fn cameras(mut r: Reader) -> Result<Vec<ColmapCamera>> {
    let n = r.count(24, "cameras")?;
    let mut out = Vec::with_capacity(n);
    for _ in 0..n {
        let what = "a camera";
        let (id, model) = (r.u32(what)?, r.u32(what)?);
        let (width, height) = (r.u64(what)?, r.u64(what)?);
        let Some((name, count)) = MODELS.get(model as usize) else {
            return Err(Error::input(
                &r.path,
                format!("camera {id} has the unknown model number {model}"),
                "undistort with COLMAP, or export the model again",
            ));
        };
        let params = (0..*count).map(|_| r.f64(what)).collect::<Result<_>>()?;
        out.push(ColmapCamera {
            id,
            model: name,
            width,
            height,
            params,
        });
    }
    Ok(out)
}

fn images(mut r: Reader) -> Result<Vec<ColmapImage>> {
    let n = r.count(73, "images")?;
    let mut out = Vec::with_capacity(n);
    for _ in 0..n {
        let what = "an image";
        let id = r.u32(what)?;
        let rotation = r.reals(what)?;
        let translation = r.reals(what)?;
        let camera = r.u32(what)?;
        let name = r.name()?;
        let features = r.u64(what)?;
        r.skip(features, 24, "the features of an image")?;
        out.push(ColmapImage {
            id,
            rotation,
            translation,
            camera,
            name,
        });
    }
    Ok(out)
}

fn points(mut r: Reader) -> Result<Vec<ColmapPoint>> {
    let n = r.count(51, "points")?;
    let mut out = Vec::with_capacity(n);
    for _ in 0..n {
        let what = "a point";
        r.u64(what)?;
        let position = r.reals(what)?;
        let color = r.take::<3>(what)?;
        r.f64(what)?;
        let track = r.u64(what)?;
        r.skip(track, 8, "the track of a point")?;
        out.push(ColmapPoint { position, color });
    }
    Ok(out)
}
