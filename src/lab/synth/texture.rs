//! Procedural textures: diffuse albedo (linear RGB) of a point in its solid's frame.

use glam::DVec3;

use crate::lab::synth::hash::{cell, fractal, noise, smooth};

/// A texture. Lengths in scene units; `u`, `v` are the two coordinates across the face a point lies on.
#[derive(Debug, Clone, Copy)]
pub(super) enum Texture {
    /// One colour.
    Plain(DVec3),
    /// A colour with soft mottling: feature size, strength.
    Paint(DVec3, f64, f64),
    /// Two colours in squares of this side.
    Checker(DVec3, DVec3, f64),
    /// Floor boards of this width along u, each of its own tone.
    Boards(DVec3, DVec3, f64),
    /// Grain along the solid's longest axis (0, 1, 2): two tones, width of the grain.
    Wood(DVec3, DVec3, usize, f64),
    /// Bricks of this length, laid in courses; colours of brick and mortar.
    Brick(DVec3, DVec3, f64),
    /// Wallpaper: two colours in stripes along v with small diamonds on every other one.
    Wallpaper(DVec3, DVec3, f64),
    /// Veins of the second colour in the first: feature size.
    Marble(DVec3, DVec3, f64),
    /// Patches of the second colour on the first: feature size.
    Patches(DVec3, DVec3, f64),
    /// A woven rug with borders: ground, ornament, half lengths u and v.
    Rug(DVec3, DVec3, f64, f64),
    /// Ceiling panels of this side.
    Panels(DVec3, f64),
    /// Picture number k, with half lengths u and v.
    Picture(u32, f64, f64),
    /// Rings about z: two colours, width.
    Rings(DVec3, DVec3, f64),
}

/// Linear RGB of a colour given as on a screen, by the square that [`crate::lab::synth::trace`] inverts with a square root.
pub(super) fn rgb(r: f64, g: f64, b: f64) -> DVec3 {
    DVec3::new(r * r, g * g, b * b)
}

impl Texture {
    /// Albedo at `p` with the outward normal `n`, both in the solid's frame; `seed` varies the noise.
    pub fn albedo(&self, p: DVec3, n: DVec3, seed: u64) -> DVec3 {
        let (u, v) = across(p, n);
        match *self {
            Self::Plain(c) => c,
            Self::Paint(c, size, strength) => {
                c * (1.0 + strength * (2.0 * fractal(p / size, seed) - 1.0))
            }
            Self::Checker(a, b, side) => {
                let odd = ((u / side).floor() + (v / side).floor()).rem_euclid(2.0) > 0.5;
                if odd { a } else { b }
            }
            Self::Boards(a, b, width) => boards(a, b, width, u, v, seed),
            Self::Wood(a, b, axis, width) => wood(a, b, axis, width, p, seed),
            Self::Brick(brick, mortar, length) => bricks(brick, mortar, length, u, v, seed),
            Self::Wallpaper(a, b, width) => wallpaper(a, b, width, u, v),
            Self::Marble(a, b, size) => {
                let bent = p.x + p.y + 0.5 * p.z + 1.6 * size * fractal(p / size, seed);
                let wave = (bent / size).rem_euclid(1.0) - 0.5;
                a.lerp(b, 1.0 - smooth(0.02, 0.3, wave.abs()))
            }
            Self::Patches(a, b, size) => {
                let h = fractal(p / size, seed);
                let tone = 0.85 + 0.3 * noise(p * (5.0 / size), seed + 9);
                a.lerp(b, smooth(0.5, 0.53, h)) * tone
            }
            Self::Rug(a, b, hu, hv) => rug(a, b, hu, hv, u, v, seed),
            Self::Panels(c, side) => {
                let edge = |x: f64| 0.5 - ((x / side).rem_euclid(1.0) - 0.5).abs();
                let e = edge(u).min(edge(v));
                let tone = 0.97 + 0.06 * cell((u / side).floor(), (v / side).floor(), 0.0, seed);
                c * tone
                    * (0.62 + 0.38 * smooth(0.008, 0.025, e))
                    * (0.94 + 0.06 * smooth(0.1, 0.13, e))
            }
            Self::Picture(k, hu, hv) => {
                crate::lab::synth::picture::paint(k, u / hu, v / hv, hu / hv, seed)
            }
            Self::Rings(a, b, width) => {
                let r = (p.x * p.x + p.y * p.y).sqrt()
                    + 0.35 * width * fractal(p / (4.0 * width), seed);
                let wave = ((r / width).rem_euclid(1.0) - 0.5).abs();
                a.lerp(b, smooth(0.1, 0.45, wave))
                    * (0.9 + 0.2 * fractal(p / (0.4 * width), seed + 3))
            }
        }
    }
}

/// The two coordinates of `p` across the face whose normal is nearest to `n`; v points up on upright faces.
fn across(p: DVec3, n: DVec3) -> (f64, f64) {
    let a = n.abs();
    if a.z >= a.x && a.z >= a.y {
        (p.x, p.y)
    } else if a.x >= a.y {
        (p.y, p.z)
    } else {
        (p.x, p.z)
    }
}

fn boards(a: DVec3, b: DVec3, width: f64, u: f64, v: f64, seed: u64) -> DVec3 {
    let row = (v / width).floor();
    let length = 9.0 * width;
    let shifted = u / length + cell(row, 7.0, 1.0, seed);
    let column = shifted.floor();
    let tone = cell(row, column, 2.0, seed);
    let grain = fractal(DVec3::new(u * 2.5, v * 34.0, 17.0 * tone), seed);
    let streak = noise(DVec3::new(u * 6.0, v * 110.0, 5.0 * tone), seed + 5);
    let c = a.lerp(
        b,
        (0.55 * tone + 0.5 * grain + 0.12 * (streak - 0.5)).clamp(0.0, 1.0),
    );
    let across = 0.5 - ((v / width).rem_euclid(1.0) - 0.5).abs();
    let along = (0.5 - (shifted.rem_euclid(1.0) - 0.5).abs()) * length / width;
    c * (0.45 + 0.55 * smooth(0.012, 0.045, across.min(along)))
}

fn wood(a: DVec3, b: DVec3, axis: usize, width: f64, p: DVec3, seed: u64) -> DVec3 {
    let mut q = p / width;
    if let Some(x) = q.as_mut().get_mut(axis) {
        *x *= 0.08;
    }
    let h = fractal(q, seed);
    let fine = noise(q * 4.3, seed + 4);
    a.lerp(
        b,
        (smooth(0.2, 0.8, h) + 0.25 * (fine - 0.5)).clamp(0.0, 1.0),
    )
}

fn bricks(brick: DVec3, mortar: DVec3, length: f64, u: f64, v: f64, seed: u64) -> DVec3 {
    let height = 0.36 * length;
    let row = (v / height).floor();
    let shifted = u / length + 0.5 * row.rem_euclid(2.0);
    let tone = cell(row, shifted.floor(), 3.0, seed);
    let grit = fractal(DVec3::new(u, v, tone) * 26.0, seed);
    let x = (0.5 - (shifted.rem_euclid(1.0) - 0.5).abs()) * length;
    let y = (0.5 - ((v / height).rem_euclid(1.0) - 0.5).abs()) * height;
    let face = brick * (0.62 + 0.5 * tone) * (0.75 + 0.5 * grit);
    let warm = DVec3::new(1.0, 0.9 + 0.25 * tone, 0.85 + 0.4 * tone);
    (mortar * (0.85 + 0.3 * grit)).lerp(face * warm, smooth(0.006, 0.012, x.min(y)))
}

fn wallpaper(a: DVec3, b: DVec3, width: f64, u: f64, v: f64) -> DVec3 {
    let column = (u / width).floor();
    let odd = column.rem_euclid(2.0) > 0.5;
    let x = (u / width).rem_euclid(1.0) - 0.5;
    let y = (v / (1.5 * width) + 0.25 * column).rem_euclid(1.0) - 0.5;
    let diamond = x.abs() * 1.6 + y.abs() * 2.0;
    let ornament =
        smooth(0.42, 0.38, diamond) - smooth(0.26, 0.22, diamond) + smooth(0.13, 0.09, diamond);
    let (ground, mark) = if odd { (a, b) } else { (b, a) };
    ground.lerp(mark, if odd { 0.8 * ornament } else { 0.0 })
}

fn rug(a: DVec3, b: DVec3, hu: f64, hv: f64, u: f64, v: f64, seed: u64) -> DVec3 {
    let edge = (hu - u.abs()).min(hv - v.abs());
    let weave = 0.82 + 0.36 * noise(DVec3::new(u * 90.0, v * 90.0, 0.0), seed);
    let cream = rgb(0.93, 0.87, 0.74);
    let color = if edge < 0.05 {
        cream
    } else if edge < 0.09 {
        b
    } else if edge < 0.21 {
        let x = (u / 0.12).rem_euclid(1.0) - 0.5;
        let y = (v / 0.12).rem_euclid(1.0) - 0.5;
        if x.abs() + y.abs() < 0.36 {
            cream
        } else {
            a * 0.45
        }
    } else if edge < 0.24 {
        cream
    } else {
        let x = (u / 0.44).rem_euclid(1.0) - 0.5;
        let y = (v / 0.44).rem_euclid(1.0) - 0.5;
        let d = x.abs() + y.abs();
        if d < 0.1 {
            cream
        } else if d < 0.2 {
            b
        } else if d < 0.34 {
            a
        } else if d < 0.39 {
            cream
        } else {
            a * 0.7
        }
    };
    color * weave
}
