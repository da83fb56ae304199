//! The image files that a dataset names, wherever they lie.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::base::error::{Error, Result};
use crate::capture::assemble::locate;
use crate::capture::endings::{is_image, is_photo};

/// Levels of folders that are searched for photos.
const DEPTH: usize = 5;

/// Names of folders that have a picture for each photo, by the same file name, that is none; with an `s` or more after an underscore, too.
const NO_PHOTOS: [&str; 5] = ["mask", "depth", "normal", "semantic", "segmentation"];

/// True for a folder of pictures that are no photos, by its name in lower case.
fn has_no_photos(name: &str) -> bool {
    let first = name.split(['_', '-']).next().unwrap_or_default();
    NO_PHOTOS.contains(&first.strip_suffix('s').unwrap_or(first))
}

/// A folder of photos, and the dataset around it.
pub(super) struct Images<'a> {
    root: &'a Path,
    folder: PathBuf,
    /// True if the folder was asked for: then no other is searched.
    asked: bool,
}

/// Image files, one per name that was looked for.
pub(super) struct Found {
    /// The file of each name; `None` for those that are not there.
    pub files: Vec<Option<PathBuf>>,
    /// Their place, in words.
    pub place: String,
}

/// The folder that `--images` names: one of the dataset, else one of the file system.
///
/// # Errors
/// Neither is there.
pub(super) fn asked_folder(root: &Path, asked: Option<&Path>) -> Result<Option<PathBuf>> {
    let Some(name) = asked else {
        return Ok(None);
    };
    let mut places = [root.join(name), name.to_path_buf()].into_iter();
    match places.find(|p| p.is_dir()) {
        Some(folder) => Ok(Some(folder)),
        None => Err(Error::input(
            root.join(name),
            "no such folder, asked for with --images",
            "give a folder of photos, as it is called within the dataset or with its whole path",
        )),
    }
}

/// A path below the dataset as it is told to the user.
pub(super) fn short(root: &Path, path: &Path) -> String {
    match path.strip_prefix(root) {
        Ok(below) if below.as_os_str().is_empty() => "this folder".to_owned(),
        Ok(below) => below.display().to_string(),
        Err(_) => path.display().to_string(),
    }
}

impl<'a> Images<'a> {
    /// The folder that is asked for, else `usual`.
    ///
    /// # Errors
    /// Those of [`asked_folder`].
    pub(super) fn new(root: &'a Path, usual: PathBuf, asked: Option<&Path>) -> Result<Self> {
        let folder = asked_folder(root, asked)?;
        Ok(Self {
            root,
            asked: folder.is_some(),
            folder: folder.unwrap_or(usual),
        })
    }

    /// The files of names: below the folder as they are named. If none of them is there, all are looked for by their file names, first
    /// below the folder, then below the dataset.
    ///
    /// # Errors
    /// A name that leads out of the folder; a file name that is in several places.
    pub(super) fn find<'n>(&self, names: impl Iterator<Item = &'n str> + Clone) -> Result<Found> {
        let exact = names.clone().map(|name| locate(&self.folder, name));
        let exact: Vec<Option<PathBuf>> = exact.collect::<Result<_>>()?;
        if !exact.iter().any(Option::is_some) {
            let more = (!self.asked).then_some(self.root);
            for top in [self.folder.as_path()].into_iter().chain(more) {
                let index = Index::below(top);
                let files = names.clone().map(|name| index.find(self.root, name));
                let files: Vec<Option<PathBuf>> = files.collect::<Result<_>>()?;
                if files.iter().any(Option::is_some) {
                    let place = format!("photos by file name in {}", self.common(&files));
                    return Ok(Found { files, place });
                }
            }
        }
        Ok(Found {
            files: exact,
            place: format!("photos in {}", short(self.root, &self.folder)),
        })
    }

    /// The folder that files have in common, in words.
    fn common(&self, files: &[Option<PathBuf>]) -> String {
        let mut folders = files.iter().flatten().filter_map(|file| file.parent());
        let first = folders.next().unwrap_or(self.root);
        let shared = |a: &'_ Path, b: &Path| {
            let above = a.ancestors().find(|above| b.starts_with(above));
            above.unwrap_or(self.root).to_path_buf()
        };
        let common = folders.fold(first.to_path_buf(), |a, b| shared(&a, b));
        short(self.root, &common)
    }
}

/// The photos below a folder, by their file names without the extension.
struct Index(HashMap<String, Vec<PathBuf>>);

/// A file name without the extension of an image format.
fn stem(path: &Path) -> Option<String> {
    let name = match is_image(path) {
        true => path.file_stem(),
        false => path.file_name(),
    };
    Some(name?.to_str()?.to_owned())
}

impl Index {
    fn below(top: &Path) -> Self {
        let mut index = Self(HashMap::new());
        index.add(top, DEPTH);
        index
    }

    /// Adds the photos of a folder and of those below it; hidden folders and those of masks, depths and normals hold none.
    fn add(&mut self, folder: &Path, depth: usize) {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let (path, name) = (entry.path(), entry.file_name());
            let name = name.to_string_lossy().to_lowercase();
            if name.starts_with('.') || name.starts_with("masks") {
                continue;
            }
            if path.is_dir() {
                if depth > 1 && !has_no_photos(&name) {
                    self.add(&path, depth - 1);
                }
            } else if is_photo(&path)
                && path.is_file()
                && let Some(stem) = stem(&path)
            {
                self.0.entry(stem).or_default().push(path);
            }
        }
    }

    /// The photo of a name. Of several with its file name those count that share most of its path's end.
    ///
    /// # Errors
    /// Several share as much.
    fn find(&self, root: &Path, name: &str) -> Result<Option<PathBuf>> {
        let named = Path::new(name);
        let known = stem(named).and_then(|stem| self.0.get(&stem));
        let Some(known) = known else {
            return Ok(None);
        };
        let alike = |file: &&PathBuf| {
            let same = file.file_name() == named.file_name();
            let folders = |path: &Path| -> Vec<_> {
                let above = path.parent().unwrap_or(Path::new(""));
                above.iter().rev().map(ToOwned::to_owned).collect()
            };
            let pairs = folders(file).into_iter().zip(folders(named));
            (pairs.take_while(|(a, b)| a == b).count(), same)
        };
        let most = known.iter().map(|file| alike(&file)).max();
        let mut best: Vec<&PathBuf> = known.iter().filter(|f| Some(alike(f)) == most).collect();
        best.sort();
        match best[..] {
            [one] => Ok(Some(one.clone())),
            [first, second, ..] => {
                let [first, second] = [first, second].map(|file| short(root, file));
                let what = format!("the image {name} may be {first} or {second}");
                let fix = "say which folder has the photos: --images DIR";
                Err(Error::input(root, what, fix))
            }
            [] => Ok(None),
        }
    }
}
