//! Light on surfaces: soft ambient light, lamps with soft shadows, highlights and mirrors.

use glam::{DMat3, DVec3};

use crate::lab::synth::hash::power;
use crate::lab::synth::shape::{Shape, Solid};
use crate::lab::synth::texture::Texture;
use crate::lab::synth::tree::Tree;

/// How a surface answers light.
#[derive(Debug, Clone, Copy)]
pub(super) struct Material {
    /// Diffuse albedo, or the tint of a metal.
    pub texture: Texture,
    /// Varies the texture's noise.
    pub seed: u64,
    /// Finish.
    pub finish: Finish,
}

/// What a surface does beyond scattering light evenly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Finish {
    /// Lambertian: looks the same from everywhere.
    Matt,
    /// A lamp: the texture times this is what leaves it. Casts no shadow, being where the light comes from.
    Glowing(f64),
    /// Highlights of the lamps on top of the diffuse colour; the exponent is 2 to this power.
    Satin(u32),
    /// Clear coat: highlights as for `Satin`, and a mirror image that grows towards the rim (Schlick 1994).
    Glossy(u32),
    /// A mirror tinted by the texture.
    Metal,
}

/// A lamp: a box-shaped cloud of light.
#[derive(Debug, Clone, Copy)]
pub(super) struct Light {
    /// Middle.
    pub center: DVec3,
    /// Half lengths.
    pub half: DVec3,
    /// Radiant intensity: irradiance at distance 1, linear RGB.
    pub intensity: DVec3,
}

/// Solids, lamps and what surrounds them.
#[derive(Debug)]
pub(super) struct Scene {
    /// The solids.
    pub tree: Tree,
    /// Materials that the solids index.
    pub materials: Vec<Material>,
    /// Lamps.
    pub lights: Vec<Light>,
    /// Ambient irradiance from above and from below, linear RGB.
    pub ambient: [DVec3; 2],
    /// How far ambient light is blocked by other surfaces.
    pub reach: f64,
    /// What rays that leave the scene see in mirrors: a studio (true) or nothing.
    pub studio: bool,
}

/// Collects solids and their materials.
#[derive(Debug, Default)]
pub(super) struct Builder {
    /// Solids so far.
    pub solids: Vec<Solid>,
    /// Materials so far.
    pub materials: Vec<Material>,
    /// Seed of the scene, from which every material draws its own.
    pub seed: u64,
}

impl Builder {
    /// Adds a matt material and returns its index.
    pub fn matt(&mut self, texture: Texture) -> usize {
        self.material(texture, Finish::Matt)
    }

    /// Adds a material and returns its index.
    pub fn material(&mut self, texture: Texture, finish: Finish) -> usize {
        let index = self.materials.len();
        self.materials.push(Material {
            texture,
            seed: self.seed.wrapping_mul(1000).wrapping_add(16 * index as u64),
            finish,
        });
        index
    }

    /// Adds an upright solid.
    pub fn add(&mut self, material: usize, shape: Shape, center: DVec3) {
        self.turned(material, shape, center, DMat3::IDENTITY);
    }

    /// Adds a solid turned by `rotation`.
    pub fn turned(&mut self, material: usize, shape: Shape, center: DVec3, rotation: DMat3) {
        self.solids.push(Solid {
            shape,
            rotation,
            center,
            material,
        });
    }
}

/// A point on a surface.
pub(super) struct Surface<'a> {
    /// Where.
    pub point: DVec3,
    /// Outward unit normal.
    pub normal: DVec3,
    /// Diffuse albedo.
    pub albedo: DVec3,
    /// Its material.
    pub material: &'a Material,
}

/// What the rays of one pixel have in common.
#[derive(Debug, Default)]
pub(super) struct Ray {
    /// Number of the ray within its pixel: selects the points of the lamps that cast the shadows.
    pub number: u64,
    /// Mirrors on the way so far.
    bounces: u32,
    /// Point, normal and openness of the last place that was asked for it.
    seen: Option<(DVec3, DVec3, f64)>,
}

/// How close, in units of [`Scene::reach`], two points of one pixel share their openness. It is the dearest term and the smoothest.
const SAME_PLACE: f64 = 0.03;
/// How far rays start above the surface they leave.
const LIFT: f64 = 2e-4;
/// Shadow rays towards each lamp for each call of [`Scene::diffuse`].
const SHADOW_RAYS: u64 = 1;

impl Scene {
    /// The first surface on the ray `o + t·d`, |d| = 1.
    pub fn hit(&self, o: DVec3, d: DVec3) -> Option<Surface<'_>> {
        let (solid, entry) = self.tree.nearest(o, d, f64::INFINITY)?;
        let material = self.materials.get(solid.material)?;
        let point = o + entry.t * d;
        let local = solid.local(point);
        Some(Surface {
            point,
            normal: solid.rotation * entry.normal,
            albedo: material.texture.albedo(local, entry.normal, material.seed),
            material,
        })
    }

    /// Radiance towards the ray's origin, linear RGB, or `None` where the ray leaves the scene.
    pub fn radiance(&self, o: DVec3, d: DVec3, ray: &mut Ray) -> Option<DVec3> {
        let s = self.hit(o, d)?;
        let facing = (-d.dot(s.normal)).clamp(0.0, 1.0);
        Some(match s.material.finish {
            Finish::Glowing(power) => s.albedo * power * (0.55 + 0.45 * facing),
            Finish::Matt => self.diffuse(&s, ray),
            Finish::Satin(sharp) => self.diffuse(&s, ray) + self.highlight(&s, d, sharp),
            Finish::Glossy(sharp) => {
                let share = 0.05 + 0.95 * power(1.0 - facing, 2) * (1.0 - facing);
                let image = self.mirror(&s, d, ray);
                self.diffuse(&s, ray) * (1.0 - share) + image * share + self.highlight(&s, d, sharp)
            }
            Finish::Metal => self.mirror(&s, d, ray) * s.albedo,
        })
    }

    /// Light that the surface scatters evenly: ambient and direct.
    pub fn diffuse(&self, s: &Surface<'_>, ray: &mut Ray) -> DVec3 {
        let up = 0.5 + 0.5 * s.normal.z;
        let ambient = self.ambient[1].lerp(self.ambient[0], up) * self.openness_near(s, ray);
        let direct: DVec3 = self
            .lights
            .iter()
            .map(|light| {
                let seen = (0..SHADOW_RAYS)
                    .map(|k| self.arriving(light, s, SHADOW_RAYS * ray.number + k))
                    .sum::<f64>();
                light.intensity * (seen / SHADOW_RAYS as f64)
            })
            .sum();
        s.albedo * (ambient + direct)
    }

    /// [`Scene::openness`] of the surface, or of a place next to it that a ray of the same pixel came by.
    fn openness_near(&self, s: &Surface<'_>, ray: &mut Ray) -> f64 {
        if let Some((point, normal, value)) = ray.seen {
            let close = SAME_PLACE * self.reach;
            if (point - s.point).length_squared() < close * close && normal.dot(s.normal) > 0.995 {
                return value;
            }
        }
        let value = self.openness(s.point, s.normal);
        ray.seen = Some((s.point, s.normal, value));
        value
    }

    /// Irradiance from one point of a lamp of unit intensity.
    fn arriving(&self, light: &Light, s: &Surface<'_>, index: u64) -> f64 {
        let from = s.point + LIFT * s.normal;
        let way = light.center + light.half * spread(index) - from;
        let length = way.length().max(1e-3);
        let cosine = way.dot(s.normal) / length;
        if cosine <= 0.0 || self.shadowed(from, way / length, length) {
            return 0.0;
        }
        cosine / (length * length)
    }

    fn shadowed(&self, from: DVec3, d: DVec3, length: f64) -> bool {
        self.tree.blocked(from, d, length, |solid| {
            let material = self.materials.get(solid.material);
            !material.is_some_and(|m| matches!(m.finish, Finish::Glowing(_)))
        })
    }

    /// Share of the ambient light that gets to a point: how much nearer than free space the surroundings are at four steps
    /// along the normal (Evans 2006). Smooth and the same from every camera, unlike sampling the hemisphere.
    fn openness(&self, p: DVec3, n: DVec3) -> f64 {
        let mut blocked = 0.0;
        for (k, weight) in [(1.0, 0.19), (0.55, 0.26), (0.25, 0.36), (0.08, 0.5)] {
            let h = k * self.reach;
            let gap = h - self.tree.distance(p + h * n, h);
            if gap < 1e-6 * h {
                // The smaller balls that touch the surface here lie within this one: they are empty too.
                break;
            }
            blocked += weight * gap / h;
        }
        (1.0 - 0.62 * blocked).clamp(0.0, 1.0)
    }

    /// Highlights of the lamps (Blinn 1977), with the lamp's middle deciding about shadow.
    fn highlight(&self, s: &Surface<'_>, d: DVec3, sharp: u32) -> DVec3 {
        let from = s.point + LIFT * s.normal;
        self.lights
            .iter()
            .map(|light| {
                let way = light.center - from;
                let length = way.length().max(1e-3);
                let to = way / length;
                let half = (to - d).normalize_or_zero();
                let cosine = half.dot(s.normal);
                let exponent = f64::from(1u32 << sharp.min(16));
                let lobe = 0.04 * (exponent + 8.0) / 8.0 * power(cosine.max(0.0), sharp);
                // Below a thousandth no display value changes, and most surfaces are spared a ray.
                if to.dot(s.normal) <= 0.0 || lobe < 1e-3 || self.shadowed(from, to, length) {
                    return DVec3::ZERO;
                }
                light.intensity * (lobe / (length * length))
            })
            .sum()
    }

    /// What the surface mirrors; nothing beyond two reflections.
    fn mirror(&self, s: &Surface<'_>, d: DVec3, ray: &mut Ray) -> DVec3 {
        let bounced = d - 2.0 * d.dot(s.normal) * s.normal;
        let seen = if ray.bounces < 2 {
            ray.bounces += 1;
            let seen = self.radiance(s.point + LIFT * s.normal, bounced, ray);
            ray.bounces -= 1;
            seen
        } else {
            None
        };
        seen.unwrap_or_else(|| {
            if self.studio {
                studio(bounced)
            } else {
                DVec3::ZERO
            }
        })
    }
}

/// Point number `index` of a sequence that fills the cube [−1, 1]³ evenly (Roberts 2018, R₃).
fn spread(index: u64) -> DVec3 {
    let n = (index % 4096) as f64 + 0.5;
    let step = DVec3::new(
        0.819_172_513_396_164_4,
        0.671_043_606_703_789_3,
        0.549_700_477_901_970_3,
    );
    let x = step * n;
    2.0 * (x - x.floor()) - DVec3::ONE
}

/// A photographer's studio, for mirrors: floor, backdrop, two soft boxes and a window.
fn studio(d: DVec3) -> DVec3 {
    use crate::lab::synth::hash::smooth;
    let wall =
        DVec3::new(0.10, 0.12, 0.17).lerp(DVec3::new(0.42, 0.52, 0.70), smooth(-0.05, 0.9, d.z));
    let floor = DVec3::new(0.30, 0.24, 0.19) * (1.0 + 0.8 * d.z);
    let mut c = floor.lerp(wall, smooth(-0.02, 0.02, d.z));
    // Panels: direction of the middle, sideways and upward half sizes, colour.
    let panels = [
        (
            DVec3::new(0.66, -0.48, 0.58),
            0.34,
            0.26,
            DVec3::new(3.4, 3.2, 2.9),
        ),
        (
            DVec3::new(-0.82, -0.30, 0.49),
            0.16,
            0.42,
            DVec3::new(1.3, 1.7, 2.3),
        ),
        (
            DVec3::new(-0.05, 0.92, 0.39),
            0.40,
            0.22,
            DVec3::new(2.2, 1.5, 0.8),
        ),
    ];
    for (middle, wide, high, color) in panels {
        let axis = middle.normalize_or_zero();
        let side = DVec3::Z.cross(axis).normalize_or_zero();
        let depth = d.dot(axis);
        if depth > 0.0 {
            let (u, v) = (d.dot(side) / depth, d.dot(axis.cross(side)) / depth);
            let inside = smooth(wide, wide - 0.03, u.abs()) * smooth(high, high - 0.03, v.abs());
            c = c.lerp(color, inside);
        }
    }
    c
}
