//! Families of stiff scenes: seeded, exact in f32, each along a measure of stiffness.

use crate::lab::verify::cases::{Case, mild};
use crate::lab::verify::stress::family::{Family, MIXED, WELL, each, family};
use crate::lab::verify::stress::places::{aside, depth, inside, near_plane};
use crate::lab::verify::stress::shapes::{end_on, needles, norms, pancakes, scale_variance};
use crate::scene::Plane;

/// f32 rounding of differences of larger terms that cancel.
const CANCELLED: f64 = 1e-3;

fn opacities() -> Family {
    let case = |logit: f64| {
        let name = format!("opacity logits ± {logit:.0}");
        let case = each(&name, 60, [40, 32], 69, |s, i, _| {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            s.scatter(Plane::OPACITY, i, [(sign * logit) as f32]);
        });
        (logit, case)
    };
    let why = "saturates: alpha is held at 0.99 in every precision";
    family(
        "opacity",
        "size of the logit",
        WELL,
        why,
        [1.0, 5.0, 20.0, 50.0, 100.0].map(case),
    )
}

fn cut() -> Family {
    let case = |ulps: i32| {
        let name = format!("opacity 1/255 ± {ulps} ulp");
        let exact = (1.0f64 / 254.0).ln() as f32;
        let at = |step: i32| f32::from_bits(exact.to_bits().wrapping_add_signed(step));
        let case = each(&name, 60, [40, 32], 70, |s, i, _| {
            let step = if i % 2 == 0 { ulps } else { -ulps };
            s.scatter(Plane::OPACITY, i, [at(step)]);
        });
        (f64::from(ulps), case)
    };
    let why = "whether such a Gaussian is there at all is decided in the last digit: it may be in one and not in the other";
    family(
        "alpha cut",
        "ulp off the cut",
        WELL,
        why,
        [1, 16, 256].map(case),
    )
}

fn layers() -> Family {
    let case = |n: usize| {
        let name = format!("{n} layers on one pixel");
        let case = each(&name, n, [4, 4], 71, |s, i, _| {
            s.scatter(Plane::POSITION, i, [0.0, 0.0, 1e-4 * i as f32]);
            s.scatter(Plane::OPACITY, i, [-4.0]);
        });
        (n as f64, case)
    };
    let why =
        "a product of that many factors, each with its rounding, until nothing is left behind it";
    family(
        "layers",
        "layers",
        MIXED,
        why,
        [10, 100, 1000, 10_000].map(case),
    )
}

fn sizes() -> Family {
    let plain = |n: usize, size: [u32; 2]| {
        let name = format!("{n} Gaussians, {}x{}", size[0], size[1]);
        let mut case = mild(&name, n, size, 1, 73);
        if n == 0 {
            case.edits.clear();
        }
        (f64::from(size[0] * size[1]), case)
    };
    let sizes = [
        (0, [20, 12]),
        (1, [1, 1]),
        (30, [1, 1]),
        (30, [17, 1]),
        (30, [1, 33]),
        (30, [15, 31]),
        (60, [255, 3]),
    ];
    let why = "nothing depends on whole tiles";
    family(
        "sizes",
        "pixels",
        MIXED,
        why,
        sizes.map(|(n, size)| plain(n, size)),
    )
}

fn crowds() -> Family {
    let wide = each(
        "one Gaussian over every tile",
        1,
        [250, 130],
        74,
        |s, i, _| {
            s.scatter(Plane::POSITION, i, [0.0; 3]);
            s.scatter(Plane::LOG_SCALE, i, [3.0; 3]);
            s.scatter(Plane::OPACITY, i, [3.0]);
        },
    );
    let crowd = |n: usize| {
        let name = format!("{n} equal Gaussians in one tile");
        let case = each(&name, n, [64, 64], 75, |s, i, _| {
            s.scatter(Plane::POSITION, i, [0.0; 3]);
            s.scatter(Plane::LOG_SCALE, i, [-5.0; 3]);
            s.scatter(Plane::ROTATION, i, [1.0, 0.0, 0.0, 0.0]);
            s.scatter(Plane::OPACITY, i, [-4.0]);
        });
        (n as f64, case)
    };
    let cases = [(1.0, wide), crowd(3), crowd(3000)];
    let why = "equal depths: ties go by index, in every precision";
    family("crowds and ties", "Gaussians", CANCELLED, why, cases)
}

fn lights() -> Family {
    let case = |(k, (name, photo, background)): (usize, (&str, u8, f32))| {
        // Nothing in view: the render is the background.
        let mut case = each(name, 4, [40, 32], 76, |s, i, _| {
            s.scatter(Plane::POSITION, i, [0.0, 0.0, -90.0]);
        });
        case.photo.data.fill(photo);
        case.background = [background; 3];
        (1.0 + k as f64, case)
    };
    let cases = [
        ("black on black", 0, 0.0),
        ("black on white", 0, 1.0),
        ("white on white", 255, 1.0),
        ("white on black", 255, 0.0),
        ("grey on another grey", 128, 0.25),
    ];
    let why = "without variance SSIM is that of the means, and its gradient is finite";
    let cases: Vec<_> = cases.into_iter().enumerate().map(case).collect();
    family("constant images", "case", MIXED, why, cases)
}

/// Every family of scenes.
pub fn families() -> Vec<Family> {
    vec![
        needles(),
        pancakes(),
        end_on(),
        scale_variance(),
        depth(),
        near_plane(),
        inside(),
        aside(),
        opacities(),
        cut(),
        layers(),
        norms(),
        sizes(),
        crowds(),
        lights(),
        broken(),
    ]
}

/// Parameter planes with one broken value each: a position, a log-scale, w of the quaternion, the opacity, a colour and a
/// coefficient of a higher band.
const BROKEN: [usize; 6] = [0, 4, 6, Plane::OPACITY, Plane::SH, Plane::SH + 4];

/// Scenes with one broken value in each of [`BROKEN`]; those Gaussians are culled and disturb no other.
fn broken() -> Family {
    let values = [
        ("NaN", f32::NAN),
        ("+inf", f32::INFINITY),
        ("-inf", f32::NEG_INFINITY),
        ("denormal", f32::from_bits(1)),
        ("-denormal", -f32::from_bits(1)),
        ("f32::MAX", f32::MAX),
        ("f32::MIN", f32::MIN),
    ];
    let case = |(k, (name, value)): (usize, (&str, f32))| {
        let mut case = mild(&format!("{name} in every parameter"), 40, [40, 32], 1, 77);
        // Edits name rows that may be among them.
        case.edits.clear();
        for (i, plane) in BROKEN.into_iter().enumerate() {
            case.splats.plane_mut(plane)[3 * i + 2] = value;
            case.invalid.push(3 * i + 2);
        }
        (1.0 + k as f64, case)
    };
    let cases: Vec<_> = values.into_iter().enumerate().map(case).collect();
    let why = "a Gaussian that is not a number is not there";
    family("broken values", "case", MIXED, why, cases)
}

/// Edge of the image of [`many_pairs`], pixels: 16,384 tiles.
pub const MANY_SIDE: u32 = 2048;

/// `n` opaque Gaussians one behind the other, each over the whole image.
pub fn many_pairs(n: usize) -> Case {
    let mut case = each("more than 2^24 pairs", n, [MANY_SIDE; 2], 78, |s, i, _| {
        s.scatter(Plane::POSITION, i, [0.0, 0.0, 1e-3 * i as f32]);
        s.scatter(Plane::LOG_SCALE, i, [5.0; 3]);
        s.scatter(Plane::OPACITY, i, [5.0]);
    });
    case.edits.clear();
    case
}
