//! A capture in parts, each a dataset of its own beside the others: the cells of its ground with the cameras and points that show them.
//!
//! The choice of cameras and points is that of VastGaussian (Lin et al., CVPR 2024): those of a cell and a margin around it; cameras from elsewhere of whose
//! image the cell's space, from the lowest to the highest of its points, covers a share; and the points that a chosen camera sees.
//! Parts keep the capture's coordinates and its held-out views.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::base::files;
use crate::base::math::{order_statistic, sorted};
use crate::capture::archive::is_archive;
use crate::capture::assemble::{RawView, inside, sides};
use crate::capture::camera::Camera;
use crate::capture::cells::{Bounds, Ground, divide};
use crate::capture::frame::Frame;
use crate::capture::layouts;
use crate::capture::lens::Lens;
use crate::capture::panorama::{Side, side_of};
use crate::capture::point_cloud::{self, Points};
use crate::capture::transforms::{Listed, keys_of, write_listed};

/// File that tells the cells, in the folder of the parts.
pub const CELLS_FILE: &str = "cells.json";

/// File of a part's points.
const CLOUD: &str = "points3d.ply";

/// Folders of a part's links: to photos, and to masks. One called `masks` would be searched for those of other photos.
const LINKS: [&str; 2] = ["images", "mask"];

/// Rays along each side of an image that measure how much of it a cell covers.
const RAYS: u32 = 16;

/// Share of a cell's points below and above its space along each axis: stray points would make it as large as the scene.
const STRAY: f64 = 0.01;

/// Options of [`split`].
#[derive(Debug, Clone)]
pub struct SplitOptions {
    /// Number of cells, at least 1.
    pub cells: usize,
    /// Margin around a cell, a share of its length.
    pub overlap: f64,
    /// Share of a camera's image that a cell's space covers for the camera to belong to its part.
    pub visibility: f64,
    /// Every n-th image by name is held out (0: none), where the dataset does not say which.
    pub test_every: u32,
    /// Folder of the photos; `None`: where the dataset says.
    pub images: Option<PathBuf>,
}

/// The cells of a capture, the content of [`CELLS_FILE`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cells {
    /// Folder of the whole dataset, as given.
    pub dataset: String,
    /// The plane that is divided, in the dataset's coordinates.
    pub ground: Ground,
    /// [`SplitOptions::overlap`].
    pub overlap: f64,
    /// [`SplitOptions::visibility`].
    pub visibility: f64,
    /// The cells; the part of cell I is the folder `cell-I`.
    pub cells: Vec<Cell>,
    /// Findings about the dataset that the user should know.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}

/// A cell, and the size of its part.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Its rectangle on the ground, without the margin.
    pub bounds: Bounds,
    /// Photos to train on.
    pub train: usize,
    /// Photos held out.
    pub held_out: usize,
    /// Photos taken in the cell, among both.
    pub own: usize,
    /// Photos taken outside of the cell and its margin that show it, among both.
    pub seeing: usize,
    /// Sparse points.
    pub points: usize,
    /// Sparse points in the cell, among them.
    pub own_points: usize,
}

impl Cells {
    /// Reads the cells of a folder of parts.
    ///
    /// # Errors
    /// [`Error::Input`] for a folder without them, or a file that is damaged.
    pub fn read(parts: &Path) -> Result<Self> {
        let file = parts.join(CELLS_FILE);
        let fix = "give the folder that `mhsplat split` wrote";
        if !file.is_file() {
            let what = format!("holds no {CELLS_FILE}");
            return Err(Error::input(parts, what, fix));
        }
        let cells: Self = serde_json::from_slice(&files::read(&file)?)
            .map_err(|e| Error::input(&file, format!("not a list of cells: {e}"), fix))?;
        match cells.cells.is_empty() {
            true => Err(Error::input(&file, "no cell", fix)),
            false => Ok(cells),
        }
    }

    /// Folder of a cell's part.
    #[must_use]
    pub fn part(parts: &Path, cell: usize) -> PathBuf {
        parts.join(format!("cell-{cell}"))
    }

    /// True for a point, in the dataset's coordinates, that is in a cell; it is in no other one.
    #[must_use]
    pub fn owns(&self, cell: usize, p: DVec3) -> bool {
        self.cells[cell].bounds.contains(self.ground.place(p))
    }
}

/// Writes the parts of a dataset into a folder that is made for them: transforms files, points, and links to photos and masks.
///
/// # Errors
/// Those of [`crate::capture::load`]; an archive; more cells than can have a camera of their own, with the number that can; a lens that
/// transforms files have no keys for; [`Error::Io`].
pub fn split(dataset: &Path, out: &Path, options: &SplitOptions) -> Result<Cells> {
    if is_archive(dataset) {
        let what = "a zip archive; parts refer to the photos where they lie";
        return Err(Error::input(dataset, what, "unpack it and give the folder"));
    }
    let mut scene = layouts::read(dataset, options.images.as_deref())?;
    let (train, test, outliers) = sides(dataset, &mut scene, options.test_every)?;
    let capture = Capture::new(train, test, scene.positions, scene.colors);
    let places: Vec<DVec3> = capture.train().iter().map(|s| s.place).collect();
    let Some(bounds) = divide(&places, options.cells) else {
        let fewer = (1..options.cells.min(places.len() + 1)).rev();
        let possible = fewer.into_iter().find(|n| divide(&places, *n).is_some());
        let what = format!(
            "{} cells, and the {} photos to train on of {} are enough for {} at most",
            options.cells,
            places.len(),
            dataset.display(),
            possible.unwrap_or(0)
        );
        return Err(Error::config("--cells", what));
    };
    let mut remarks = scene.remarks;
    for (names, what) in [
        (&scene.missing, "named by the dataset but missing"),
        (&outliers, "taken far from all others (a wrong pose?)"),
    ] {
        if let Some(first) = names.first() {
            let n = names.len();
            remarks.push(format!("left out: {n} images {what}, the first is {first}"));
        }
    }
    // Before anything is written.
    for Shot { view, .. } in &capture.shots {
        keys_of(dataset, &view.name, view.lens)?;
    }
    let mut cells = Vec::with_capacity(bounds.len());
    for (i, bounds) in bounds.into_iter().enumerate() {
        let part = capture.part(&bounds, options);
        part.write(&Cells::part(out, i), &capture)?;
        cells.push(part.cell);
    }
    let cells = Cells {
        dataset: dataset.display().to_string(),
        ground: capture.ground,
        overlap: options.overlap,
        visibility: options.visibility,
        cells,
        remarks,
    };
    let text = serde_json::to_string_pretty(&cells).map_err(|e| Error::numerics(CELLS_FILE, e))?;
    // Last: a folder without it is no whole one.
    files::write_bytes(&out.join(CELLS_FILE), text.as_bytes())?;
    Ok(cells)
}

/// A photo on the ground.
struct Shot {
    view: RawView,
    /// Coordinates of its camera on the ground.
    place: DVec3,
    /// Its cameras: itself, or the sides of a panorama.
    cameras: Vec<Camera>,
}

/// A dataset on its ground.
struct Capture {
    ground: Ground,
    /// Photos to train on, then held-out ones.
    shots: Vec<Shot>,
    /// Number of photos to train on.
    trained: usize,
    positions: Vec<DVec3>,
    colors: Vec<[u8; 3]>,
    /// Coordinates of the points on the ground.
    places: Vec<DVec3>,
}

/// The part of a cell.
struct Part {
    cell: Cell,
    /// Numbers of its photos.
    shots: Vec<usize>,
    /// Numbers of its points.
    points: Vec<usize>,
}

impl Capture {
    fn new(
        train: Vec<RawView>,
        test: Vec<RawView>,
        positions: Vec<DVec3>,
        colors: Vec<[u8; 3]>,
    ) -> Self {
        let trained = train.len();
        let centers: Vec<DVec3> = train.iter().map(|v| v.camera.center()).collect();
        let ground = Ground::of(&centers);
        let shot = |view: RawView| Shot {
            place: ground.place(view.camera.center()),
            cameras: pinholes(&view),
            view,
        };
        Self {
            ground,
            shots: train.into_iter().chain(test).map(shot).collect(),
            trained,
            places: positions.iter().map(|p| ground.place(*p)).collect(),
            positions,
            colors,
        }
    }

    fn train(&self) -> &[Shot] {
        &self.shots[..self.trained]
    }

    /// Chooses the photos and points of a cell.
    fn part(&self, bounds: &Bounds, options: &SplitOptions) -> Part {
        let places: Vec<DVec3> = self.train().iter().map(|s| s.place).collect();
        let grown = bounds.grown(options.overlap, &places);
        let space = self.space(bounds);
        let covered = |shot: &Shot| {
            let share = |c: &Camera| space.map_or(0.0, |space| coverage(&self.ground, c, space));
            shot.cameras.iter().any(|c| share(c) > options.visibility)
        };
        let near = |shot: &Shot| grown.contains(shot.place);
        let chosen = |i: &usize| near(&self.shots[*i]) || covered(&self.shots[*i]);
        let shots: Vec<usize> = (0..self.shots.len())
            .into_par_iter()
            .filter(chosen)
            .collect();
        let trained = shots.iter().filter(|i| **i < self.trained);
        let eyes = trained.flat_map(|i| &self.shots[*i].cameras);
        let eyes: Vec<&Camera> = eyes.collect();
        let points = (0..self.positions.len()).into_par_iter().filter(|i| {
            let seen = || eyes.iter().any(|c| sees(c, self.positions[*i]));
            grown.contains(self.places[*i]) || seen()
        });
        let points: Vec<usize> = points.collect();
        let count =
            |of: &dyn Fn(&Shot) -> bool| shots.iter().filter(|i| of(&self.shots[**i])).count();
        let train = shots.iter().filter(|i| **i < self.trained).count();
        let own = |p: &usize| bounds.contains(self.places[*p]);
        Part {
            cell: Cell {
                bounds: *bounds,
                train,
                held_out: shots.len() - train,
                own: count(&|shot| bounds.contains(shot.place)),
                seeing: count(&|shot| !near(shot)),
                points: points.len(),
                own_points: points.iter().filter(|p| own(p)).count(),
            },
            shots,
            points,
        }
    }

    /// Two opposite corners, on the ground, of the space that the points of a cell take; `None` without points.
    fn space(&self, bounds: &Bounds) -> Option<[DVec3; 2]> {
        let own = || self.places.iter().filter(|p| bounds.contains(**p));
        let along = [0, 1, 2].map(|k| sorted(own().map(|p| p[k])));
        let corner = |share: f64| {
            let [x, y, z] = [0, 1, 2].map(|k| order_statistic(&along[k], share));
            Some(DVec3::new(x?, y?, z?))
        };
        Some([corner(STRAY)?, corner(1.0 - STRAY)?])
    }
}

/// The cameras of a photo: its own without the lens, or those of a panorama's sides.
fn pinholes(view: &RawView) -> Vec<Camera> {
    let camera = &view.camera;
    match view.lens {
        Lens::Equirectangular => {
            let size = side_of([camera.width, camera.height], u32::MAX);
            Side::ALL.map(|side| side.camera(camera, size)).to_vec()
        }
        _ => vec![*camera],
    }
}

/// Share of a camera's image that shows a space between two corners on the ground, whatever stands before it.
fn coverage(ground: &Ground, camera: &Camera, [low, high]: [DVec3; 2]) -> f64 {
    let from = ground.place(camera.center());
    let back = camera.rotation.transpose();
    let [w, h] = [camera.width, camera.height].map(f64::from);
    let at = |k: u32, size: f64| (f64::from(k) + 0.5) * size / f64::from(RAYS);
    let meets = |i: &u32| {
        let (x, y) = (at(i % RAYS, w), at(i / RAYS, h));
        let ray = DVec3::new(
            (x - camera.cx) / camera.fx,
            (y - camera.cy) / camera.fy,
            1.0,
        );
        let inverse = ground.direction(back * ray).recip();
        let (a, b) = ((low - from) * inverse, (high - from) * inverse);
        let (enters, leaves) = (a.min(b).max_element(), a.max(b).min_element());
        leaves >= enters.max(0.0)
    };
    (0..RAYS * RAYS).filter(meets).count() as f64 / f64::from(RAYS * RAYS)
}

/// True if a point is in a camera's image.
fn sees(camera: &Camera, p: DVec3) -> bool {
    let t = camera.rotation * p + camera.translation;
    let x = camera.fx * t.x / t.z + camera.cx;
    let y = camera.fy * t.y / t.z + camera.cy;
    let within = |v: f64, size: u32| v >= 0.0 && v < f64::from(size);
    t.z > 0.0 && within(x, camera.width) && within(y, camera.height)
}

impl Part {
    /// Writes the part into a folder.
    fn write(&self, folder: &Path, capture: &Capture) -> Result<()> {
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        let of = |points: &[DVec3]| self.points.iter().map(|i| points[*i]).collect();
        let positions: Vec<DVec3> = of(&capture.positions);
        let colors = self.points.iter().map(|i| capture.colors[*i]).collect();
        let shots = || self.shots.iter().map(|i| &capture.shots[*i].view);
        let centers: Vec<DVec3> = shots().map(|v| v.camera.center()).collect();
        let cloud = match positions.is_empty() {
            true => None,
            false => {
                // In single precision far-off coordinates are none.
                let frame = Frame::fit(&centers, &positions);
                let points = Points::local(folder, &frame, (positions, colors))?;
                point_cloud::write(&folder.join(CLOUD), &points, &frame)?;
                Some(CLOUD)
            }
        };
        let listed: Vec<Listed> = shots().map(|v| list(folder, v)).collect::<Result<_>>()?;
        let (train, held_out) = listed.split_at(self.cell.train);
        // The list of held-out views, even an empty one, keeps the part from choosing its own.
        for (side, views) in [("train", train), ("test", held_out)] {
            let file = folder.join(format!("transforms_{side}.json"));
            write_listed(&file, views, cloud, true)?;
        }
        Ok(())
    }
}

/// Lists a view, with links to its files.
fn list(folder: &Path, view: &RawView) -> Result<Listed> {
    let [images, masks] = LINKS;
    let mask = view
        .mask
        .as_ref()
        .map(|mask| link(folder, masks, &view.name, mask));
    Ok(Listed {
        name: link(folder, images, &view.name, &view.file)?,
        camera: view.camera,
        lens: view.lens,
        mask: mask.transpose()?,
    })
}

/// Links a name below a folder to a file; returns the way to the link.
fn link(folder: &Path, within: &str, name: &str, file: &Path) -> Result<String> {
    let link = inside(&folder.join(within), name)?;
    let above = link.parent().unwrap_or(folder);
    fs::create_dir_all(above).map_err(|e| Error::io(above, e))?;
    // Relative, so that a folder of both may be moved.
    let to = files::between(above, file);
    let to = to.ok_or_else(|| Error::input(file, "cannot be linked to", "check its path"))?;
    symlink(to, &link).map_err(|e| Error::io(&link, e))?;
    Ok(format!("{within}/{name}"))
}
