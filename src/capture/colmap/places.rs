//! The places of a dataset folder in which COLMAP's models and their photos lie.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use crate::capture::colmap::form::has_observations;
use crate::capture::dataset::Layout;
use crate::capture::endings::is_photo;
use crate::capture::images::short;

/// Folders of models, each itself or with numbered ones in it, and the folders of their photos, the first that exists. Those of a
/// model before undistortion (`distorted`, of Inria's script) are the photos that were put in.
const PLACES: [(&str, &[&str]); 4] = [
    ("sparse", &["images"]),
    ("", &["images"]),
    ("colmap/sparse", &["images", "colmap/images"]),
    ("distorted/sparse", &["input"]),
];

/// Levels of folders below that of the photos in which photos are counted.
const DEPTH: usize = 4;

/// A model with its photos.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Place {
    /// Folder of the model.
    pub model: PathBuf,
    /// Form of its files.
    pub layout: Layout,
    /// Folder of the photos; `images` if there is none.
    pub photos: PathBuf,
    /// True for a model in `sparse`, which is looked for before a transforms file; others, which programs leave beside one, after it.
    pub usual: bool,
    /// Images that the model has.
    images: u64,
}

/// The model of most images below `root`, of equals the first by place and number, and remarks on what else there is: photos that
/// the model does not have, and other models. With a folder that is `asked` for, that has the photos of every model.
pub(crate) fn find(root: &Path, asked: Option<&Path>) -> Option<(Place, Vec<String>)> {
    let mut all = Vec::new();
    for (below, photos) in PLACES {
        let folder = root.join(below);
        let mut photos = photos.iter().map(|name| root.join(name));
        let found = asked.map(Path::to_path_buf);
        let found = found.or_else(|| photos.find(|p| p.is_dir()));
        // Photos that were put in are not those that came out, and a model without photos is a part of a dataset.
        let elsewhere = || {
            let whole = match below {
                "sparse" => true,
                "distorted/sparse" => false,
                _ => self::photos(root) > 0,
            };
            whole.then(|| root.join("images"))
        };
        let Some(photos) = found.or_else(elsewhere) else {
            continue;
        };
        let numbered = match below {
            "" => Vec::new(),
            _ => numbered(&folder),
        };
        for model in numbered.into_iter().chain([folder]) {
            all.extend(place(model, photos.clone(), below == PLACES[0].0));
        }
    }
    let most = all.iter().map(|place| place.images).max()?;
    let first = all.iter().position(|place| place.images == most)?;
    let usual = all.iter().any(|place| place.usual);
    let chosen = Place {
        usual,
        ..all.remove(first)
    };
    let remarks = remarks(root, &chosen, &all);
    Some((chosen, remarks))
}

/// Folders whose names are numbers, in the order of these.
fn numbered(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let number = |path: &Path| path.file_name()?.to_str()?.parse::<u32>().ok();
    let mut all: Vec<(u32, PathBuf)> = entries
        .filter_map(|entry| Some((number(&entry.path())?, entry.path())))
        .collect();
    all.sort();
    all.into_iter().map(|(_, path)| path).collect()
}

fn place(model: PathBuf, photos: PathBuf, usual: bool) -> Option<Place> {
    let (layout, images) = if model.join("cameras.bin").is_file() {
        (Layout::ColmapBin, images_bin(&model.join("images.bin")))
    } else if model.join("cameras.txt").is_file() {
        (Layout::ColmapTxt, images_txt(&model.join("images.txt")))
    } else {
        return None;
    };
    Some(Place {
        model,
        layout,
        photos,
        usual,
        images: images.unwrap_or(0),
    })
}

/// Number of images that a file announces; `None` for a file that cannot be read: whoever reads the model says why.
fn images_bin(file: &Path) -> Option<u64> {
    let mut count = [0; 8];
    let mut file = file.is_file().then(|| fs::File::open(file).ok())??;
    file.read_exact(&mut count).ok()?;
    Some(u64::from_le_bytes(count))
}

/// Number of images of a text file, with or without lines of observations.
fn images_txt(file: &Path) -> Option<u64> {
    let file = file.is_file().then(|| fs::File::open(file).ok())??;
    let lines = BufReader::new(file).lines().map_while(Result::ok);
    let (mut lines, mut images, mut skips) = (lines.peekable(), 0, None);
    while let Some(line) = lines.next() {
        let line = line.trim_start_matches('\u{feff}').trim();
        if !line.is_empty() && !line.starts_with('#') {
            images += 1;
            let mut after = || lines.peek().is_none_or(|line| has_observations(line));
            if *skips.get_or_insert_with(&mut after) {
                lines.next();
            }
        }
    }
    Some(images)
}

fn remarks(root: &Path, chosen: &Place, others: &[Place]) -> Vec<String> {
    let short = |path: &Path| short(root, path);
    let mut remarks = Vec::new();
    let (model, photos) = (short(&chosen.model), photos(&chosen.photos));
    if chosen.images < photos {
        let (images, folder) = (chosen.images, short(&chosen.photos));
        remarks.push(match 2 * images < photos {
            true => format!(
                "warning: only {images} of the {photos} photos in {folder} have a pose in {model}; for a whole scene match them again (colmap exhaustive_matcher, then mapper)"
            ),
            false => format!("{images} of the {photos} photos in {folder} have a pose in {model}"),
        });
    }
    if !others.is_empty() {
        let names = others
            .iter()
            .map(|o| format!("{} ({} photos)", short(&o.model), o.images));
        let names: Vec<String> = names.collect();
        let (images, names) = (chosen.images, names.join(", "));
        remarks.push(format!(
            "the model in {model} is used ({images} photos); there are others: {names}"
        ));
    }
    remarks
}

/// Number of photos in a folder and in those below it.
pub(crate) fn photos(folder: &Path) -> u64 {
    count(folder, DEPTH)
}

fn count(folder: &Path, depth: usize) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let each = entries.map(|entry| {
        let path = entry.path();
        match (path.is_dir(), depth) {
            (true, 0) => 0,
            (true, _) => count(&path, depth - 1),
            (false, _) => u64::from(is_photo(&path)),
        }
    });
    each.sum()
}
