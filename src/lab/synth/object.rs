//! The scene `object`: a still life on a turned wooden plate, on a transparent background. z points up.

use glam::{DVec3, dvec3};

use crate::lab::synth::hash::{about_x, about_z, cos_turns, sin_turns};
use crate::lab::synth::scene::{Builder, Finish, Light, Scene};
use crate::lab::synth::shape::Shape::{Cylinder, Ellipsoid, Rod, Rounded, Torus};
use crate::lab::synth::texture::{Texture, rgb};
use crate::lab::synth::tree::Tree;

/// The still life.
pub(super) fn scene(seed: u64) -> Scene {
    let mut b = Builder {
        seed,
        ..Builder::default()
    };
    plate(&mut b);
    solids(&mut b);
    cage(&mut b);
    Scene {
        tree: Tree::new(b.solids),
        materials: b.materials,
        lights: vec![
            Light {
                center: dvec3(3.3, -2.4, 3.1),
                half: DVec3::splat(0.4),
                intensity: dvec3(19.0, 18.0, 16.0),
            },
            Light {
                center: dvec3(-3.4, -1.2, 2.2),
                half: DVec3::splat(0.4),
                intensity: dvec3(4.2, 5.2, 6.8),
            },
        ],
        ambient: [dvec3(0.42, 0.45, 0.50), dvec3(0.20, 0.17, 0.15)],
        reach: 0.35,
        studio: true,
    }
}

fn plate(b: &mut Builder) {
    let wood = b.material(
        Texture::Rings(rgb(0.74, 0.50, 0.30), rgb(0.50, 0.30, 0.16), 0.09),
        Finish::Satin(5),
    );
    let rim = b.matt(Texture::Plain(rgb(0.25, 0.16, 0.10)));
    b.add(wood, Cylinder(1.0, 0.035), dvec3(0.0, 0.0, -0.035));
    b.add(rim, Torus(1.0, 0.03), dvec3(0.0, 0.0, -0.035));
    for k in 0..3 {
        let foot = about_z(f64::from(k) / 3.0) * dvec3(0.7, 0.0, -0.12);
        b.add(rim, Ellipsoid(dvec3(0.09, 0.09, 0.06)), foot);
    }
}

fn solids(b: &mut Builder) {
    let chrome = b.material(Texture::Plain(dvec3(0.88, 0.87, 0.85)), Finish::Metal);
    let (middle, radius) = crate::lab::synth::CHROME_SPHERE;
    b.add(chrome, Ellipsoid(DVec3::splat(radius)), middle.into());
    let red = b.material(Texture::Plain(rgb(0.80, 0.10, 0.09)), Finish::Glossy(9));
    b.add(red, Ellipsoid(DVec3::splat(0.22)), dvec3(0.40, -0.50, 0.22));
    let tiles = b.matt(Texture::Checker(
        rgb(0.94, 0.90, 0.80),
        rgb(0.14, 0.38, 0.46),
        0.1,
    ));
    b.turned(
        tiles,
        Rounded(dvec3(0.27, 0.27, 0.27), 0.05),
        dvec3(0.33, 0.38, 0.27),
        about_z(0.09),
    );
    let marble = b.material(
        Texture::Marble(rgb(0.90, 0.89, 0.86), rgb(0.34, 0.38, 0.42), 0.22),
        Finish::Glossy(8),
    );
    b.turned(
        marble,
        Torus(0.21, 0.075),
        dvec3(0.33, 0.38, 0.615),
        about_z(0.1),
    );
    let gold = b.material(Texture::Plain(dvec3(1.0, 0.62, 0.22)), Finish::Metal);
    b.add(
        gold,
        Ellipsoid(DVec3::splat(0.105)),
        dvec3(0.33, 0.38, 0.645),
    );
    let ring = b.matt(Texture::Wallpaper(
        rgb(0.95, 0.70, 0.16),
        rgb(0.80, 0.28, 0.12),
        0.06,
    ));
    let tilt = about_z(0.62) * about_x(0.19);
    b.turned(ring, Torus(0.2, 0.06), dvec3(0.03, -0.14, 0.22), tilt);
    let spots = b.matt(Texture::Patches(
        rgb(0.36, 0.55, 0.26),
        rgb(0.90, 0.84, 0.45),
        0.09,
    ));
    b.add(
        spots,
        Ellipsoid(dvec3(0.12, 0.12, 0.15)),
        dvec3(0.74, -0.08, 0.15),
    );
    let blue = b.material(Texture::Plain(rgb(0.12, 0.26, 0.66)), Finish::Glossy(8));
    b.add(blue, Ellipsoid(DVec3::splat(0.09)), dvec3(0.0, -0.72, 0.09));
    b.add(
        spots,
        Ellipsoid(DVec3::splat(0.06)),
        dvec3(0.20, -0.76, 0.06),
    );
}

/// A cage of thin wires around a lantern: parts of a pixel's width or less.
fn cage(b: &mut Builder) {
    let at = dvec3(-0.38, 0.36, 0.0);
    let wire = b.material(Texture::Plain(rgb(0.20, 0.19, 0.18)), Finish::Satin(6));
    let bars = 12;
    for k in 0..bars {
        let t = f64::from(k) / f64::from(bars);
        let foot = dvec3(0.24 * cos_turns(t), 0.24 * sin_turns(t), 0.36);
        b.add(wire, Rod(0.008, 0.36), at + foot);
        // The roof: a rod from the top of each bar to the peak.
        let (top, peak) = (dvec3(foot.x, foot.y, 0.72), dvec3(0.0, 0.0, 0.95));
        let way = peak - top;
        let sideways = (way.x * way.x + way.y * way.y).sqrt();
        let axis = way.normalize_or_zero();
        let x = dvec3(-way.y, way.x, 0.0) / sideways;
        let r = glam::DMat3::from_cols(x, axis.cross(x), axis);
        b.turned(
            wire,
            Rod(0.007, 0.5 * way.length()),
            at + 0.5 * (top + peak),
            r,
        );
    }
    for z in [0.03, 0.36, 0.72] {
        b.add(wire, Torus(0.24, 0.011), at + dvec3(0.0, 0.0, z));
    }
    let knob = b.material(Texture::Plain(rgb(0.85, 0.66, 0.25)), Finish::Glossy(8));
    b.add(
        knob,
        Ellipsoid(DVec3::splat(0.035)),
        at + dvec3(0.0, 0.0, 0.98),
    );
    bird(b, wire, at);
}

/// The bird on its perch.
fn bird(b: &mut Builder, wire: usize, at: DVec3) {
    let bird = b.matt(Texture::Patches(
        rgb(0.93, 0.48, 0.14),
        rgb(0.96, 0.80, 0.30),
        0.08,
    ));
    b.turned(
        bird,
        Ellipsoid(dvec3(0.08, 0.14, 0.09)),
        at + dvec3(0.0, 0.0, 0.46),
        about_x(0.06),
    );
    b.add(
        bird,
        Ellipsoid(DVec3::splat(0.065)),
        at + dvec3(0.0, 0.12, 0.58),
    );
    let dark = b.material(Texture::Plain(rgb(0.15, 0.12, 0.10)), Finish::Glossy(8));
    for s in [-1.0, 1.0] {
        b.add(
            dark,
            Ellipsoid(DVec3::splat(0.013)),
            at + dvec3(0.045 * s, 0.155, 0.60),
        );
    }
    b.turned(
        dark,
        Ellipsoid(dvec3(0.018, 0.045, 0.014)),
        at + dvec3(0.0, 0.19, 0.575),
        about_x(-0.02),
    );
    b.turned(
        wire,
        Rod(0.009, 0.24),
        at + dvec3(0.0, 0.0, 0.36),
        about_z(0.25) * about_x(0.25),
    );
}

/// Where camera `index` of `views` stands and what it looks at: a golden-angle spiral over the upper hemisphere, so that any
/// evenly spaced subset covers it too.
pub(super) fn camera(index: u32, views: u32) -> (DVec3, DVec3) {
    let share = (f64::from(index) + 0.5) / f64::from(views.max(1));
    let z = 0.06 + 0.84 * share;
    let r = (1.0 - z * z).sqrt();
    let t = f64::from(index) * 0.381_966_011_250_105_1;
    let target = dvec3(0.0, 0.0, 0.33);
    (
        target + 3.9 * dvec3(r * cos_turns(t), r * sin_turns(t), z),
        target,
    )
}
