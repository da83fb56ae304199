//! Families of stiff scenes: seeded, exact in f32, each along a measure of stiffness.

use glam::{DMat3, DQuat, DVec3};

use crate::base::constants::NEAR;
use crate::base::rng::{Philox, Stream};
use crate::capture::Camera;
use crate::lab::verify::cases::{Case, mild};
use crate::lab::verify::check::FamilyNote;
use crate::scene::{Gaussians, Plane};

/// f32 rounding through the longest stage, where no term cancels another.
const WELL: f64 = 1e-5;
/// f32 rounding with the small differences that positions and scales of several sizes beside each other leave.
const MIXED: f64 = 1e-4;
/// f32 rounding of differences of larger terms that cancel.
const CANCELLED: f64 = 1e-3;

/// Cases along one measure of stiffness.
#[derive(Debug, Clone, Copy)]
pub struct Family {
    /// Name.
    pub name: &'static str,
    /// Measure of the stiffness.
    pub axis: &'static str,
    /// Bound on the f32 errors.
    pub bound: f64,
    /// Reason for that bound.
    pub reason: &'static str,
    /// Stiffness of each case in the unit of the axis, > 0.
    pub stiffness: &'static [f64],
    /// Case of an index and its stiffness.
    pub case: fn(usize, f64) -> Case,
}

impl Family {
    /// Its line in a report.
    #[must_use]
    pub const fn note(&self) -> FamilyNote {
        FamilyNote {
            name: self.name,
            axis: self.axis,
            bound: self.bound,
            reason: self.reason,
        }
    }
}

/// Ratios of the axes of needles and discs.
const RATIOS: &[f64] = &[1e1, 1e2, 1e3, 1e4, 1e5, 1e6];

/// Every family of scenes.
pub const FAMILIES: [Family; 16] = [
    Family {
        name: "needles",
        axis: "long over short axis",
        bound: MIXED,
        reason: "axis ratios beyond 1e3 leave the short axis below the blur; what is left is the rounding of the long one",
        stiffness: RATIOS,
        case: needles,
    },
    Family {
        name: "pancakes",
        axis: "wide over thin axis",
        bound: MIXED,
        reason: "as needles: the image of a disc that is seen from its edge is one",
        stiffness: RATIOS,
        case: pancakes,
    },
    Family {
        name: "end-on",
        axis: "long over short axis",
        bound: MIXED,
        reason: "the long axis cancels in the image; what is left of it is rounding of its length",
        stiffness: RATIOS,
        case: end_on,
    },
    Family {
        name: "scale variance",
        axis: "largest over smallest scale",
        bound: MIXED,
        reason: "every Gaussian for itself is well-conditioned",
        stiffness: &[1e1, 1e3, 1e5, 1e7],
        case: scale_variance,
    },
    Family {
        name: "depth",
        axis: "distance, local units",
        bound: MIXED,
        reason: "as well-conditioned as at 1, with the regulariser of the scales beside gradients of another size",
        stiffness: &[1e-3, 1e-2, 1e-1, 1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6],
        case: depth,
    },
    Family {
        name: "near plane",
        axis: "1 over the distance to it",
        bound: MIXED,
        reason: "at the plane itself a Gaussian is culled; the others are well-conditioned",
        stiffness: &[16.0, 256.0, 4096.0, 65536.0, 1048576.0],
        case: near_plane,
    },
    Family {
        name: "inside",
        axis: "scale, distances 0.25 to 0.75",
        bound: WELL,
        reason: "an image that changes little over the picture: differences of near equals in the gradients",
        stiffness: &[1e-1, 1e0, 1e1, 1e2, 1e3],
        case: inside,
    },
    Family {
        name: "aside",
        axis: "tangent of the angle to the sight",
        bound: MIXED,
        reason: "beyond 1.3 times the field of view the slope is held; positions reach far beyond the picture",
        stiffness: &[1e0, 1e1, 1e2, 1e3, 1e4],
        case: aside,
    },
    Family {
        name: "opacity",
        axis: "size of the logit",
        bound: WELL,
        reason: "saturates: alpha is held at 0.99 in every precision",
        stiffness: &[1.0, 5.0, 20.0, 50.0, 100.0],
        case: opacity,
    },
    Family {
        name: "alpha cut",
        axis: "ulp off the cut",
        bound: WELL,
        reason: "whether such a Gaussian is there at all is decided in the last digit: it may be in one and not in the other",
        stiffness: &[1.0, 16.0, 256.0],
        case: cut,
    },
    Family {
        name: "layers",
        axis: "layers",
        bound: MIXED,
        reason: "a product of that many factors, each with its rounding, until nothing is left behind it",
        stiffness: &[10.0, 100.0, 1000.0, 10_000.0],
        case: layers,
    },
    Family {
        name: "quaternion norm",
        axis: "norm",
        bound: MIXED,
        reason: "the norm is factored out before anything is squared",
        stiffness: &[1e-20, 1e-15, 1e-10, 1e-5, 1e0, 1e5, 1e10, 1e15, 1e20],
        case: norms,
    },
    Family {
        name: "sizes",
        axis: "pixels",
        bound: MIXED,
        reason: "nothing depends on whole tiles",
        stiffness: &[240.0, 1.0, 1.0, 17.0, 33.0, 465.0, 765.0],
        case: sizes,
    },
    Family {
        name: "crowds and ties",
        axis: "Gaussians",
        bound: CANCELLED,
        reason: "equal depths: ties go by index, in every precision",
        stiffness: &[1.0, 3.0, 3000.0],
        case: crowds,
    },
    Family {
        name: "constant images",
        axis: "case",
        bound: MIXED,
        reason: "without variance SSIM is that of the means, and its gradient is finite",
        stiffness: &[1.0, 2.0, 3.0, 4.0, 5.0],
        case: lights,
    },
    Family {
        name: "broken values",
        axis: "case",
        bound: MIXED,
        reason: "a Gaussian that is not a number is not there",
        stiffness: &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0],
        case: broken,
    },
];

/// Four uniform numbers of Gaussian `i`.
fn uniform(seed: u64, i: usize) -> [f64; 4] {
    Philox::uniform(seed, Stream::Synthetic.stream(1), i as u64)
}

/// A mild scene of which every Gaussian is changed.
pub(super) fn each(
    name: impl AsRef<str>,
    n: usize,
    size: [u32; 2],
    seed: u64,
    change: impl Fn(&mut Gaussians, usize),
) -> Case {
    let mut case = mild(name.as_ref(), n, size, 1, seed);
    for i in 0..n {
        change(&mut case.splats, i);
    }
    case
}

/// Position of Gaussian `i`.
fn position(s: &Gaussians, i: usize) -> DVec3 {
    DVec3::from_array(s.gather::<3>(Plane::POSITION, i).map(f64::from))
}

/// 60 Gaussians with axes that are shorter by the ratio to these powers. `turn` gives an axis of a Gaussian and where it is to
/// point, from the direction in which the camera sees the Gaussian.
fn thin(
    name: String,
    seed: u64,
    ratio: f64,
    powers: [f32; 3],
    turn: impl Fn(DVec3) -> Option<[DVec3; 2]>,
) -> Case {
    let camera = mild("", 0, [64, 48], 1, seed).camera;
    each(name, 60, [64, 48], seed, |s, i| {
        let long = -1.0 - uniform(seed, i)[0] as f32;
        let scales = powers.map(|power| long - power * ratio.ln() as f32);
        s.scatter(Plane::LOG_SCALE, i, scales);
        let sight = (position(s, i) - camera.center()).normalize_or(DVec3::Z);
        if let Some([axis, to]) = turn(sight) {
            let q = DQuat::from_rotation_arc(axis, to);
            s.scatter(Plane::ROTATION, i, [q.w, q.x, q.y, q.z].map(|v| v as f32));
        }
    })
}

fn needles(_: usize, ratio: f64) -> Case {
    let name = format!("needles {ratio:.0e}:1");
    thin(name, 61, ratio, [0.0, 1.0, 1.0], |_| None)
}

/// The thin axis, z, lies across the line of sight.
fn pancakes(_: usize, ratio: f64) -> Case {
    let name = format!("pancakes 1:{ratio:.0e}, edge-on");
    let across = |sight: DVec3| Some([DVec3::Z, sight.any_orthonormal_vector()]);
    thin(name, 62, ratio, [0.0, 0.0, 1.0], across)
}

fn end_on(_: usize, ratio: f64) -> Case {
    let name = format!("needles {ratio:.0e}:1 along the sight");
    let along = |sight: DVec3| Some([DVec3::X, sight]);
    thin(name, 63, ratio, [0.0, 1.0, 1.0], along)
}

fn scale_variance(_: usize, variance: f64) -> Case {
    let name = format!("scales over {variance:.0e}");
    each(name, 200, [64, 48], 64, |s, i| {
        let [u, a, b, c] = uniform(64, i);
        let scale = -(u * variance.ln());
        let part = [a, b, c].map(|v| (scale + v - 0.5) as f32);
        s.scatter(Plane::LOG_SCALE, i, part);
    })
}

fn norms(_: usize, norm: f64) -> Case {
    let name = format!("quaternions of norm {norm:.0e}");
    each(name, 60, [40, 32], 72, |s, i| {
        let q: [f32; 4] = s.gather(Plane::ROTATION, i);
        s.scatter(Plane::ROTATION, i, q.map(|v| (f64::from(v) * norm) as f32));
    })
}

fn depth(_: usize, by: f64) -> Case {
    let name = format!("scene and distance times {by:.0e}");
    let mut case = each(name, 100, [64, 48], 65, |s, i| {
        let x = position(s, i) * by;
        s.scatter(Plane::POSITION, i, x.as_vec3().to_array());
        let scales: [f32; 3] = s.gather(Plane::LOG_SCALE, i);
        let larger = scales.map(|l| (f64::from(l) + by.ln()) as f32);
        s.scatter(Plane::LOG_SCALE, i, larger);
    });
    case.camera.translation *= by;
    // The regulariser of the scales grows with them, and would be all that there is in their gradient.
    case.lambdas[2] = 0.0;
    case
}

/// A case whose camera looks along z from the origin, so that depths are exact.
fn straight(case: Case) -> Case {
    let camera = Camera {
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        ..case.camera
    };
    Case { camera, ..case }
}

fn near_plane(_: usize, stiffness: f64) -> Case {
    let name = format!("near plane ± 2^-{} of it", stiffness.log2());
    straight(each(name, 40, [64, 48], 66, |s, i| {
        let [u, v, ..] = uniform(66, i);
        let side = [-1.0, 0.0, 1.0, 2.0][i % 4];
        let z = f64::from(NEAR as f32) * (1.0 + side / stiffness);
        let at = [0.3 * (u - 0.5) * z, 0.3 * (v - 0.5) * z, z];
        s.scatter(Plane::POSITION, i, at.map(|v| v as f32));
        s.scatter(Plane::LOG_SCALE, i, [(0.05 * NEAR).ln() as f32; 3]);
    }))
}

fn inside(_: usize, size: f64) -> Case {
    let name = format!("camera within Gaussians of {size:.0e}");
    straight(each(name, 10, [64, 48], 67, |s, i| {
        let [u, v, w, o] = uniform(67, i);
        let at = [u - 0.5, v - 0.5, 0.5 + w].map(|v| (0.5 * v) as f32);
        s.scatter(Plane::POSITION, i, at);
        s.scatter(Plane::LOG_SCALE, i, [size.ln() as f32; 3]);
        s.scatter(Plane::OPACITY, i, [(2.0 * o - 2.0) as f32]);
    }))
}

/// Half of the Gaussians are beside the view, large enough to reach in; half in it.
fn aside(_: usize, tangent: f64) -> Case {
    let name = format!("{tangent:.0e} beside the sight");
    straight(each(name, 40, [64, 48], 68, |s, i| {
        let [u, v, w, _] = uniform(68, i);
        let z = 0.5 + w;
        let (x, scale) = if i % 2 == 0 {
            (tangent * z, (0.5 * (tangent * z)).ln())
        } else {
            (0.4 * (u - 0.5), -3.0)
        };
        let at = [x, 0.4 * (v - 0.5), z].map(|v| v as f32);
        s.scatter(Plane::POSITION, i, at);
        s.scatter(Plane::LOG_SCALE, i, [scale as f32; 3]);
    }))
}

fn opacity(_: usize, logit: f64) -> Case {
    let name = format!("opacity logits ± {logit:.0}");
    each(name, 60, [40, 32], 69, |s, i| {
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        s.scatter(Plane::OPACITY, i, [(sign * logit) as f32]);
    })
}

fn cut(_: usize, ulps: f64) -> Case {
    let name = format!("opacity 1/255 ± {ulps} ulp");
    let exact = (1.0f64 / 254.0).ln() as f32;
    each(name, 60, [40, 32], 70, |s, i| {
        let step = if i % 2 == 0 { ulps } else { -ulps };
        let bits = exact.to_bits().wrapping_add_signed(step as i32);
        s.scatter(Plane::OPACITY, i, [f32::from_bits(bits)]);
    })
}

fn layers(_: usize, n: f64) -> Case {
    let name = format!("{n} layers on one pixel");
    each(name, n as usize, [4, 4], 71, |s, i| {
        s.scatter(Plane::POSITION, i, [0.0, 0.0, 1e-4 * i as f32]);
        s.scatter(Plane::OPACITY, i, [-4.0]);
    })
}

fn sizes(index: usize, _: f64) -> Case {
    const SIZES: [(usize, [u32; 2]); 7] = [
        (0, [20, 12]),
        (1, [1, 1]),
        (30, [1, 1]),
        (30, [17, 1]),
        (30, [1, 33]),
        (30, [15, 31]),
        (60, [255, 3]),
    ];
    let (n, [w, h]) = SIZES[index];
    let mut case = mild(&format!("{n} Gaussians, {w}x{h}"), n, [w, h], 1, 73);
    if n == 0 {
        case.edits.clear();
    }
    case
}

/// One Gaussian over every tile, or a crowd of equal ones in one.
fn crowds(_: usize, n: f64) -> Case {
    let (name, size, seed, log_scale, logit) = if n == 1.0 {
        let name = "one Gaussian over every tile".into();
        (name, [250, 130], 74, 3.0, 3.0)
    } else {
        let name = format!("{n} equal Gaussians in one tile");
        (name, [64, 64], 75, -5.0, -4.0)
    };
    each(name, n as usize, size, seed, |s, i| {
        s.scatter(Plane::POSITION, i, [0.0; 3]);
        s.scatter(Plane::LOG_SCALE, i, [log_scale; 3]);
        s.scatter(Plane::OPACITY, i, [logit]);
        if n > 1.0 {
            s.scatter(Plane::ROTATION, i, [1.0, 0.0, 0.0, 0.0]);
        }
    })
}

/// Nothing in view: the render is the background.
fn lights(index: usize, _: f64) -> Case {
    const LIGHTS: [(&str, u8, f32); 5] = [
        ("black on black", 0, 0.0),
        ("black on white", 0, 1.0),
        ("white on white", 255, 1.0),
        ("white on black", 255, 0.0),
        ("grey on another grey", 128, 0.25),
    ];
    let (name, photo, background) = LIGHTS[index];
    let mut case = each(name, 4, [40, 32], 76, |s, i| {
        s.scatter(Plane::POSITION, i, [0.0, 0.0, -90.0]);
    });
    case.photo.data.fill(photo);
    case.background = [background; 3];
    case
}

/// One broken value each in a position, a log-scale, w of the quaternion, the opacity, a colour and a coefficient of a higher
/// band; those Gaussians are culled and disturb no other.
fn broken(index: usize, _: f64) -> Case {
    const VALUES: [(&str, f32); 7] = [
        ("NaN", f32::NAN),
        ("+inf", f32::INFINITY),
        ("-inf", f32::NEG_INFINITY),
        ("denormal", f32::from_bits(1)),
        ("-denormal", -f32::from_bits(1)),
        ("f32::MAX", f32::MAX),
        ("f32::MIN", f32::MIN),
    ];
    let (name, value) = VALUES[index];
    let mut case = mild(&format!("{name} in every parameter"), 40, [40, 32], 1, 77);
    // Edits name rows that may be among them.
    case.edits.clear();
    let planes = [0, 4, 6, Plane::OPACITY, Plane::SH, Plane::SH + 4];
    for (i, plane) in planes.into_iter().enumerate() {
        case.splats.plane_mut(plane)[3 * i + 2] = value;
        case.invalid.push(3 * i + 2);
    }
    case
}
