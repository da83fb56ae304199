//! The pictures on the walls.

use glam::DVec3;

use crate::lab::synth::hash::{cell, fractal, random, smooth};
use crate::lab::synth::texture::rgb;

/// Colour of picture `k` at (x, y) in [−1, 1]², y up, `aspect` wide for one high.
pub(super) fn paint(k: u32, x: f64, y: f64, aspect: f64, seed: u64) -> DVec3 {
    match k % 4 {
        0 => landscape(x * aspect, y, seed),
        1 => grid(x, y),
        2 => discs(x * aspect, y, aspect, seed),
        _ => letters(x * aspect, y, seed),
    }
}

/// Hills under an evening sky.
fn landscape(x: f64, y: f64, seed: u64) -> DVec3 {
    let sky = rgb(0.98, 0.72, 0.42).lerp(rgb(0.25, 0.42, 0.72), smooth(-0.3, 0.9, y));
    let sun = ((x - 0.55) * (x - 0.55) + (y - 0.3) * (y - 0.3)).sqrt();
    let mut c = sky.lerp(rgb(1.0, 0.95, 0.75), smooth(0.17, 0.15, sun));
    let hills = [
        (0.25, 0.55, 1.1, rgb(0.52, 0.50, 0.66)),
        (-0.1, 0.6, 1.7, rgb(0.33, 0.43, 0.50)),
        (-0.42, 0.5, 2.3, rgb(0.22, 0.38, 0.30)),
        (-0.72, 0.35, 3.1, rgb(0.30, 0.42, 0.16)),
    ];
    for (i, (base, height, rate, color)) in hills.into_iter().enumerate() {
        let crest =
            base + height * (fractal(DVec3::new(x * rate, i as f64 * 3.7, 0.5), seed) - 0.5);
        c = c.lerp(color, smooth(crest + 0.012, crest - 0.012, y));
    }
    c
}

/// Coloured fields between black bars.
fn grid(x: f64, y: f64) -> DVec3 {
    let white = rgb(0.94, 0.92, 0.86);
    let bars = (x + 0.35).abs().min((y - 0.28).abs());
    let short = if x > -0.35 {
        (y + 0.55).abs()
    } else {
        (y + 0.2).abs()
    };
    let post = if y < -0.55 && x > -0.35 {
        (x - 0.45).abs()
    } else {
        1.0
    };
    if bars.min(short).min(post) < 0.035 {
        return rgb(0.07, 0.07, 0.08);
    }
    match (x > -0.35, y > 0.28, y > -0.2, y > -0.55) {
        (true, true, ..) => rgb(0.80, 0.13, 0.10),
        (false, _, false, _) => rgb(0.12, 0.26, 0.60),
        (true, _, _, false) if x > 0.45 => rgb(0.95, 0.78, 0.16),
        _ => white,
    }
}

/// Rings of every size in a few colours.
fn discs(x: f64, y: f64, aspect: f64, seed: u64) -> DVec3 {
    let colors = [
        rgb(0.93, 0.45, 0.20),
        rgb(0.16, 0.50, 0.55),
        rgb(0.93, 0.75, 0.30),
        rgb(0.75, 0.20, 0.30),
        rgb(0.20, 0.25, 0.40),
    ];
    let mut c = rgb(0.95, 0.91, 0.82);
    for i in 0..11u64 {
        let pick = |j: u64| random(&[seed, 77, i, j]);
        let (cx, cy) = (
            (2.0 * pick(0) - 1.0) * aspect * 0.8,
            (2.0 * pick(1) - 1.0) * 0.8,
        );
        let radius = 0.12 + 0.3 * pick(2) * pick(2);
        let d = ((x - cx) * (x - cx) + (y - cy) * (y - cy)).sqrt() / radius;
        let ring = if pick(3) > 0.5 {
            1.0
        } else {
            smooth(0.5, 0.55, d)
        };
        let color = colors.get(i as usize % colors.len()).copied().unwrap_or(c);
        c = c.lerp(color, ring * smooth(1.0, 0.96, d));
    }
    c
}

/// Rows of block letters that no one can read.
fn letters(x: f64, y: f64, seed: u64) -> DVec3 {
    let (paper, ink) = (rgb(0.14, 0.18, 0.26), rgb(0.95, 0.86, 0.62));
    let (u, v) = (x * 5.0, y * 3.5);
    let (column, row) = (u.floor(), v.floor());
    if !(-3.0..3.0).contains(&row) {
        return paper;
    }
    let (fu, fv) = (u - column, v - row);
    if fu > 0.8 || fv > 0.78 || cell(column, row, 1.0, seed) < 0.12 {
        return paper;
    }
    let (i, j) = ((fu / 0.2667).floor(), (fv / 0.156).floor());
    let on = cell(column * 8.0 + i, row * 8.0 + j, 2.0, seed) > 0.42;
    let red = cell(column, row, 3.0, seed) > 0.85;
    match (on, red) {
        (false, _) => paper,
        (true, true) => rgb(0.90, 0.35, 0.22),
        (true, false) => ink,
    }
}
