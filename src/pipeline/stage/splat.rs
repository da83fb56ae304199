//! Front-to-back compositing (`kernels/splat.cl`).

use crate::base::constants::{ALPHA_MAX, T_MIN};
use crate::base::error::Result;
use crate::device::tuning;
use crate::device::{Array, CameraArg, Kernel, Kernels, Real, Record};
use crate::pipeline::reference::{Camera64, Options, TILE};
use crate::pipeline::stage::project::Record64;

/// The splat stage.
#[derive(Debug)]
pub struct Splat {
    kernel: Kernel,
    group: usize,
}

/// The sorted pairs of a view, shared by splat, splat_grad and seen.
#[derive(Debug)]
pub struct TileLists<'a, R: Real> {
    /// Records \[count\].
    pub records: &'a Array<Record<R>>,
    /// Gaussian of each pair, by emission slot \[pairs\].
    pub pair_owner: &'a Array<u32>,
    /// Emission slots sorted by tile, then depth \[pairs\].
    pub order: &'a Array<u32>,
    /// First pair of each tile \[tiles + 1\].
    pub tile_start: &'a Array<u32>,
    /// Pairs used of each tile \[tiles\] (written by splat).
    pub tile_used: &'a Array<u32>,
    /// Tiles per row, tiles.
    pub tiles: [usize; 2],
    /// Planes red, green, blue, transmittance \[4, rows, stride\] (written by splat).
    pub image: &'a Array<R>,
}

impl<R: Real> TileLists<'_, R> {
    /// Pixels of a padded plane.
    #[must_use]
    pub fn plane(&self) -> usize {
        self.tiles[1] * (tuning::TILE * tuning::TILE) as usize
    }
}

/// Work-items of a launch that covers every tile: (global, local).
pub(super) fn tile_grid(tiles: usize, group: usize) -> ([usize; 2], [usize; 2]) {
    ([tiles * group, 1], [group, 1])
}

impl Splat {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("splat", ["splat"])?;
        Ok(Self {
            kernel,
            group: group_size(kernels),
        })
    }

    /// Enqueues the stage over a background colour.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &TileLists<'_, R>, background: [f32; 3]) -> Result<()> {
        let [tiles_x, tiles] = a.tiles;
        let bg = background.map(|c| R::of(f64::from(c)));
        let (global, local) = tile_grid(tiles, self.group);
        self.kernel
            .launch()
            .array(a.records, 1)
            .array(a.pair_owner, 1)
            .array(a.order, 1)
            .array(a.tile_start, tiles + 1)
            .value(tiles_x as i32)
            .value(tiles as i32)
            .value(bg[0])
            .value(bg[1])
            .value(bg[2])
            .array(a.image, 4 * a.plane())
            .array(a.tile_used, tiles)
            .run(global, local)
    }
}

/// Work-items per tile.
pub(super) fn group_size(kernels: &Kernels) -> usize {
    if kernels.defines().tuning.group_style {
        (tuning::TILE * tuning::TILE) as usize
    } else {
        1
    }
}

/// Tiles per row and in all, as [`TileLists::tiles`] wants them.
#[must_use]
pub fn tiles_of<R: Real>(camera: &CameraArg<R>) -> [usize; 2] {
    [camera.tiles[0] as usize, camera.tile_count()]
}

/// One contribution to a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contribution {
    /// Gaussian.
    pub gaussian: u32,
    /// Alpha after the cap.
    pub alpha: f64,
    /// Whether the cap acts.
    pub capped: bool,
    /// Transmittance in front of it.
    pub transmittance: f64,
}

/// Contributions to a pixel, front to back, and the transmittance that is left.
#[must_use]
pub fn contributions(
    records: &[Option<Record64>],
    list: &[u32],
    x: i32,
    y: i32,
    alpha_min: f64,
) -> (Vec<Contribution>, f64) {
    let mut t = 1.0;
    let mut out = Vec::new();
    for &gaussian in list {
        let Some(g) = &records[gaussian as usize] else {
            continue;
        };
        if t < T_MIN {
            break;
        }
        let log2_alpha = g.log2_alpha(x, y);
        if log2_alpha < alpha_min.log2() {
            continue;
        }
        let free = log2_alpha.exp2();
        let alpha = free.min(ALPHA_MAX);
        out.push(Contribution {
            gaussian,
            alpha,
            capped: free >= ALPHA_MAX,
            transmittance: t,
        });
        t *= 1.0 - alpha;
    }
    (out, t)
}

/// The list of the tile that holds a pixel.
#[must_use]
pub fn list_at<'a>(tiles: &'a [Vec<u32>], camera: &Camera64, x: i32, y: i32) -> &'a [u32] {
    &tiles[(y / TILE * camera.tiles()[0] + x / TILE) as usize]
}

/// Image over the background \[3, height, width\] and transmittance \[height, width\].
#[must_use]
pub fn splat(
    records: &[Option<Record64>],
    tiles: &[Vec<u32>],
    camera: &Camera64,
    options: &Options,
) -> (Vec<f64>, Vec<f64>) {
    let n = camera.pixels();
    let (mut image, mut left) = (vec![0.0; 3 * n], vec![0.0; n]);
    for y in 0..camera.size[1] {
        for x in 0..camera.size[0] {
            let list = list_at(tiles, camera, x, y);
            let (parts, t) = contributions(records, list, x, y, options.alpha_min);
            let at = (y * camera.size[0] + x) as usize;
            left[at] = t;
            for c in 0..3 {
                let sum: f64 = parts
                    .iter()
                    .filter_map(|p| {
                        records[p.gaussian as usize]
                            .as_ref()
                            .map(|g| p.alpha * p.transmittance * g.rgb[c])
                    })
                    .sum();
                image[c * n + at] = sum + t * options.background[c];
            }
        }
    }
    (image, left)
}
