//! The scene `room`: a furnished room of 6 × 4.6 × 2.7 m. x and y span the floor, z points up, the origin is a corner.

use std::f64::consts::FRAC_1_SQRT_2;

use glam::{DVec3, dvec3};

use crate::lab::synth::hash::{about_x, about_z, cos_turns, random, sin_turns};
use crate::lab::synth::scene::{Builder, Finish, Light, Scene};
use crate::lab::synth::shape::Shape::{Block, Cylinder, Ellipsoid, Rod, Rounded, Torus};
use crate::lab::synth::texture::{Texture, rgb};
use crate::lab::synth::tree::Tree;

/// Length, width and height of the room.
const SIZE: DVec3 = dvec3(6.0, 4.6, 2.7);

/// The room.
pub(super) fn scene(seed: u64) -> Scene {
    let mut b = Builder {
        seed,
        ..Builder::default()
    };
    walls(&mut b);
    trim(&mut b);
    table(&mut b);
    still_life(&mut b);
    sofa(&mut b);
    crate::lab::synth::furniture::shelf(&mut b, dvec3(4.45, 0.17, 0.0));
    crate::lab::synth::furniture::sideboard(&mut b, dvec3(0.24, 2.1, 0.0));
    crate::lab::synth::furniture::plant(&mut b, dvec3(0.6, 4.05, 0.0));
    crate::lab::synth::furniture::corner(&mut b);
    pictures(&mut b);
    lamps(&mut b);
    Scene {
        tree: Tree::new(b.solids),
        materials: b.materials,
        lights: vec![
            Light {
                center: dvec3(3.0, 2.3, 2.15),
                half: dvec3(0.13, 0.13, 0.13),
                intensity: dvec3(1.75, 1.56, 1.28),
            },
            Light {
                center: dvec3(5.45, 4.05, 1.62),
                half: dvec3(0.13, 0.13, 0.12),
                intensity: dvec3(0.95, 0.66, 0.40),
            },
        ],
        ambient: [dvec3(0.40, 0.42, 0.47), dvec3(0.34, 0.29, 0.25)],
        reach: 0.45,
        studio: false,
    }
}

fn walls(b: &mut Builder) {
    let (h, t) = (SIZE * 0.5, 0.05);
    let floor = b.material(
        Texture::Boards(rgb(0.80, 0.58, 0.38), rgb(0.52, 0.31, 0.17), 0.14),
        Finish::Satin(5),
    );
    let ceiling = b.matt(Texture::Panels(rgb(0.93, 0.91, 0.87), 0.6));
    let brick = b.matt(Texture::Brick(
        rgb(0.80, 0.46, 0.36),
        rgb(0.78, 0.74, 0.69),
        0.24,
    ));
    let teal = b.matt(Texture::Paint(rgb(0.36, 0.60, 0.60), 0.5, 0.22));
    let paper = b.matt(Texture::Wallpaper(
        rgb(0.93, 0.88, 0.76),
        rgb(0.78, 0.66, 0.46),
        0.2,
    ));
    let plaster = b.matt(Texture::Paint(rgb(0.90, 0.80, 0.66), 0.35, 0.18));
    let wide = dvec3(h.x + t, h.y + t, t);
    b.add(floor, Block(wide), dvec3(h.x, h.y, -t));
    b.add(ceiling, Block(wide), dvec3(h.x, h.y, SIZE.z + t));
    b.add(brick, Block(dvec3(t, h.y, h.z)), dvec3(-t, h.y, h.z));
    b.add(teal, Block(dvec3(t, h.y, h.z)), dvec3(SIZE.x + t, h.y, h.z));
    b.add(paper, Block(dvec3(h.x, t, h.z)), dvec3(h.x, -t, h.z));
    b.add(
        plaster,
        Block(dvec3(h.x, t, h.z)),
        dvec3(h.x, SIZE.y + t, h.z),
    );
}

/// Skirting, a dado rail, ceiling beams, the rug and a door.
fn trim(b: &mut Builder) {
    let white = b.matt(Texture::Paint(rgb(0.94, 0.92, 0.88), 0.3, 0.05));
    for (height, half) in [(0.06, 0.06), (SIZE.z - 0.04, 0.04)] {
        b.add(
            white,
            Block(dvec3(3.0, 0.012, half)),
            dvec3(3.0, 0.012, height),
        );
        b.add(
            white,
            Block(dvec3(3.0, 0.012, half)),
            dvec3(3.0, SIZE.y - 0.012, height),
        );
        b.add(
            white,
            Block(dvec3(0.012, 2.3, half)),
            dvec3(0.012, 2.3, height),
        );
        b.add(
            white,
            Block(dvec3(0.012, 2.3, half)),
            dvec3(SIZE.x - 0.012, 2.3, height),
        );
    }
    let beam = b.matt(Texture::Wood(
        rgb(0.50, 0.33, 0.20),
        rgb(0.31, 0.19, 0.11),
        1,
        0.05,
    ));
    for x in [1.2, 4.8] {
        b.add(
            beam,
            Block(dvec3(0.08, 2.3, 0.08)),
            dvec3(x, 2.3, SIZE.z - 0.08),
        );
    }
    let rug = b.matt(Texture::Rug(
        rgb(0.72, 0.20, 0.18),
        rgb(0.16, 0.24, 0.42),
        1.5,
        1.05,
    ));
    b.add(rug, Block(dvec3(1.5, 1.05, 0.008)), dvec3(3.0, 2.3, 0.008));
    door(b, white);
}

fn door(b: &mut Builder, white: usize) {
    let door = b.matt(Texture::Wood(
        rgb(0.70, 0.47, 0.28),
        rgb(0.48, 0.29, 0.15),
        2,
        0.06,
    ));
    let x = SIZE.x;
    b.add(white, Block(dvec3(0.02, 0.52, 1.06)), dvec3(x, 1.25, 1.06));
    b.add(door, Block(dvec3(0.03, 0.45, 1.0)), dvec3(x, 1.25, 1.0));
    for (z, half) in [(0.5, 0.36), (1.42, 0.44)] {
        for y in [1.04, 1.46] {
            b.add(
                door,
                Rounded(dvec3(0.018, 0.16, half), 0.012),
                dvec3(x - 0.03, y, z),
            );
        }
    }
    let brass = b.material(Texture::Plain(rgb(0.85, 0.68, 0.35)), Finish::Satin(6));
    b.add(
        brass,
        Ellipsoid(DVec3::splat(0.035)),
        dvec3(x - 0.08, 1.63, 1.0),
    );
}

fn table(b: &mut Builder) {
    let oak = b.material(
        Texture::Wood(rgb(0.83, 0.63, 0.40), rgb(0.60, 0.39, 0.21), 0, 0.05),
        Finish::Satin(4),
    );
    let leg = b.matt(Texture::Wood(
        rgb(0.70, 0.49, 0.30),
        rgb(0.50, 0.31, 0.17),
        2,
        0.03,
    ));
    b.add(
        oak,
        Rounded(dvec3(0.8, 0.46, 0.022), 0.015),
        dvec3(3.0, 2.3, 0.74),
    );
    for (sx, sy) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let foot = dvec3(3.0 + 0.7 * sx, 2.3 + 0.37 * sy, 0.36);
        b.add(leg, Block(dvec3(0.035, 0.035, 0.36)), foot);
    }
    let blue = b.matt(Texture::Paint(rgb(0.22, 0.42, 0.62), 0.1, 0.15));
    let green = b.matt(Texture::Paint(rgb(0.45, 0.60, 0.30), 0.1, 0.15));
    crate::lab::synth::furniture::chair(b, blue, dvec3(2.7, 1.55, 0.0), -0.02);
    crate::lab::synth::furniture::chair(b, green, dvec3(3.35, 3.08, 0.0), 0.53);
    crate::lab::synth::furniture::chair(b, blue, dvec3(4.15, 2.2, 0.0), 0.27);
}

/// What stands on the table, whose top is at `top`.
fn still_life(b: &mut Builder) {
    let top = 0.762;
    let checker = b.matt(Texture::Checker(
        rgb(0.92, 0.90, 0.84),
        rgb(0.75, 0.16, 0.14),
        0.055,
    ));
    b.add(
        checker,
        Ellipsoid(DVec3::splat(0.12)),
        dvec3(2.62, 2.42, top + 0.12),
    );
    let orange = b.material(
        Texture::Patches(rgb(0.95, 0.55, 0.12), rgb(0.88, 0.42, 0.08), 0.06),
        Finish::Satin(5),
    );
    for (x, y) in [(3.02, 2.2), (3.11, 2.25), (3.05, 2.3)] {
        b.add(
            orange,
            Ellipsoid(DVec3::splat(0.045)),
            dvec3(x, y, top + 0.06),
        );
    }
    b.add(
        orange,
        Ellipsoid(DVec3::splat(0.045)),
        dvec3(3.06, 2.25, top + 0.125),
    );
    let bowl = b.material(
        Texture::Marble(rgb(0.88, 0.90, 0.92), rgb(0.25, 0.38, 0.62), 0.08),
        Finish::Satin(6),
    );
    b.add(bowl, Torus(0.125, 0.026), dvec3(3.06, 2.25, top + 0.028));
    let mug = b.material(
        Texture::Rings(rgb(0.20, 0.52, 0.50), rgb(0.24, 0.60, 0.56), 0.02),
        Finish::Satin(6),
    );
    b.add(mug, Cylinder(0.045, 0.055), dvec3(3.42, 2.48, top + 0.055));
    b.turned(
        mug,
        Torus(0.03, 0.008),
        dvec3(3.47, 2.48, top + 0.055),
        about_x(0.25),
    );
    books(b, top);
    flowers(b, top);
}

/// A stack of books.
fn books(b: &mut Builder, top: f64) {
    let covers = [
        rgb(0.62, 0.16, 0.16),
        rgb(0.20, 0.30, 0.52),
        rgb(0.88, 0.76, 0.42),
    ];
    for (i, color) in covers.into_iter().enumerate() {
        let k = i as f64;
        let m = b.matt(Texture::Wallpaper(color, color * 0.6, 0.05));
        let half = dvec3(0.13 - 0.012 * k, 0.09 - 0.008 * k, 0.016);
        b.turned(
            m,
            Block(half),
            dvec3(3.52, 2.14, top + 0.016 + 0.032 * k),
            about_z(0.04 * k - 0.02),
        );
    }
}

/// A vase of flowers.
fn flowers(b: &mut Builder, top: f64) {
    let vase = b.material(
        Texture::Marble(rgb(0.20, 0.32, 0.50), rgb(0.80, 0.84, 0.86), 0.13),
        Finish::Satin(6),
    );
    b.add(
        vase,
        Ellipsoid(dvec3(0.07, 0.07, 0.1)),
        dvec3(2.42, 2.12, top + 0.095),
    );
    b.add(vase, Cylinder(0.03, 0.05), dvec3(2.42, 2.12, top + 0.21));
    let stem = b.matt(Texture::Plain(rgb(0.28, 0.45, 0.18)));
    let petal = b.matt(Texture::Paint(rgb(0.93, 0.78, 0.20), 0.03, 0.3));
    for i in 0..6u64 {
        let turn = i as f64 / 6.0 + 0.1 * random(&[b.seed, 5, i]);
        let tilt = 0.02 + 0.04 * random(&[b.seed, 6, i]);
        let r = about_z(turn) * about_x(tilt);
        let foot = dvec3(2.42, 2.12, top + 0.25);
        b.turned(stem, Rod(0.006, 0.1), foot + r * dvec3(0.0, 0.0, 0.1), r);
        b.turned(
            petal,
            Ellipsoid(dvec3(0.045, 0.045, 0.022)),
            foot + r * dvec3(0.0, 0.0, 0.22),
            r,
        );
    }
}

fn sofa(b: &mut Builder) {
    let cloth = b.matt(Texture::Paint(rgb(0.42, 0.48, 0.34), 0.03, 0.22));
    let (x, y) = (2.3, 4.1);
    b.add(
        cloth,
        Rounded(dvec3(1.0, 0.42, 0.16), 0.05),
        dvec3(x, y, 0.24),
    );
    b.add(
        cloth,
        Rounded(dvec3(1.0, 0.1, 0.36), 0.06),
        dvec3(x, y + 0.36, 0.48),
    );
    for s in [-1.0, 1.0] {
        b.add(
            cloth,
            Rounded(dvec3(0.1, 0.44, 0.27), 0.06),
            dvec3(x + s, y, 0.33),
        );
        b.add(
            cloth,
            Rounded(dvec3(0.46, 0.36, 0.07), 0.05),
            dvec3(x + 0.46 * s, y - 0.04, 0.44),
        );
    }
    let looks = [
        Texture::Checker(rgb(0.93, 0.88, 0.78), rgb(0.20, 0.34, 0.46), 0.065),
        Texture::Patches(rgb(0.90, 0.62, 0.22), rgb(0.80, 0.32, 0.16), 0.09),
        Texture::Wallpaper(rgb(0.86, 0.82, 0.74), rgb(0.62, 0.22, 0.24), 0.06),
    ];
    for (look, (dx, turn)) in looks
        .into_iter()
        .zip([(-0.68, 0.03), (0.25, -0.02), (0.7, -0.04)])
    {
        let m = b.matt(look);
        let r = about_z(turn) * about_x(-0.05);
        b.turned(
            m,
            Rounded(dvec3(0.2, 0.07, 0.2), 0.065),
            dvec3(x + dx, y + 0.12, 0.69),
            r,
        );
    }
}

/// Pictures with their frames: middle, half width, half height, and which wall they hang on.
fn pictures(b: &mut Builder) {
    let frames = [
        rgb(0.22, 0.15, 0.10),
        rgb(0.85, 0.80, 0.70),
        rgb(0.12, 0.12, 0.13),
    ];
    let walls = [
        (0, dvec3(2.3, SIZE.y, 1.6), 0.75, 0.45, 0.5),
        (1, dvec3(SIZE.x, 2.75, 1.55), 0.34, 0.46, 0.25),
        (2, dvec3(1.9, 0.0, 1.55), 0.62, 0.46, 0.0),
        (3, dvec3(SIZE.x, 3.65, 1.6), 0.3, 0.4, 0.25),
        (2, dvec3(0.0, 3.35, 1.6), 0.32, 0.32, -0.25),
        (3, dvec3(3.15, 0.0, 1.6), 0.28, 0.4, 0.0),
        (1, dvec3(0.0, 0.85, 1.55), 0.4, 0.5, -0.25),
        (0, dvec3(4.2, SIZE.y, 1.65), 0.34, 0.44, 0.5),
    ];
    for (i, (k, middle, hu, hv, turn)) in walls.into_iter().enumerate() {
        let canvas = b.matt(Texture::Picture(k, hu, hv));
        let frame = b.matt(Texture::Plain(frames[i % frames.len()]));
        let r = about_z(turn);
        b.turned(canvas, Block(dvec3(hu, 0.02, hv)), middle, r);
        for s in [-1.0, 1.0] {
            let side = r * dvec3(s * (hu + 0.02), 0.0, 0.0);
            b.turned(
                frame,
                Block(dvec3(0.02, 0.035, hv + 0.04)),
                middle + side,
                r,
            );
            let edge = dvec3(0.0, 0.0, s * (hv + 0.02));
            b.turned(frame, Block(dvec3(hu, 0.035, 0.02)), middle + edge, r);
        }
    }
}

fn lamps(b: &mut Builder) {
    let globe = b.material(Texture::Plain(dvec3(1.0, 0.90, 0.72)), Finish::Glowing(2.6));
    let shade = b.material(Texture::Plain(dvec3(1.0, 0.70, 0.40)), Finish::Glowing(1.5));
    let metal = b.material(Texture::Plain(rgb(0.25, 0.25, 0.27)), Finish::Satin(5));
    b.add(globe, Ellipsoid(DVec3::splat(0.17)), dvec3(3.0, 2.3, 2.15));
    b.add(metal, Rod(0.008, 0.19), dvec3(3.0, 2.3, 2.51));
    b.add(shade, Cylinder(0.2, 0.17), dvec3(5.45, 4.05, 1.62));
    b.add(metal, Rod(0.014, 0.7), dvec3(5.45, 4.05, 0.72));
    b.add(metal, Cylinder(0.15, 0.012), dvec3(5.45, 4.05, 0.012));
}

/// Where camera `index` of `views` stands and what it looks at: half of them walk around the room and look across it, the
/// other half walk around the table and look outwards.
pub(super) fn camera(index: u32, views: u32) -> (DVec3, DVec3) {
    let inward = views.div_ceil(2);
    let middle = dvec3(3.0, 2.3, 0.0);
    if index < inward {
        let t = (f64::from(index) + 0.25) / f64::from(inward);
        let (s, c) = (sin_turns(t), cos_turns(t));
        let at = middle + dvec3(2.05 * c, 1.3 * s, 1.5 + 0.28 * sin_turns(3.0 * t));
        let target = middle + dvec3(-0.5 * c, -0.4 * s, 0.95 + 0.15 * sin_turns(5.0 * t));
        (at, target)
    } else {
        let t = (f64::from(index - inward) + 0.5) / f64::from((views - inward).max(1));
        let (s, c) = (sin_turns(t), cos_turns(t));
        let at = middle + dvec3(0.6 * c, 0.4 * s, 1.45 + 0.2 * sin_turns(2.0 * t));
        let bend = FRAC_1_SQRT_2 * sin_turns(4.0 * t + 0.1);
        (
            at,
            at + dvec3(c - 0.3 * s * bend, s + 0.3 * c * bend, -0.12 + 0.42 * bend),
        )
    }
}
