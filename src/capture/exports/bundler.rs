//! Bundler's files: `bundle.out` and a list of the photos.
//!
//! Format: Bundler v0.4 User's Manual, §VI, <https://www.cs.cornell.edu/~snavely/bundler/bundler-v0.4-manual.html>. Poses are
//! world-to-camera with x right, y up, z back; a photo's point is f (1 + k1 r² + k2 r⁴) p from its centre. The files hold no size of the
//! photos: they are to be those that the focal lengths were computed for.

use std::fs;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};

use crate::base::error::{Error, Result};
use crate::capture::assemble::RawScene;
use crate::capture::camera::{Camera, camera_axes};
use crate::capture::dataset::Layout;
use crate::capture::exports::shared::scene;
use crate::capture::lens::Lens;
use crate::capture::source;

/// First words of a file.
const MARK: &str = "# Bundle file";

/// Remedy for a file that cannot be used.
const EXPORT: &str = "export the bundle again";

/// True for a text that begins as a bundle does.
pub(super) fn is_bundle(text: &str) -> bool {
    text.starts_with(MARK)
}

/// A camera: focal length, k1, k2; rotation and translation, world to camera.
struct BundleCamera {
    lens: [f64; 3],
    rotation: DMat3,
    translation: DVec3,
}

/// The words of a file, as numbers.
struct Numbers<'a> {
    file: &'a Path,
    words: std::str::SplitAsciiWhitespace<'a>,
}

impl Numbers<'_> {
    fn next(&mut self, of: &str) -> Result<f64> {
        let word = self.words.next();
        let number = word.and_then(|w| w.parse().ok());
        number.filter(|v: &f64| v.is_finite()).ok_or_else(|| {
            let what = match word {
                Some(word) => format!("'{word}' in {of}; a number expected"),
                None => format!("the file ends within {of}"),
            };
            Error::input(self.file, what, EXPORT)
        })
    }

    fn array<const N: usize>(&mut self, of: &str) -> Result<[f64; N]> {
        let mut out = [0.0; N];
        for v in &mut out {
            *v = self.next(of)?;
        }
        Ok(out)
    }

    /// A number of things.
    fn count(&mut self, of: &str) -> Result<usize> {
        let count = self.next(of)?;
        if !(0.0..=1e9).contains(&count) || count.fract() != 0.0 {
            let what = format!("{count} in {of}; a whole number expected");
            return Err(Error::input(self.file, what, EXPORT));
        }
        Ok(count as usize)
    }
}

/// Positions and colours of points.
type Cloud = (Vec<DVec3>, Vec<[u8; 3]>);

fn parse(file: &Path, text: &str) -> Result<(Vec<BundleCamera>, Cloud)> {
    let body = text.split_once('\n').map_or("", |(_, body)| body);
    let mut from = Numbers {
        file,
        words: body.split_ascii_whitespace(),
    };
    let [cameras, points] = [from.count("its counts")?, from.count("its counts")?];
    // Grown as the file goes on: the counts may announce more than there is.
    let (mut all, mut positions, mut colors) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..cameras {
        let of = format!("camera {i} of {cameras}");
        let lens = from.array(&of)?;
        let rotation: [f64; 9] = from.array(&of)?;
        all.push(BundleCamera {
            lens,
            rotation: DMat3::from_cols_array(&rotation).transpose(),
            translation: DVec3::from_array(from.array(&of)?),
        });
    }
    for i in 0..points {
        let of = format!("point {i} of {points}");
        positions.push(DVec3::from_array(from.array(&of)?));
        let color: [f64; 3] = from.array(&of)?;
        colors.push(color.map(|v| v.clamp(0.0, 255.0) as u8));
        for _ in 0..from.count(&of)? {
            from.array::<4>(&of)?;
        }
    }
    Ok((all, (positions, colors)))
}

/// The list of photos beside a bundle: `list.txt`, or of the bundle's name, or the only one.
fn list(root: &Path, file: &Path) -> Result<PathBuf> {
    let stem = file
        .file_name()
        .and_then(|n| n.to_str())
        .unwrap_or_default();
    let stem = stem.trim_end_matches(".out").trim_end_matches(".bundle");
    let named = [root.join("list.txt"), root.join(format!("{stem}.list.txt"))];
    if let Some(found) = named.into_iter().find(|p| p.is_file()) {
        return Ok(found);
    }
    let entries = fs::read_dir(root).into_iter().flatten().flatten();
    let is_list = |path: &PathBuf| {
        let name = path.file_name().and_then(|n| n.to_str());
        let named = name.is_some_and(|n| n.contains("list") && n.ends_with(".txt"));
        named && path.is_file()
    };
    let mut lists: Vec<PathBuf> = entries.map(|e| e.path()).filter(is_list).collect();
    let only = lists.pop().filter(|_| lists.is_empty());
    only.ok_or_else(|| {
        let what = "no list of the photos beside it";
        Error::input(
            file,
            what,
            "put list.txt there, a photo's name in each line",
        )
    })
}

/// The photo that a line names: without the two numbers that may follow it, one of them 0 and the other a focal length.
fn named(line: &str) -> &str {
    let cut = |line: &'_ str| -> Option<usize> {
        let (rest, last) = line.trim_end().rsplit_once(char::is_whitespace)?;
        last.parse::<f64>().ok().map(|_| rest.len())
    };
    let once = cut(line);
    let twice = once.and_then(|end| cut(&line[..end]));
    line[..twice.unwrap_or(line.len())].trim()
}

impl BundleCamera {
    /// The camera of a photo of this size, and its lens; `None` without a rotation.
    fn camera(&self, width: u32, height: u32) -> Option<(Camera, Lens)> {
        let turned = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let rows = (turned * self.rotation).transpose();
        let rotation = camera_axes([rows.x_axis, rows.y_axis, rows.z_axis])?;
        let [focal, k1, k2] = self.lens;
        let camera = Camera {
            rotation,
            translation: turned * self.translation,
            fx: focal,
            fy: focal,
            cx: f64::from(width) / 2.0,
            cy: f64::from(height) / 2.0,
            width,
            height,
        };
        Some((camera, Lens::of_coefficients(&[k1, k2], false)))
    }
}

/// The views and points of a bundle in `root`.
///
/// # Errors
/// A truncated file, a list of another length, a camera that is none; what [`scene`] refuses.
pub(super) fn load(root: &Path, file: &Path, asked: Option<&Path>) -> Result<RawScene> {
    let text = |file: &Path| -> Result<String> {
        let bytes = crate::base::files::read_text(file)?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    };
    let (cameras, (positions, colors)) = parse(file, &text(file)?)?;
    let list = list(root, file)?;
    let lines = text(&list)?;
    let photos = lines.lines().map(named).filter(|name| !name.is_empty());
    let photos: Vec<&str> = photos.collect();
    if photos.len() != cameras.len() {
        let what = format!(
            "{} photos, but {} has {} cameras",
            photos.len(),
            file.display(),
            cameras.len()
        );
        return Err(Error::input(list, what, "give the list of that bundle"));
    }
    // Photos that could not be registered have a focal length of 0.
    let posed = photos
        .into_iter()
        .zip(&cameras)
        .filter(|(_, c)| c.lens[0] > 0.0);
    let (names, posed): (Vec<&str>, Vec<&BundleCamera>) = posed.unzip();
    if names.is_empty() {
        return Err(Error::input(file, "no registered photo", EXPORT));
    }
    let place = (root, file, Layout::Bundler);
    let mut scene = scene(place, asked, &names, |i, image| {
        let header = source::header(image)?;
        let camera = posed[i].camera(header.width, header.height);
        camera.ok_or_else(|| {
            let what = format!("the rotation of {} is none", names[i]);
            Error::input(file, what, EXPORT)
        })
    })?;
    (scene.positions, scene.colors) = (positions, colors);
    if asked.is_some() {
        let remark = "warning: Bundler's focal lengths are in pixels of photos of a size that it does not tell: those of --images have to have that size";
        scene.remarks.push(remark.into());
    }
    Ok(scene)
}
