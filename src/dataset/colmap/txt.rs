//! The text form.

use std::path::{Path, PathBuf};
use std::str::{FromStr, SplitWhitespace};

use super::{ColmapCamera, ColmapImage, ColmapModel, ColmapPoint, MODELS};
use crate::error::{Error, Result};

/// One line being read, for errors that name it.
struct Line<'a> {
    path: &'a Path,
    number: usize,
    words: SplitWhitespace<'a>,
}

impl Line<'_> {
    fn wrong(&self, what: impl std::fmt::Display) -> Error {
        Error::input(
            self.path,
            format!("line {}: {what}", self.number),
            "export the model again as text",
        )
    }

    fn next<T: FromStr>(&mut self, what: &str) -> Result<T> {
        match self.words.next() {
            None => Err(self.wrong(format!("{what} missing"))),
            Some(w) => w
                .parse()
                .map_err(|_| self.wrong(format!("{what} expected, found {w:?}"))),
        }
    }

    fn reals<const N: usize>(&mut self, what: &str) -> Result<[f64; N]> {
        let mut out = [0.0; N];
        for v in &mut out {
            *v = self.next(what)?;
        }
        Ok(out)
    }
}

fn text(path: &PathBuf) -> Result<String> {
    let bytes = std::fs::read(path).map_err(|e| {
        Error::input(
            path,
            format!("cannot be read: {e}"),
            "copy the whole sparse/0 folder",
        )
    })?;
    String::from_utf8(bytes)
        .map_err(|_| Error::input(path, "is not text", "export the model again as text"))
}

fn lines<'a>(path: &'a Path, text: &'a str) -> impl Iterator<Item = Line<'a>> {
    text.lines()
        .enumerate()
        .filter(|(_, l)| !l.starts_with('#'))
        .map(move |(k, l)| Line {
            path,
            number: k + 1,
            words: l.split_whitespace(),
        })
}

pub(super) fn read(folder: &Path) -> Result<ColmapModel> {
    let points = folder.join("points3D.txt");
    Ok(ColmapModel {
        cameras: cameras(&folder.join("cameras.txt"))?,
        images: images(&folder.join("images.txt"))?,
        points: if points.exists() {
            read_points(&points)?
        } else {
            Vec::new()
        },
    })
}

fn cameras(path: &PathBuf) -> Result<Vec<ColmapCamera>> {
    let text = text(path)?;
    let mut out = Vec::new();
    for mut line in lines(path, &text) {
        if line.words.clone().next().is_none() {
            continue;
        }
        let id = line.next("camera id")?;
        let model: String = line.next("camera model")?;
        let Some((name, count)) = MODELS.iter().find(|(m, _)| *m == model) else {
            return Err(line.wrong(format!("unknown camera model {model}")));
        };
        let (width, height) = (line.next("width")?, line.next("height")?);
        let params = (0..*count)
            .map(|_| line.next("a parameter"))
            .collect::<Result<_>>()?;
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

/// Two lines an image: the pose, then its features (which may be empty and are skipped).
fn images(path: &PathBuf) -> Result<Vec<ColmapImage>> {
    let text = text(path)?;
    let mut out = Vec::new();
    let mut all = lines(path, &text);
    while let Some(mut line) = all.next() {
        if line.words.clone().next().is_none() {
            continue;
        }
        let id = line.next("image id")?;
        let rotation = line.reals("a quaternion")?;
        let translation = line.reals("a translation")?;
        let camera = line.next("camera id")?;
        let name = line.words.by_ref().collect::<Vec<_>>().join(" ");
        if name.is_empty() {
            return Err(line.wrong("image name missing"));
        }
        out.push(ColmapImage {
            id,
            rotation,
            translation,
            camera,
            name,
        });
        all.next();
    }
    Ok(out)
}

fn read_points(path: &PathBuf) -> Result<Vec<ColmapPoint>> {
    let text = text(path)?;
    let mut out = Vec::new();
    for mut line in lines(path, &text) {
        if line.words.clone().next().is_none() {
            continue;
        }
        let _id: u64 = line.next("point id")?;
        let position = line.reals("a position")?;
        let color = [
            line.next("a colour")?,
            line.next("a colour")?,
            line.next("a colour")?,
        ];
        out.push(ColmapPoint { position, color });
    }
    Ok(out)
}
