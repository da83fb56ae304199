//! Text COLMAP models.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::str::{FromStr, SplitWhitespace};

use crate::base::error::{Error, Result};
use crate::capture::colmap::model::{ColmapCamera, ColmapImage, ColmapModel, ColmapPoint, REBUILD};
use crate::capture::colmap::models::Model;

/// Reads `cameras.txt`, `images.txt` and, if there is one, `points3D.txt` in `dir`.
///
/// # Errors
/// A missing file; a line that cannot be read; a camera model that is not read; a number that is not finite; no image.
pub fn read_txt(dir: &Path) -> Result<ColmapModel> {
    let file = |stem: &str| dir.join(format!("{stem}.txt"));
    let cameras = Text::open(file("cameras"))?.records(false, camera)?;
    let images = Text::open(file("images"))?.records(true, image)?;
    let points = if file("points3D").is_file() {
        Text::open(file("points3D"))?.records(false, point)?
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

fn camera(line: &mut Line<'_>) -> Result<ColmapCamera> {
    let id = line.next("CAMERA_ID")?;
    let name: String = line.next("MODEL")?;
    let size = (line.next("WIDTH")?, line.next("HEIGHT")?);
    let model = Model::from_name(line.path, id, &name)?;
    let mut params = Vec::new();
    while params.len() <= model.count() && line.words.clone().next().is_some() {
        params.push(line.next("PARAMS")?);
    }
    model.camera(line.path, id, size, &params)
}

fn image(line: &mut Line<'_>) -> Result<ColmapImage> {
    let id = line.next("IMAGE_ID")?;
    let rotation = line.array(["QW", "QX", "QY", "QZ"])?;
    let translation = line.array(["TX", "TY", "TZ"])?;
    let camera_id = line.next("CAMERA_ID")?;
    // The name is the rest of the line: it may hold spaces.
    let Some(first) = line.words.clone().next() else {
        return Err(line.bad("the NAME is missing"));
    };
    let offset = first.as_ptr() as usize - line.text.as_ptr() as usize;
    Ok(ColmapImage {
        id,
        rotation,
        translation,
        camera_id,
        name: line.text[offset..].to_string(),
    })
}

fn point(line: &mut Line<'_>) -> Result<ColmapPoint> {
    Ok(ColmapPoint {
        id: line.next("POINT3D_ID")?,
        position: line.array(["X", "Y", "Z"])?,
        color: line.array(["R", "G", "B"])?,
        error: line.next("ERROR")?,
    })
}

/// Writes `cameras.txt`, `images.txt` and `points3D.txt` into `dir`, which is created where needed. Numbers are written
/// with as many digits as it takes to read the same bits back.
///
/// # Errors
/// [`Error::Io`] if the system refuses.
pub fn write_txt(dir: &Path, model: &ColmapModel) -> Result<()> {
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, e))?;
    let mut cameras = String::from("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n");
    for c in &model.cameras {
        let params = joined(&c.params);
        let _ = writeln!(
            cameras,
            "{} PINHOLE {} {} {params}",
            c.id, c.width, c.height
        );
    }
    let mut images =
        String::from("# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[]\n");
    for i in &model.images {
        let (q, t) = (joined(&i.rotation), joined(&i.translation));
        let _ = writeln!(images, "{} {q} {t} {} {}\n", i.id, i.camera_id, i.name);
    }
    let mut points = String::from("# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n");
    for p in &model.points {
        let (x, c) = (joined(&p.position), joined(&p.color));
        let _ = writeln!(points, "{} {x} {c} {}", p.id, p.error);
    }
    for (name, text) in [
        ("cameras.txt", cameras),
        ("images.txt", images),
        ("points3D.txt", points),
    ] {
        let file = dir.join(name);
        std::fs::write(&file, text).map_err(|e| Error::io(&file, e))?;
    }
    Ok(())
}

fn joined<T: std::fmt::Display>(values: &[T]) -> String {
    let words: Vec<String> = values.iter().map(T::to_string).collect();
    words.join(" ")
}

struct Text {
    path: PathBuf,
    text: String,
}

impl Text {
    fn open(path: PathBuf) -> Result<Self> {
        let bytes = std::fs::read(&path).map_err(|e| Error::io(&path, e))?;
        match String::from_utf8(bytes) {
            Ok(text) => Ok(Self { path, text }),
            Err(_) => Err(Error::input(&path, "not UTF-8 text", REBUILD)),
        }
    }

    /// One record per line that is neither empty nor a comment. With `paired`, the line after a record belongs to it,
    /// empty or not, and is skipped (an image's observations).
    fn records<T>(
        &self,
        paired: bool,
        read: impl Fn(&mut Line<'_>) -> Result<T>,
    ) -> Result<Vec<T>> {
        let mut records = Vec::new();
        let mut lines = self.text.lines().enumerate();
        while let Some((i, text)) = lines.next() {
            let text = text.trim();
            if text.is_empty() || text.starts_with('#') {
                continue;
            }
            records.push(read(&mut Line {
                path: &self.path,
                number: i + 1,
                text,
                words: text.split_whitespace(),
            })?);
            if paired {
                lines.next();
            }
        }
        Ok(records)
    }
}

struct Line<'a> {
    path: &'a Path,
    number: usize,
    text: &'a str,
    words: SplitWhitespace<'a>,
}

impl Line<'_> {
    fn bad(&self, what: &str) -> Error {
        Error::input(self.path, format!("line {}: {what}", self.number), REBUILD)
    }

    fn next<T: FromStr>(&mut self, what: &str) -> Result<T> {
        let Some(word) = self.words.next() else {
            return Err(self.bad(&format!("{what} is missing")));
        };
        word.parse()
            .map_err(|_| self.bad(&format!("{what} is '{word}'; a number expected")))
    }

    fn array<T: FromStr + Copy + Default, const K: usize>(
        &mut self,
        what: [&str; K],
    ) -> Result<[T; K]> {
        let mut out = [T::default(); K];
        for (v, what) in out.iter_mut().zip(what) {
            *v = self.next(what)?;
        }
        Ok(out)
    }
}
