//! Front-to-back compositing (`kernels/splat.cl`): 3DGS, Kerbl et al. 2023, eq. 3.

use crate::base::constants::{ALPHA_MAX, T_MIN};
use crate::base::error::Result;
use crate::device::{Program, Real};
use crate::pipeline::buffers::ViewBuffers;
use crate::pipeline::launch::Arguments;
use crate::pipeline::reference::{Camera64, Options, TILE};
use crate::pipeline::stage::project::Projected64;

/// Composites the sorted pairs of a view over a background colour.
pub fn composite<R: Real>(stage: &Program, view: &ViewBuffers<R>, color: [f32; 3]) -> Result<()> {
    let size = view.camera.image();
    let tuning = &stage.defines().tuning;
    let launch = stage.launch("splat").tile_lists(view).tiles(size);
    // Where work-items have pixels of their own, those below the image must not keep a tile open.
    let launch = match tuning.group_style {
        true => launch.ints([size.pixels[1]]),
        false => launch,
    };
    let launch = launch
        .reals::<R>(color.map(f64::from))
        .array(&view.image, 4 * size.plane())
        .array(&view.tile_used, size.tile_count());
    let kept = if view.gradients() {
        tuning.snapshot_values(view.capacity)
    } else {
        0
    };
    let launch = match tuning.group_style {
        true => launch
            .ints([usize::from(view.gradients())])
            .array(&view.snapshots, kept),
        false => launch,
    };
    launch.over_tiles_by(size, &view.band, tuning.splat_group as usize)
}

// Definition in f64.

/// One contribution to a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contribution {
    /// Gaussian.
    pub gaussian: u32,
    /// Alpha after the cap.
    pub alpha: f64,
    /// True if the cap acts.
    pub capped: bool,
    /// Transmittance in front of it.
    pub transmittance: f64,
}

/// Contributions to a pixel, front to back, and the transmittance that is left.
#[must_use]
pub fn contributions(
    projected: &[Option<Projected64>],
    list: &[u32],
    x: i32,
    y: i32,
    alpha_min: f64,
) -> (Vec<Contribution>, f64) {
    let mut t = 1.0;
    let mut out = Vec::new();
    for &gaussian in list {
        let Some(g) = &projected[gaussian as usize] else {
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

/// The list of the tile of [`TILE`] pixels a side that holds a pixel.
#[must_use]
pub fn list_at<'a>(tiles: &'a [Vec<u32>], camera: &Camera64, x: i32, y: i32) -> &'a [u32] {
    &tiles[(y / TILE * camera.tiles(TILE)[0] + x / TILE) as usize]
}

/// Image over the background \[3, height, width\] and transmittance \[height, width\].
#[must_use]
pub fn splat(
    projected: &[Option<Projected64>],
    tiles: &[Vec<u32>],
    camera: &Camera64,
    options: &Options,
) -> (Vec<f64>, Vec<f64>) {
    let n = camera.pixels();
    let (mut image, mut left) = (vec![0.0; 3 * n], vec![0.0; n]);
    for y in 0..camera.size[1] {
        for x in 0..camera.size[0] {
            let list = list_at(tiles, camera, x, y);
            let (parts, t) = contributions(projected, list, x, y, options.alpha_min);
            let at = (y * camera.size[0] + x) as usize;
            left[at] = t;
            for c in 0..3 {
                let sum: f64 = parts
                    .iter()
                    .filter_map(|p| {
                        projected[p.gaussian as usize]
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
