//! The background of a scene as Gaussians, for programs that know of no background.

use std::borrow::Cow;
use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::base::error::Result;
use crate::base::math::logit;
use crate::scene::formats::scene_file::SceneFile;
use crate::scene::gaussians::{Gaussians, Plane};
use crate::scene::sh::C0;

/// Gaussians of a shell: eight chunks of a compressed PLY file.
const COUNT: usize = 2048;

/// Standard deviation of one, in units of the side of the square that it has of the shell: 0.3 % of what lies behind shines through at the most.
const OVERLAP: f64 = 0.85;

/// Opacity of each.
const OPACITY: f64 = 0.99;

/// Radius of the shell over the distance of the farthest Gaussian, with room for the order by depth, which is less far from the axis; and over the
/// radius of the sphere around the cameras.
const BEYOND: f64 = 1.5;
const ABOUT: f64 = 2.0;

/// Least radius over the distance of the farthest Gaussian, where a format has no room for more.
const LEAST: f64 = 1.05;

/// Largest coordinate that a shell is made with: positions have single precision.
const FARTHEST: f64 = 1e30;

/// Fewest Gaussians that are taken for a shell, and the largest difference of their colour to the one that is named.
const LEAST_COUNT: usize = 64;
const NEAR_COLOR: f64 = 0.01;

/// Largest numbers that a format has for a shell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    /// Largest absolute coordinate.
    pub coordinate: f64,
    /// Largest radius; the scales of its Gaussians grow with it.
    pub radius: f64,
}

impl Reach {
    /// The reach of single precision.
    pub const SINGLE: Self = Self {
        coordinate: FARTHEST,
        radius: FARTHEST,
    };
}

impl SceneFile {
    /// The scene with its background as Gaussians of one colour on a sphere beyond all others, the first ones; as it is without a background, and
    /// where the others leave no room for it within the largest `reach`.
    ///
    /// # Errors
    /// None that a scene can cause.
    pub(super) fn enclosed(&self, reach: Reach) -> Result<Cow<'_, Self>> {
        let about = self.background.zip(self.enclosing(reach));
        let Some((color, (center, radius))) = about else {
            return Ok(Cow::Borrowed(self));
        };
        let mut splats = shell(self.splats.sh_degree(), center, radius, color);
        splats.append(&self.splats)?;
        Ok(Cow::Owned(Self {
            splats,
            remarks: self.remarks.clone(),
            ..*self
        }))
    }

    /// The scene of a file whose first Gaussians are said to be a shell: without them, if they may be one.
    pub(super) fn without_shell(mut self, said: Option<Shell>) -> Self {
        if let Some(Shell { color, count }) = said.filter(|shell| shell.begins(&self.splats)) {
            self.splats = self.splats.after(count);
            self.background = Some(color);
        }
        self
    }

    /// Centre and radius of a sphere beyond all Gaussians within the largest `reach`; `None` if there is none.
    pub(super) fn enclosing(&self, reach: Reach) -> Option<(DVec3, f64)> {
        let places = |i: usize| {
            let place: [f32; 3] = self.splats.gather(Plane::POSITION, i);
            DVec3::from_array(place.map(f64::from))
        };
        let n = self.splats.len();
        let (center, about) = match self.cameras {
            Some(sphere) => (sphere.center, sphere.radius),
            None => ((0..n).map(places).sum::<DVec3>() / n.max(1) as f64, 0.5),
        };
        let farthest = (0..n).map(|i| places(i).distance(center));
        let farthest = farthest.fold(about, f64::max);
        let room = reach.coordinate - center.abs().max_element();
        let radius = (BEYOND * farthest).max(ABOUT * about);
        let radius = radius.min(room).min(reach.radius);
        (radius >= LEAST * farthest).then_some((center, radius))
    }
}

fn shell(sh_degree: u32, center: DVec3, radius: f64, color: [f32; 3]) -> Gaussians {
    let side = (2.0 * TAU / COUNT as f64).sqrt();
    let scale = (OVERLAP * side * radius).ln() as f32;
    let color = color.map(|c| ((f64::from(c) - 0.5) / C0) as f32);
    let mut shell = Gaussians::zeros(sh_degree, COUNT);
    shell.plane_mut(Plane::OPACITY).fill(logit(OPACITY) as f32);
    for i in 0..COUNT {
        let place = center + radius * direction(i);
        shell.scatter(Plane::POSITION, i, place.as_vec3().to_array());
        shell.scatter(Plane::LOG_SCALE, i, [scale; 3]);
        shell.scatter(Plane::SH, i, color);
    }
    shell
}

/// Unit vectors spread evenly over the sphere: a Fibonacci lattice.
fn direction(i: usize) -> DVec3 {
    let turn = PI * (3.0 - 5.0_f64.sqrt()) * i as f64;
    let z = 1.0 - (2 * i + 1) as f64 / COUNT as f64;
    let flat = (1.0 - z * z).sqrt();
    DVec3::new(flat * turn.cos(), flat * turn.sin(), z)
}

/// A shell, by the header of its file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shell {
    /// RGB in \[0, 1\].
    pub color: [f32; 3],
    /// Gaussians that it has, the first ones of the file.
    pub count: usize,
}

impl Shell {
    /// A shell from what its comment says after the mark.
    pub fn parse(text: &str) -> Option<Self> {
        let (color, vertices) = text.split_once(", the first ")?;
        let color: Option<Vec<f32>> = color.split_whitespace().map(|v| v.parse().ok()).collect();
        let color: [f32; 3] = color?.try_into().ok()?;
        let count = vertices.strip_suffix(" vertices")?.parse().ok()?;
        let good = color.iter().all(|v| (0.0..=1.0).contains(v));
        good.then_some(Self { color, count })
    }

    /// The text that [`Self::parse`] reads, of a scene's background.
    pub fn text([r, g, b]: [f32; 3]) -> String {
        format!("{r} {g} {b}, the first {COUNT} vertices")
    }

    /// True if the first Gaussians have this colour, one opacity and one size, as those of a shell: a program may have kept the comment and have taken
    /// Gaussians out.
    fn begins(&self, splats: &Gaussians) -> bool {
        if !(LEAST_COUNT..=splats.len()).contains(&self.count) {
            return false;
        }
        let first = |plane: usize| &splats.planes()[plane][..self.count];
        let same = |plane: usize| first(plane).windows(2).all(|v| v[0] == v[1]);
        let color = |c: usize| 0.5 + C0 * f64::from(first(Plane::SH + c)[0]);
        let said = |c: usize| (color(c) - f64::from(self.color[c])).abs() < NEAR_COLOR;
        let colors = (0..3).all(|c| same(Plane::SH + c) && same(Plane::LOG_SCALE + c) && said(c));
        colors && same(Plane::OPACITY)
    }
}
