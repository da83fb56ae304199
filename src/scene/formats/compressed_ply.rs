//! PlayCanvas' compressed PLY: <https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/ply/>, as SuperSplat writes it.
//!
//! Chunks of 256 Gaussians have the least and largest position, log-scale and colour (element `chunk`); each Gaussian has four words
//! (`vertex`): position and log-scale in 11, 10 and 11 bits of its chunk's range, rotation in 2 bits (the largest of w, x, y, z) and
//! three times 10, colour and opacity in 8 bits each; and SH in a byte each (`sh`), channel by channel.

use std::fmt::Write;
use std::path::Path;

use crate::base::error::{Error, Result};
use crate::base::math::sigmoid;
use crate::base::ply::{Content, Kind};
use crate::capture::Frame;
use crate::scene::formats::ply::{comments, marks, rest_planes};
use crate::scene::formats::scene_file::{
    Rounding, SceneFile, from_smallest_three, limited_logit, localized, smallest_three, unit,
};
use crate::scene::gaussians::{Plane, sh_coefficients};
use crate::scene::sh::C0;

/// The kind of file.
const COMPRESSED: Kind = [
    "a compressed PLY (chunks, packed_position, packed_rotation, packed_scale, packed_color)",
    "export the compressed PLY again",
];
/// Gaussians of a chunk.
const CHUNK: usize = 256;
/// Bits of the three parts of a packed position or scale, from the highest on.
const BITS: [u32; 3] = [11, 10, 11];
/// SH coefficients lie within ± this.
const SH_RANGE: f64 = 4.0;
/// Columns of a chunk.
const RANGES: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];
/// Columns of a Gaussian.
const WORDS: [&str; 4] = [
    "packed_position",
    "packed_rotation",
    "packed_scale",
    "packed_color",
];

/// True if the Gaussians of a file are packed.
pub(super) fn is_compressed(content: &Content) -> bool {
    content.has("chunk") || content.table("vertex").is_ok_and(|v| v.has(WORDS[0]))
}

/// The parts of a word, each as a fraction of its largest value.
fn fractions<const K: usize>(word: u32, bits: [u32; K]) -> [f64; K] {
    let mut below: u32 = bits.iter().sum();
    bits.map(|bits| {
        below -= bits;
        let most = (1 << bits) - 1;
        f64::from(word >> below & most) / f64::from(most)
    })
}

/// Reads the Gaussians of a file.
///
/// # Errors
/// [`Error::Input`] for missing columns, too few chunks, numbers that are none.
pub(super) fn read(path: &Path, content: &Content, frame: &Frame) -> Result<SceneFile> {
    let [vertices, chunks] = [content.table("vertex")?, content.table("chunk")?];
    let marks = marks(path, &vertices.comments)?;
    let (n, found) = (vertices.len(), chunks.len());
    if found != n.div_ceil(CHUNK) {
        let what = format!("{found} chunks for {n} Gaussians; one per {CHUNK} expected");
        return Err(Error::input(path, what, COMPRESSED[1]));
    }
    // Older files have no ranges of colours: they are 0 to 1.
    let ranges = RANGES
        .into_iter()
        .enumerate()
        .map(|(k, name)| match k < 12 || chunks.has(name) {
            true => chunks.column(name, COMPRESSED),
            false => Ok(vec![if k < 15 { 0.0 } else { 1.0 }; found]),
        });
    let ranges: Vec<Vec<f64>> = ranges.collect::<Result<_>>()?;
    let mut rows = vec![[0_u32; 4]; n];
    for (k, name) in WORDS.into_iter().enumerate() {
        let column = vertices.column(name, COMPRESSED)?;
        rows.iter_mut()
            .zip(column)
            .for_each(|(row, v)| row[k] = v as u32);
    }
    let (degree, bands) = bands(path, content, n)?;
    let mut planes = vec![Vec::with_capacity(n); Plane::count(degree)];
    for (i, [positions, rotation, scales, colors]) in rows.into_iter().enumerate() {
        let chunk = i / CHUNK;
        let within = |part: usize, at: [f64; 3]| {
            let range = |k: usize| ranges[6 * part + k][chunk];
            [0, 1, 2].map(|k| range(k) * (1.0 - at[k]) + range(3 + k) * at[k])
        };
        let [r, g, b, opacity] = fractions(colors, [8; 4]);
        let position = within(0, fractions(positions, BITS));
        let scale = within(1, fractions(scales, BITS));
        let color = within(2, [r, g, b]).map(|c| (c - 0.5) / C0);
        for k in 0..3 {
            planes[Plane::POSITION + k].push(position[k] as f32);
            planes[Plane::LOG_SCALE + k].push(scale[k] as f32);
            planes[Plane::SH + k].push(color[k] as f32);
        }
        planes[Plane::OPACITY].push(limited_logit(opacity));
        let others = fractions(rotation, [10; 3]).map(|v| (v - 0.5) * 2.0_f64.sqrt());
        let rotation = from_smallest_three((rotation >> 30) as usize, others);
        for (k, v) in rotation.into_iter().enumerate() {
            planes[Plane::ROTATION + k].push(v as f32);
        }
    }
    for (plane, values) in rest_planes(degree).zip(bands) {
        planes[plane] = values;
    }
    Ok(SceneFile {
        anti_aliased: marks.anti_aliased,
        up: marks.up,
        cameras: marks.cameras.map(|sphere| sphere.in_local(frame)),
        ..SceneFile::new(localized(path, degree, planes, frame)?)
    }
    .without_shell(marks.shell))
}

/// The SH degree, and the coefficients above the constant one, in the file's order.
fn bands(path: &Path, content: &Content, n: usize) -> Result<(u32, Vec<Vec<f32>>)> {
    if !content.has("sh") {
        return Ok((0, Vec::new()));
    }
    let table = content.table("sh")?;
    let (columns, rows) = (table.names().count(), table.len());
    let degree = (1..=3).find(|d| 3 * (sh_coefficients(*d) - 1) == columns);
    let Some(degree) = degree.filter(|_| rows == n) else {
        let what = format!(
            "{rows} rows of {columns} SH coefficients for {n} Gaussians; 9, 24 or 45 for each expected"
        );
        return Err(Error::input(path, what, COMPRESSED[1]));
    };
    // A byte is a 256th of the range, taken at its middle; the outermost two are its ends.
    let value = |b: f64| match b {
        0.0 => -SH_RANGE,
        255.0 => SH_RANGE,
        _ => ((b + 0.5) / 256.0 - 0.5) * 2.0 * SH_RANGE,
    };
    let column = |k: usize| -> Result<Vec<f32>> {
        let bytes = table
            .column(&format!("f_rest_{k}"), COMPRESSED)?
            .into_iter();
        Ok(bytes.map(|b| value(b) as f32).collect())
    };
    Ok((degree, (0..columns).map(column).collect::<Result<_>>()?))
}

/// The least and the largest of three numbers of some Gaussians, rounded to f32.
fn range(values: &[[f64; 3]]) -> [[f32; 3]; 2] {
    let fold = |start: f64, with: fn(f64, f64) -> f64| {
        [0, 1, 2].map(|k| values.iter().map(|v| v[k]).fold(start, with) as f32)
    };
    [
        fold(f64::INFINITY, f64::min),
        fold(f64::NEG_INFINITY, f64::max),
    ]
}

/// Three numbers as fractions of a range, in a word of parts of so many bits.
fn packed(values: [f64; 3], [least, most]: [[f32; 3]; 2], bits: [u32; 3]) -> u32 {
    (0..3).fold(0, |word, k| {
        let (least, most) = (f64::from(least[k]), f64::from(most[k]));
        let steps = f64::from((1_u32 << bits[k]) - 1);
        let at = (values[k] - least) / (most - least).max(f64::MIN_POSITIVE) * steps;
        word << bits[k] | Rounding::default().round(at, steps as u32)
    })
}

/// A rotation in 2 and three times 10 bits.
fn packed_rotation(q: [f64; 4]) -> u32 {
    let (largest, others) = smallest_three(q);
    others.into_iter().fold(largest as u32, |word, v| {
        let at = (v * 0.5_f64.sqrt() + 0.5) * 1023.0;
        word << 10 | Rounding::default().round(at, 1023)
    })
}

/// The bytes of a file, and remarks on what the format cannot hold. The scene is in the dataset's frame; neighbours should follow
/// each other, so that chunks are small.
pub(super) fn encode(scene: &SceneFile) -> (Vec<u8>, Vec<String>) {
    let splats = &scene.splats;
    let (n, degree) = (splats.len(), splats.sh_degree());
    let mut bytes = header(scene).into_bytes();
    let mut words = Vec::with_capacity(16 * n);
    for first in (0..n).step_by(CHUNK) {
        let rows = first..n.min(first + CHUNK);
        let three = |plane: usize, change: &dyn Fn(f32) -> f64| -> Vec<[f64; 3]> {
            rows.clone()
                .map(|i| splats.gather(plane, i).map(change))
                .collect()
        };
        let positions = three(Plane::POSITION, &f64::from);
        let scales = three(Plane::LOG_SCALE, &f64::from);
        let colors = three(Plane::SH, &|v| f64::from(v) * C0 + 0.5);
        let ranges = [&positions, &scales, &colors].map(|v| range(v));
        bytes.extend(
            ranges
                .iter()
                .flatten()
                .flatten()
                .flat_map(|v| v.to_le_bytes()),
        );
        for (k, i) in rows.clone().enumerate() {
            let [opacity] = splats.gather(Plane::OPACITY, i).map(f64::from);
            let opacity = Rounding::default().round(255.0 * sigmoid(opacity), 255);
            let rotation = packed_rotation(unit(splats.gather(Plane::ROTATION, i)));
            let row = [
                packed(positions[k], ranges[0], BITS),
                rotation,
                packed(scales[k], ranges[1], BITS),
                packed(colors[k], ranges[2], [8; 3]) << 8 | opacity,
            ];
            words.extend(row.into_iter().flat_map(u32::to_le_bytes));
        }
    }
    bytes.extend(words);
    let mut clamped = Rounding::default();
    for i in 0..n {
        let coefficient = |plane: usize| -> u8 {
            let [v] = splats.gather(plane, i).map(f64::from);
            let at = (v / (2.0 * SH_RANGE) + 0.5) * 256.0;
            // The nearest middle of a 256th; the very ends belong to the outermost.
            clamped.byte(if v.abs() <= SH_RANGE {
                (at - 0.5).clamp(0.0, 255.0)
            } else {
                at
            })
        };
        bytes.extend(rest_planes(degree).map(coefficient));
    }
    let remark = clamped.remark("view-dependent coefficients", "-4 to 4");
    (bytes, remark.into_iter().collect())
}

fn header(scene: &SceneFile) -> String {
    let (n, degree) = (scene.splats.len(), scene.splats.sh_degree());
    let mut text = format!(
        "ply\nformat binary_little_endian 1.0\n{}",
        comments(scene, scene.cameras)
    );
    let mut element = |name: &str, count: usize, scalar: &str, columns: &[String]| {
        let _ = writeln!(text, "element {name} {count}");
        for column in columns {
            let _ = writeln!(text, "property {scalar} {column}");
        }
    };
    element(
        "chunk",
        n.div_ceil(CHUNK),
        "float",
        &RANGES.map(str::to_owned),
    );
    element("vertex", n, "uint", &WORDS.map(str::to_owned));
    if degree > 0 {
        let rest = 3 * (sh_coefficients(degree) - 1);
        let columns: Vec<String> = (0..rest).map(|k| format!("f_rest_{k}")).collect();
        element("sh", n, "uchar", &columns);
    }
    text + "end_header\n"
}
