//! The scenes: solids, lamps and camera paths. z points up.

use glam::{DVec3, dvec3};

use crate::lab::synth::scene::{Finish, Material, Scene, Shape, Solid, rgb};

/// Names of all scenes.
pub const NAMES: [&str; 2] = ["room", "object"];

/// Centre and radius of the chrome sphere of `object`, scene units: its colour depends on the view.
pub const CHROME_SPHERE: ([f64; 3], f64) = ([-0.36, -0.42, 0.30], 0.30);

/// The scene of a name; `None` if there is none.
pub(super) fn named(name: &str, seed: u64) -> Option<Scene> {
    match name {
        "room" => Some(room(seed)),
        "object" => Some(object(seed)),
        _ => None,
    }
}

/// A box.
fn block(center: impl Into<DVec3>, half: [f64; 3], material: Material) -> Solid {
    Solid {
        shape: Shape::Block(half.into()),
        center: center.into(),
        material,
    }
}

/// A sphere.
fn sphere(center: impl Into<DVec3>, radius: f64, material: Material) -> Solid {
    Solid {
        shape: Shape::Sphere(radius),
        center: center.into(),
        material,
    }
}

/// A room of 6 × 4.6 × 2.7 m, its origin in a corner: floor, ceiling, four walls and a picture on each, a table with a still
/// life, a chest, a shelf and a ball.
fn room(seed: u64) -> Scene {
    let lamp = dvec3(3.0, 2.3, 2.15);
    let globe = Material {
        finish: Finish::Lamp,
        ..Material::plain(dvec3(2.6, 2.3, 1.9))
    };
    let checker = Material::checker;
    let (cream, blue) = (rgb(0.95, 0.88, 0.74), rgb(0.25, 0.42, 0.62));
    let (red, green) = (rgb(0.76, 0.34, 0.26), rgb(0.42, 0.60, 0.36));
    let floor = checker(rgb(0.84, 0.62, 0.42), rgb(0.52, 0.32, 0.20), 0.23);
    let ceiling = checker(rgb(0.96, 0.94, 0.90), rgb(0.84, 0.84, 0.86), 0.45);
    let pictures = [
        checker(red, green, 0.07),
        checker(green, blue, 0.09),
        checker(cream, red, 0.08),
        checker(cream, green, 0.1),
    ];
    let wood = checker(rgb(0.62, 0.44, 0.30), rgb(0.50, 0.34, 0.22), 0.11);
    let dark = Material::plain(rgb(0.30, 0.24, 0.20));
    let cloth = checker(rgb(0.80, 0.76, 0.60), rgb(0.34, 0.46, 0.40), 0.13);
    let toy = checker(rgb(0.90, 0.66, 0.20), rgb(0.24, 0.34, 0.66), 0.06);
    let steel = Material::metal(dvec3(0.85, 0.86, 0.88));
    let (t, table) = (0.05, dvec3(3.0, 2.3, 0.0));
    let [level, across, along] = [[3.0, 2.3, t], [t, 2.3, 1.35], [3.0, t, 1.35]];
    let mut solids = vec![
        sphere(lamp, 0.17, globe),
        block([3.0, 2.3, -t], level, floor),
        block([3.0, 2.3, 2.7 + t], level, ceiling),
        block([-t, 2.3, 1.35], across, checker(cream, blue, 0.31)),
        block([6.0 + t, 2.3, 1.35], across, checker(cream, red, 0.27)),
        block([3.0, -t, 1.35], along, checker(green, cream, 0.29)),
        block([3.0, 4.6 + t, 1.35], along, checker(blue, red, 0.33)),
        block([0.0, 3.1, 1.6], [0.03, 0.4, 0.35], pictures[0]),
        block([6.0, 2.6, 1.6], [0.03, 0.5, 0.4], pictures[1]),
        block([1.9, 0.0, 1.6], [0.6, 0.03, 0.45], pictures[2]),
        block([2.3, 4.6, 1.6], [0.7, 0.03, 0.4], pictures[3]),
        block(table + dvec3(0.0, 0.0, 0.72), [0.7, 0.45, 0.03], wood),
        sphere(table + dvec3(0.3, -0.1, 0.89), 0.14, steel),
        sphere(table + dvec3(-0.3, 0.15, 0.86), 0.11, toy),
        block(table + dvec3(0.0, -0.2, 0.84), [0.09, 0.12, 0.09], cloth),
        block([3.0, 4.15, 0.25], [0.9, 0.4, 0.25], cloth),
        block([0.35, 1.3, 0.4], [0.3, 0.7, 0.4], wood),
        sphere([5.3, 3.9, 0.3], 0.3, toy),
    ];
    for (x, y) in [(-0.6, -0.36), (-0.6, 0.36), (0.6, -0.36), (0.6, 0.36)] {
        let leg = [0.035, 0.035, 0.345];
        solids.push(block(table + dvec3(x, y, 0.345), leg, dark));
    }
    for k in (0..4).map(f64::from) {
        let (x, z) = (4.55 + 0.22 * k, 0.3 + 0.45 * k);
        solids.push(block([4.9, 0.17, z], [0.6, 0.17, 0.02], dark));
        solids.push(block([x, 0.17, z + 0.15], [0.08, 0.1, 0.13], toy));
    }
    Scene {
        solids,
        lamp,
        intensity: dvec3(3.4, 3.1, 2.6),
        ambient: [dvec3(0.50, 0.52, 0.57), dvec3(0.44, 0.39, 0.35)],
        seed,
        camera: room_camera,
        tan: 0.72,
        transparent: false,
    }
}

/// Cameras of `room`: half of them walk around the room and look across it, the others walk around the table and look outwards.
fn room_camera(index: u32, views: u32) -> (DVec3, DVec3) {
    let inward = views.div_ceil(2);
    let middle = dvec3(3.0, 2.3, 0.0);
    if index < inward {
        let t = (f64::from(index) + 0.25) / f64::from(inward);
        let (s, c) = (sin_turns(t), cos_turns(t));
        let at = dvec3(2.05 * c, 1.3 * s, 1.5 + 0.28 * sin_turns(3.0 * t));
        let target = dvec3(-0.5 * c, -0.4 * s, 0.95 + 0.15 * sin_turns(5.0 * t));
        return (middle + at, middle + target);
    }
    let t = (f64::from(index - inward) + 0.5) / f64::from((views - inward).max(1));
    let (s, c) = (sin_turns(t), cos_turns(t));
    let at = middle + dvec3(0.6 * c, 0.4 * s, 1.45 + 0.2 * sin_turns(2.0 * t));
    let tilt = 0.3 * sin_turns(4.0 * t + 0.1);
    (at, at + dvec3(c, s, tilt - 0.12))
}

/// A still life on a plate: a chrome sphere, a ball and boxes, and a cage of wires about as thin as a pixel.
fn object(seed: u64) -> Scene {
    let checker = Material::checker;
    let plate = checker(rgb(0.78, 0.56, 0.36), rgb(0.56, 0.36, 0.22), 0.16);
    let tiles = checker(rgb(0.94, 0.90, 0.80), rgb(0.14, 0.38, 0.46), 0.09);
    let spots = checker(rgb(0.36, 0.55, 0.26), rgb(0.90, 0.84, 0.45), 0.07);
    let red = Material::plain(rgb(0.80, 0.20, 0.16));
    let wire = Material::plain(rgb(0.25, 0.24, 0.28));
    let (center, radius) = CHROME_SPHERE;
    let chrome = Material::metal(dvec3(0.88, 0.87, 0.85));
    let mut solids = vec![
        block([0.0, 0.0, -0.05], [1.0, 1.0, 0.05], plate),
        sphere(center, radius, chrome),
        block([0.40, 0.40, 0.25], [0.25; 3], tiles),
        sphere([0.40, 0.40, 0.66], 0.16, spots),
        block([0.78, -0.25, 0.12], [0.12; 3], red),
        sphere([0.42, -0.50, 0.20], 0.20, tiles),
    ];
    let cage = dvec3(-0.40, 0.42, 0.36);
    for (x, y) in [(-0.24, -0.24), (-0.24, 0.24), (0.24, -0.24), (0.24, 0.24)] {
        let post = [0.008, 0.008, 0.36];
        solids.push(block(cage + dvec3(x, y, 0.0), post, wire));
    }
    for z in [-0.33, 0.0, 0.35] {
        for side in [-0.24, 0.24] {
            let (along_x, along_y) = ([0.24, 0.008, 0.008], [0.008, 0.24, 0.008]);
            solids.push(block(cage + dvec3(0.0, side, z), along_x, wire));
            solids.push(block(cage + dvec3(side, 0.0, z), along_y, wire));
        }
    }
    solids.push(sphere(cage + dvec3(0.0, 0.0, -0.1), 0.15, spots));
    Scene {
        solids,
        lamp: dvec3(3.3, -2.4, 3.1),
        intensity: dvec3(19.0, 18.0, 16.0),
        ambient: [dvec3(0.52, 0.55, 0.60), dvec3(0.25, 0.22, 0.20)],
        seed,
        camera: object_camera,
        tan: 0.305,
        transparent: true,
    }
}

/// Cameras of `object`: a golden-angle spiral over the upper hemisphere, so that any evenly spaced subset covers it too.
fn object_camera(index: u32, views: u32) -> (DVec3, DVec3) {
    let share = (f64::from(index) + 0.5) / f64::from(views.max(1));
    let z = 0.06 + 0.84 * share;
    let r = (1.0 - z * z).sqrt();
    let t = f64::from(index) * 0.381_966_011_250_105_1;
    let target = dvec3(0.0, 0.0, 0.33);
    let away = dvec3(r * cos_turns(t), r * sin_turns(t), z);
    (target + 3.9 * away, target)
}

/// Sine of an angle in turns (1 = 360°), to about 1e-11: the Taylor series over a quarter turn either side of zero.
fn sin_turns(turns: f64) -> f64 {
    let t = turns - (turns + 0.5).floor();
    let folded = if t > 0.25 {
        0.5 - t
    } else if t < -0.25 {
        -0.5 - t
    } else {
        t
    };
    let x = folded * std::f64::consts::TAU;
    let (mut term, mut sum) = (x, x);
    for k in 1..=9 {
        let n = f64::from(2 * k);
        term *= -x * x / (n * (n + 1.0));
        sum += term;
    }
    sum
}

/// Cosine of an angle in turns.
fn cos_turns(turns: f64) -> f64 {
    sin_turns(turns + 0.25)
}
