//! Closed solids: where a ray enters them, and how far a point is from them.

use glam::{DMat3, DVec3};

/// A solid about the origin of its own frame, with z as its axis. Lengths in scene units.
#[derive(Debug, Clone, Copy)]
pub(super) enum Shape {
    /// Ellipsoid with these radii.
    Ellipsoid(DVec3),
    /// Box with these half lengths.
    Block(DVec3),
    /// Box with these half lengths, rounding included.
    Rounded(DVec3, f64),
    /// Cylinder along z: radius, half height.
    Cylinder(f64, f64),
    /// Rod along z with round ends: radius, half length without the ends.
    Rod(f64, f64),
    /// Ring about z: radius of the centre line, radius of the tube.
    Torus(f64, f64),
}

/// Where a ray meets a solid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Entry {
    /// Distance along the ray, in lengths of its direction.
    pub t: f64,
    /// Outward unit normal in the solid's frame.
    pub normal: DVec3,
}

/// Distance at which a marched ray counts as arrived.
const ARRIVED: f64 = 1e-6;
/// Steps of a marched ray before it counts as a miss. Only rays that graze a curved rim come near.
const STEPS: u32 = 160;

impl Shape {
    /// Half lengths of the box around the solid, in its frame.
    pub fn half(&self) -> DVec3 {
        match *self {
            Self::Ellipsoid(r) => r,
            Self::Block(h) | Self::Rounded(h, _) => h,
            Self::Cylinder(r, h) => DVec3::new(r, r, h),
            Self::Rod(r, h) => DVec3::new(r, r, h + r),
            Self::Torus(a, b) => DVec3::new(a + b, a + b, b),
        }
    }

    /// Signed distance of `p`, negative inside. For ellipsoids a first-order estimate, exact on spheres and on the surface.
    pub fn distance(&self, p: DVec3) -> f64 {
        match *self {
            Self::Ellipsoid(r) => {
                if r.x == r.y && r.y == r.z {
                    return p.length() - r.x;
                }
                let (k0, k1) = ((p / r).length(), (p / (r * r)).length());
                k0 * (k0 - 1.0) / k1.max(1e-12)
            }
            Self::Block(h) => block_distance(p, h),
            Self::Rounded(h, r) => block_distance(p, h - DVec3::splat(r)) - r,
            Self::Cylinder(r, h) => {
                let (a, b) = (radial(p) - r, p.z.abs() - h);
                a.max(b).min(0.0) + hypot(a.max(0.0), b.max(0.0))
            }
            Self::Rod(r, h) => hypot(radial(p), (p.z.abs() - h).max(0.0)) - r,
            Self::Torus(a, b) => hypot(radial(p) - a, p.z) - b,
        }
    }

    /// Where the ray `o + t·d` (|d| = 1) enters the solid with `0 < t < limit`; `None` too for rays that start inside.
    pub fn enter(&self, o: DVec3, d: DVec3, limit: f64) -> Option<Entry> {
        match *self {
            Self::Ellipsoid(r) => {
                let (a, b) = (o / r, d / r);
                let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
                let root = ab * ab - bb * (aa - 1.0);
                let t = (-ab - root.max(0.0).sqrt()) / bb;
                (root >= 0.0 && t > 0.0 && t < limit).then(|| Entry {
                    t,
                    normal: ((a + t * b) / r).normalize_or_zero(),
                })
            }
            Self::Block(h) => {
                let (near, far, axis) = slabs(o, d, h);
                (near < far && near > 0.0 && near < limit).then(|| Entry {
                    t: near,
                    normal: axis * -d.signum(),
                })
            }
            _ => self.march(o, d, limit),
        }
    }

    /// Sphere tracing (Hart 1996) between the faces of the surrounding box.
    fn march(&self, o: DVec3, d: DVec3, limit: f64) -> Option<Entry> {
        let (near, far, _) = slabs(o, d, self.half());
        let end = far.min(limit);
        let mut t = near.max(0.0);
        if t >= end || (near <= 0.0 && self.distance(o) <= 0.0) {
            return None;
        }
        for _ in 0..STEPS {
            let p = o + t * d;
            let gap = self.distance(p);
            if gap < ARRIVED {
                return Some(Entry {
                    t,
                    normal: self.normal(p),
                });
            }
            t += gap;
            if t >= end {
                return None;
            }
        }
        None
    }

    /// Outward unit normal at a point of the surface of a marched solid.
    fn normal(&self, p: DVec3) -> DVec3 {
        let n = match *self {
            Self::Rounded(h, r) => {
                let q = p.abs() - (h - DVec3::splat(r));
                q.max(DVec3::ZERO) * p.signum()
            }
            Self::Cylinder(r, h) => {
                if p.z.abs() - h > radial(p) - r {
                    DVec3::Z * p.z.signum()
                } else {
                    DVec3::new(p.x, p.y, 0.0)
                }
            }
            Self::Rod(_, h) => DVec3::new(p.x, p.y, p.z - p.z.clamp(-h, h)),
            Self::Torus(a, _) => {
                let scale = 1.0 - a / radial(p).max(1e-12);
                DVec3::new(p.x * scale, p.y * scale, p.z)
            }
            Self::Ellipsoid(_) | Self::Block(_) => p,
        };
        n.normalize_or_zero()
    }
}

/// Entry and exit of a ray through a box about the origin, and the unit vector of the axis it enters along.
fn slabs(o: DVec3, d: DVec3, half: DVec3) -> (f64, f64, DVec3) {
    let inverse = d.recip();
    let middle = -o * inverse;
    let reach = half * inverse.abs();
    let (low, high) = (middle - reach, middle + reach);
    let near = low.max_element();
    let axis = if low.x >= low.y && low.x >= low.z {
        DVec3::X
    } else if low.y >= low.z {
        DVec3::Y
    } else {
        DVec3::Z
    };
    (near, high.min_element(), axis)
}

fn block_distance(p: DVec3, half: DVec3) -> f64 {
    let q = p.abs() - half;
    q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
}

fn radial(p: DVec3) -> f64 {
    hypot(p.x, p.y)
}

/// √(a² + b²) by plain operations: `f64::hypot` is libm's.
fn hypot(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}

/// A [`Shape`] somewhere in the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Solid {
    /// The solid in its own frame.
    pub shape: Shape,
    /// Rotation from its frame to the scene's.
    pub rotation: DMat3,
    /// Where its origin lies in the scene.
    pub center: DVec3,
    /// Index into the scene's materials.
    pub material: usize,
}

impl Solid {
    /// A point of the scene in the solid's frame.
    pub fn local(&self, p: DVec3) -> DVec3 {
        self.turn(p - self.center)
    }

    /// A direction of the scene in the solid's frame.
    fn turn(&self, d: DVec3) -> DVec3 {
        // The transpose is the inverse of a rotation.
        let r = &self.rotation;
        DVec3::new(r.x_axis.dot(d), r.y_axis.dot(d), r.z_axis.dot(d))
    }

    /// [`Shape::enter`] for a ray of the scene; the normal comes back in the solid's frame.
    pub fn enter(&self, o: DVec3, d: DVec3, limit: f64) -> Option<Entry> {
        self.shape.enter(self.local(o), self.turn(d), limit)
    }

    /// Corners of the axis-aligned box around the solid in the scene.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let h = self.shape.half();
        let r = &self.rotation;
        let reach = r.x_axis.abs() * h.x + r.y_axis.abs() * h.y + r.z_axis.abs() * h.z;
        (self.center - reach, self.center + reach)
    }
}
