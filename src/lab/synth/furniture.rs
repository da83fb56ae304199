//! Furniture of the room. Each function gets the middle of the footprint.

use glam::{DVec3, dvec3};

use crate::lab::synth::hash::{about_x, about_z, random};
use crate::lab::synth::scene::{Builder, Finish};
use crate::lab::synth::shape::Shape::{Block, Cylinder, Ellipsoid, Rod, Rounded};
use crate::lab::synth::texture::{Texture, rgb};

/// A chair with its back towards −y, turned by `turns`.
pub(super) fn chair(b: &mut Builder, seat: usize, at: DVec3, turns: f64) {
    let wood = b.matt(Texture::Wood(
        rgb(0.55, 0.36, 0.21),
        rgb(0.36, 0.22, 0.12),
        2,
        0.03,
    ));
    let r = about_z(turns);
    let mut part = |material, shape, p: DVec3| b.turned(material, shape, at + r * p, r);
    part(
        seat,
        Rounded(dvec3(0.21, 0.2, 0.03), 0.02),
        dvec3(0.0, 0.0, 0.45),
    );
    for s in [-1.0, 1.0] {
        part(
            wood,
            Block(dvec3(0.02, 0.02, 0.21)),
            dvec3(0.17 * s, 0.16, 0.21),
        );
        part(
            wood,
            Block(dvec3(0.02, 0.02, 0.46)),
            dvec3(0.17 * s, -0.18, 0.46),
        );
    }
    for z in [0.6, 0.72, 0.86] {
        part(wood, Block(dvec3(0.15, 0.012, 0.03)), dvec3(0.0, -0.18, z));
    }
}

/// Shelves full of books, with their back at −y.
pub(super) fn shelf(b: &mut Builder, at: DVec3) {
    let wood = b.matt(Texture::Wood(
        rgb(0.64, 0.44, 0.27),
        rgb(0.45, 0.28, 0.16),
        0,
        0.05,
    ));
    let dark = b.matt(Texture::Wood(
        rgb(0.42, 0.28, 0.17),
        rgb(0.30, 0.19, 0.11),
        0,
        0.05,
    ));
    let (half, high) = (0.7, 1.9);
    b.add(
        dark,
        Block(dvec3(half, 0.01, 0.5 * high)),
        at + dvec3(0.0, -0.15, 0.5 * high),
    );
    for s in [-1.0, 1.0] {
        b.add(
            wood,
            Block(dvec3(0.018, 0.16, 0.5 * high)),
            at + dvec3(s * half, 0.0, 0.5 * high),
        );
    }
    for level in 0..6u64 {
        let z = 0.06 + 0.365 * level as f64;
        b.add(
            wood,
            Block(dvec3(half, 0.16, 0.012)),
            at + dvec3(0.0, 0.0, z),
        );
        if level < 5 {
            books(b, at + dvec3(0.0, 0.0, z + 0.012), half - 0.03, level);
        }
    }
}

/// A row of books; every level has a gap somewhere with something else in it.
fn books(b: &mut Builder, at: DVec3, half: f64, level: u64) {
    let seed = b.seed;
    let pick = |i: u64, j: u64| random(&[seed, 31, level, i, j]);
    let gap = -half + (0.15 + 0.5 * pick(99, 0)) * 2.0 * half;
    let colors = [
        rgb(0.66, 0.18, 0.16),
        rgb(0.18, 0.34, 0.50),
        rgb(0.88, 0.80, 0.62),
        rgb(0.24, 0.42, 0.28),
        rgb(0.85, 0.62, 0.20),
        rgb(0.34, 0.24, 0.34),
        rgb(0.20, 0.22, 0.25),
    ];
    let mut x = -half;
    for i in 0..60 {
        let thick = 0.014 + 0.018 * pick(i, 1);
        if x < gap && x + 2.0 * thick > gap {
            ornament(b, at + dvec3(gap + 0.11, 0.0, 0.0), level);
            x = gap + 0.23;
        }
        if x + 2.0 * thick > half {
            break;
        }
        let tall = 0.10 + 0.05 * pick(i, 2);
        let color = colors[(pick(i, 3) * 6.99) as usize] * (0.8 + 0.4 * pick(i, 4));
        // Bands across the spine.
        let m = b.matt(if pick(i, 5) > 0.5 {
            Texture::Wallpaper(color, color * 0.45, 0.09)
        } else {
            Texture::Paint(color, 0.05, 0.2)
        });
        let deep = 0.09 + 0.025 * pick(i, 6);
        b.add(
            m,
            Block(dvec3(thick - 0.001, deep, tall)),
            at + dvec3(x + thick, deep - 0.13, tall),
        );
        x += 2.0 * thick;
    }
}

/// Something on the shelf that is not a book.
fn ornament(b: &mut Builder, at: DVec3, level: u64) {
    let color = [
        rgb(0.85, 0.45, 0.30),
        rgb(0.30, 0.55, 0.62),
        rgb(0.86, 0.82, 0.70),
    ][(level % 3) as usize];
    let m = b.material(Texture::Marble(color, color * 0.4, 0.07), Finish::Satin(5));
    match level % 3 {
        0 => b.add(
            m,
            Ellipsoid(DVec3::splat(0.085)),
            at + dvec3(0.0, 0.02, 0.085),
        ),
        1 => b.add(m, Cylinder(0.06, 0.1), at + dvec3(0.0, 0.02, 0.1)),
        _ => b.turned(
            m,
            Rounded(DVec3::splat(0.07), 0.015),
            at + dvec3(0.0, 0.02, 0.07),
            about_z(0.07),
        ),
    }
}

/// A low cupboard along the wall x = 0 with a globe, a radio and candles on it.
pub(super) fn sideboard(b: &mut Builder, at: DVec3) {
    let body = b.matt(Texture::Wood(
        rgb(0.60, 0.38, 0.22),
        rgb(0.40, 0.23, 0.12),
        1,
        0.05,
    ));
    let front = b.matt(Texture::Wood(
        rgb(0.74, 0.52, 0.32),
        rgb(0.55, 0.35, 0.19),
        2,
        0.04,
    ));
    let knob = b.matt(Texture::Plain(rgb(0.15, 0.14, 0.14)));
    b.add(
        body,
        Block(dvec3(0.22, 0.85, 0.36)),
        at + dvec3(0.0, 0.0, 0.44),
    );
    for k in -1..=1 {
        let y = 0.56 * f64::from(k);
        b.add(
            front,
            Rounded(dvec3(0.015, 0.26, 0.31), 0.01),
            at + dvec3(0.22, y, 0.44),
        );
        b.add(
            knob,
            Ellipsoid(DVec3::splat(0.018)),
            at + dvec3(0.25, y + 0.19, 0.5),
        );
        for x in [-0.17, 0.17] {
            b.add(
                knob,
                Rod(0.018, 0.04),
                at + dvec3(x, 0.7 * f64::from(k), 0.05),
            );
        }
    }
    on_sideboard(b, at, body, knob);
}

/// The globe, the radio and the candles.
fn on_sideboard(b: &mut Builder, at: DVec3, body: usize, knob: usize) {
    let globe = b.material(
        Texture::Patches(rgb(0.20, 0.42, 0.66), rgb(0.50, 0.58, 0.28), 0.16),
        Finish::Satin(5),
    );
    b.add(
        globe,
        Ellipsoid(DVec3::splat(0.16)),
        at + dvec3(0.0, 0.5, 1.03),
    );
    b.add(body, Cylinder(0.09, 0.015), at + dvec3(0.0, 0.5, 0.815));
    b.add(knob, Rod(0.012, 0.02), at + dvec3(0.0, 0.5, 0.85));
    let radio = b.matt(Texture::Rug(
        rgb(0.82, 0.30, 0.20),
        rgb(0.22, 0.20, 0.20),
        0.24,
        0.15,
    ));
    b.turned(
        radio,
        Rounded(dvec3(0.09, 0.24, 0.15), 0.02),
        at + dvec3(0.0, -0.25, 0.95),
        about_z(0.02),
    );
    let wax = b.matt(Texture::Rings(
        rgb(0.93, 0.90, 0.80),
        rgb(0.88, 0.82, 0.66),
        0.02,
    ));
    for (y, tall) in [(-0.62, 0.08), (-0.72, 0.12), (0.2, 0.06)] {
        b.add(wax, Cylinder(0.035, tall), at + dvec3(0.04, y, 0.8 + tall));
    }
}

/// A pot with a bush of leaves.
pub(super) fn plant(b: &mut Builder, at: DVec3) {
    let pot = b.matt(Texture::Rings(
        rgb(0.76, 0.44, 0.30),
        rgb(0.66, 0.34, 0.22),
        0.05,
    ));
    let soil = b.matt(Texture::Paint(rgb(0.28, 0.20, 0.14), 0.03, 0.5));
    b.add(pot, Cylinder(0.19, 0.17), at + dvec3(0.0, 0.0, 0.17));
    b.add(pot, Cylinder(0.21, 0.03), at + dvec3(0.0, 0.0, 0.33));
    b.add(soil, Cylinder(0.18, 0.01), at + dvec3(0.0, 0.0, 0.365));
    let stem = b.matt(Texture::Plain(rgb(0.36, 0.34, 0.16)));
    let leaves = [
        rgb(0.24, 0.48, 0.20),
        rgb(0.34, 0.58, 0.24),
        rgb(0.18, 0.40, 0.22),
    ]
    .map(|c| b.matt(Texture::Paint(c, 0.05, 0.3)));
    for i in 0..54u64 {
        let seed = b.seed;
        let pick = |j: u64| random(&[seed, 63, i, j]);
        let turn = about_z(0.382 * i as f64 + 0.1 * pick(0));
        let tilt = 0.03 + 0.2 * pick(1);
        let length = 0.22 + 0.62 * (i as f64 / 54.0) * (1.0 - tilt);
        let up = turn * about_x(tilt);
        let root = at + dvec3(0.0, 0.0, 0.37);
        if i % 3 == 0 {
            b.turned(
                stem,
                Rod(0.006, 0.5 * length),
                root + up * dvec3(0.0, 0.0, 0.5 * length),
                up,
            );
        }
        let leaf = turn * about_x(tilt + 0.1 + 0.05 * pick(2));
        let size = 0.7 + 0.5 * pick(3);
        let shape = Ellipsoid(dvec3(0.055, 0.01, 0.13) * size);
        b.turned(
            leaves[(i % 3) as usize],
            shape,
            root + up * dvec3(0.0, 0.0, length),
            leaf,
        );
    }
}

/// What fills the corners: a crate with toys, an armchair, a stool.
pub(super) fn corner(b: &mut Builder) {
    let crate_ = b.matt(Texture::Boards(
        rgb(0.80, 0.64, 0.42),
        rgb(0.62, 0.45, 0.27),
        0.1,
    ));
    b.turned(
        crate_,
        Block(dvec3(0.24, 0.24, 0.2)),
        dvec3(5.55, 0.4, 0.2),
        about_z(0.06),
    );
    let ball = b.matt(Texture::Checker(
        rgb(0.95, 0.92, 0.86),
        rgb(0.16, 0.36, 0.62),
        0.13,
    ));
    b.add(ball, Ellipsoid(DVec3::splat(0.17)), dvec3(5.52, 0.42, 0.57));
    let cubes = [
        rgb(0.85, 0.25, 0.18),
        rgb(0.95, 0.76, 0.22),
        rgb(0.25, 0.55, 0.36),
    ];
    for (i, color) in cubes.into_iter().enumerate() {
        let k = i as f64;
        let m = b.matt(Texture::Paint(color, 0.08, 0.15));
        let at = [
            dvec3(5.1, 0.75, 0.07),
            dvec3(5.22, 0.9, 0.07),
            dvec3(5.15, 0.82, 0.21),
        ][i];
        b.turned(
            m,
            Rounded(DVec3::splat(0.07), 0.012),
            at,
            about_z(0.05 + 0.09 * k),
        );
    }
    armchair(b);
    stool(b);
}

fn armchair(b: &mut Builder) {
    let seat = b.matt(Texture::Wallpaper(
        rgb(0.80, 0.72, 0.58),
        rgb(0.34, 0.42, 0.50),
        0.09,
    ));
    let (x, y) = (4.55, 4.0);
    let r = about_z(-0.02);
    b.turned(
        seat,
        Rounded(dvec3(0.3, 0.3, 0.18), 0.06),
        dvec3(x, y, 0.25),
        r,
    );
    b.turned(
        seat,
        Rounded(dvec3(0.3, 0.09, 0.32), 0.06),
        dvec3(x, y + 0.32, 0.58),
        r,
    );
    for s in [-1.0, 1.0] {
        b.turned(
            seat,
            Rounded(dvec3(0.08, 0.3, 0.27), 0.05),
            dvec3(x + 0.34 * s, y, 0.31),
            r,
        );
    }
}

fn stool(b: &mut Builder) {
    let stool = b.matt(Texture::Rings(
        rgb(0.78, 0.58, 0.36),
        rgb(0.62, 0.42, 0.24),
        0.03,
    ));
    b.add(stool, Cylinder(0.2, 0.025), dvec3(1.0, 0.65, 0.45));
    for k in 0..3 {
        let r = about_z(f64::from(k) / 3.0 + 0.1) * about_x(0.03);
        b.turned(
            stool,
            Rod(0.018, 0.21),
            dvec3(1.0, 0.65, 0.225) + about_z(f64::from(k) / 3.0 + 0.1) * dvec3(0.0, -0.14, 0.0),
            r,
        );
    }
    let book = b.matt(Texture::Picture(3, 0.12, 0.09));
    b.turned(
        book,
        Block(dvec3(0.12, 0.09, 0.015)),
        dvec3(1.0, 0.65, 0.49),
        about_z(0.06),
    );
}
