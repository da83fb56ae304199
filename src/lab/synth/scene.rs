//! Solids, their materials and the lamp, and the light along a ray.
//!
//! IEEE 754 fixes the result of + − × ÷ and √, and Rust never contracts them; `sin`, `powf` and their kin come from the
//! platform's libm and may differ in the last bit. No scene uses libm.

use glam::{DVec3, dvec3};

/// SplitMix64's finaliser (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators").
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Random number in [0, 1) keyed by `words`; their order counts.
pub(super) fn random(words: &[u64]) -> f64 {
    const STEP: u64 = 0x9e37_79b9_7f4a_7c15;
    let hash = words
        .iter()
        .fold(STEP, |h, w| mix(h.wrapping_add(STEP) ^ mix(w ^ STEP)));
    (hash >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// A solid about its centre, axis-aligned. Lengths in scene units.
#[derive(Debug, Clone, Copy)]
pub(super) enum Shape {
    /// Sphere of this radius.
    Sphere(f64),
    /// Box with these half lengths.
    Block(DVec3),
}

/// Reflection of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Finish {
    /// Lambertian: the same from every direction.
    Matt,
    /// A mirror, tinted by the colour.
    Metal,
    /// The lamp: the colour is the emitted radiance. It casts no shadow, because the light comes from its middle.
    Lamp,
}

/// Colour and reflection of a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Material {
    /// Linear RGB of the two kinds of squares of a checkerboard.
    pub colors: [DVec3; 2],
    /// Side of the squares; infinite for a plain colour.
    pub side: f64,
    /// Reflection.
    pub finish: Finish,
}

/// Linear RGB of a display colour, by the square that [`crate::lab::synth::render`] inverts with a square root.
pub(super) fn rgb(r: f64, g: f64, b: f64) -> DVec3 {
    dvec3(r * r, g * g, b * b)
}

impl Material {
    /// One matt colour.
    pub fn plain(color: DVec3) -> Self {
        Self {
            colors: [color; 2],
            side: f64::INFINITY,
            finish: Finish::Matt,
        }
    }

    /// A matt checkerboard whose squares vary in tone.
    pub fn checker(a: DVec3, b: DVec3, side: f64) -> Self {
        Self {
            colors: [a, b],
            side,
            ..Self::plain(a)
        }
    }

    /// A mirror tinted by `color`.
    pub fn metal(color: DVec3) -> Self {
        Self {
            finish: Finish::Metal,
            ..Self::plain(color)
        }
    }

    /// Colour at `p`, a point of the checkerboard's space; `key` selects the tones of the squares.
    fn color(&self, p: DVec3, key: [u64; 2]) -> DVec3 {
        if !self.side.is_finite() {
            return self.colors[0];
        }
        let cell = (p / self.side).floor();
        let odd = (cell.x + cell.y + cell.z).rem_euclid(2.0) > 0.5;
        let [x, y, z] = cell.to_array().map(|c| c as i64 as u64);
        let tone = random(&[key[0], key[1], x, y, z]);
        self.colors[usize::from(odd)] * (0.5 + 0.5 * tone)
    }
}

/// A shape in the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Solid {
    /// Shape about the centre.
    pub shape: Shape,
    /// Centre, scene units.
    pub center: DVec3,
    /// Material of the whole surface.
    pub material: Material,
}

impl Solid {
    /// Distance along the ray `o + t·d` (|d| = 1) at which it enters the solid, if 0 < t < `limit`; `None` too for rays that
    /// start inside.
    fn enter(&self, o: DVec3, d: DVec3, limit: f64) -> Option<f64> {
        let o = o - self.center;
        let t = match self.shape {
            Shape::Sphere(r) => {
                let middle = -o.dot(d);
                let root = middle * middle - (o.dot(o) - r * r);
                middle - (root >= 0.0).then(|| root.sqrt())?
            }
            Shape::Block(half) => {
                let inverse = d.recip();
                let (middle, reach) = (-o * inverse, half * inverse.abs());
                let (near, far) = (middle - reach, middle + reach);
                let t = near.max_element();
                (t < far.min_element()).then_some(t)?
            }
        };
        (t > 0.0 && t < limit).then_some(t)
    }

    /// Outward unit normal at a point of the surface, given relative to the centre.
    fn normal(&self, p: DVec3) -> DVec3 {
        match self.shape {
            Shape::Sphere(r) => p / r,
            Shape::Block(half) => {
                let q = (p / half).abs();
                let face = if q.x >= q.y && q.x >= q.z {
                    DVec3::X
                } else if q.y >= q.z {
                    DVec3::Y
                } else {
                    DVec3::Z
                };
                face * p.signum()
            }
        }
    }
}

/// A point on a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface {
    /// Position, scene units.
    pub point: DVec3,
    /// Outward unit normal.
    pub normal: DVec3,
    /// Linear RGB of the material there.
    pub color: DVec3,
    /// Reflection of the material.
    pub finish: Finish,
}

/// Solids, the light on them and the cameras that look at them. Rays that hit none leave the scene.
#[derive(Debug)]
pub(super) struct Scene {
    /// Solids, in any order.
    pub solids: Vec<Solid>,
    /// Position of the lamp, a point.
    pub lamp: DVec3,
    /// Radiant intensity of the lamp: irradiance at distance 1, linear RGB.
    pub intensity: DVec3,
    /// Ambient irradiance from above and from below, linear RGB.
    pub ambient: [DVec3; 2],
    /// Seed of the checkerboards' tones.
    pub seed: u64,
    /// Position and target of camera `index` of `views`.
    pub camera: fn(index: u32, views: u32) -> (DVec3, DVec3),
    /// Tangent of half the horizontal field of view.
    pub tan: f64,
    /// True if rays may leave the scene, so that photos have transparent pixels.
    pub transparent: bool,
}

/// Distance between a surface and the start of the rays that leave it.
const LIFT: f64 = 2e-4;

impl Scene {
    /// The first surface on the ray `o + t·d`, |d| = 1; `None` if it leaves the scene.
    pub fn hit(&self, o: DVec3, d: DVec3) -> Option<Surface> {
        let mut first = None;
        let mut limit = f64::INFINITY;
        for (at, solid) in self.solids.iter().enumerate() {
            if let Some(t) = solid.enter(o, d, limit) {
                limit = t;
                first = Some((at, solid));
            }
        }
        let (at, solid) = first?;
        let point = o + limit * d;
        let local = point - solid.center;
        let normal = solid.normal(local);
        // On a face the coordinate along the normal is constant, and rounding must not decide about its square.
        let across = match solid.shape {
            Shape::Sphere(_) => local,
            Shape::Block(_) => local * (DVec3::ONE - normal.abs()),
        };
        Some(Surface {
            point,
            normal,
            color: solid.material.color(across, [self.seed, at as u64]),
            finish: solid.material.finish,
        })
    }

    /// Radiance towards the ray's origin, linear RGB; `None` if the ray leaves the scene.
    pub fn radiance(&self, o: DVec3, d: DVec3) -> Option<DVec3> {
        let s = self.hit(o, d)?;
        if s.finish != Finish::Metal {
            return Some(self.diffuse(&s));
        }
        let mirrored = d - 2.0 * d.dot(s.normal) * s.normal;
        let behind = self.hit(s.point + LIFT * s.normal, mirrored);
        Some(s.color * behind.map_or_else(|| sky(mirrored), |b| self.diffuse(&b)))
    }

    /// Scattered or emitted light of a surface: ambient, and direct with a hard shadow.
    pub fn diffuse(&self, s: &Surface) -> DVec3 {
        if s.finish == Finish::Lamp {
            return s.color;
        }
        let up = 0.5 + 0.5 * s.normal.z;
        let ambient = self.ambient[1].lerp(self.ambient[0], up);
        let from = s.point + LIFT * s.normal;
        let way = self.lamp - from;
        let length = way.length().max(1e-3);
        let cosine = way.dot(s.normal) / length;
        let blocks = |solid: &Solid| {
            solid.material.finish != Finish::Lamp
                && solid.enter(from, way / length, length).is_some()
        };
        if cosine <= 0.0 || self.solids.iter().any(blocks) {
            return s.color * ambient;
        }
        s.color * (ambient + self.intensity * (cosine / (length * length)))
    }
}

/// Surroundings of the scene in a mirror: a floor, a sky that is brighter on one side, and a window.
fn sky(d: DVec3) -> DVec3 {
    if d.z < 0.0 {
        return dvec3(0.30, 0.24, 0.19) * (1.0 + 0.8 * d.z);
    }
    if d.dot(dvec3(0.64, -0.48, 0.60)) > 0.9 {
        return dvec3(2.4, 2.2, 1.9);
    }
    dvec3(0.06, 0.08, 0.13).lerp(dvec3(0.55, 0.65, 0.80), 0.5 - 0.5 * d.y)
}
