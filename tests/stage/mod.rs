//! Tests of the stages.

use glam::{DMat3, DVec3};
use mhsplat::dataset::{Camera, Photo, View};
use mhsplat::density::rng::Philox;
use mhsplat::gpu::Device;
use mhsplat::gpu::tuning::Tuning;
use mhsplat::model::{Plane, Splats};
use mhsplat::stage::adam::LearningRates;
use mhsplat::verify::chain::{self, Case};

fn case(n: usize, w: u32, h: u32, degree: u32, seed: u64) -> Case {
    let u = |i: usize, k: u64| Philox::uniform(seed, k, i as u64);
    let mut s = Splats::zeros(degree, n);
    for i in 0..n {
        let (a, b, c, d) = (u(i, 1), u(i, 2), u(i, 3), u(i, 4));
        let f = |v: f64| v as f32;
        s.scatter(
            Plane::POSITION,
            i,
            [
                f(a[0] * 2.0 - 1.0),
                f(a[1] * 2.0 - 1.0),
                f(a[2] * 2.0 - 1.0),
            ],
        );
        s.scatter(
            Plane::LOG_SCALE,
            i,
            [
                f(-3.0 + 2.0 * b[0]),
                f(-3.0 + 2.0 * b[1]),
                f(-3.0 + 2.0 * b[2]),
            ],
        );
        s.scatter(
            Plane::ROTATION,
            i,
            [f(c[0] - 0.5), f(c[1] - 0.5), f(c[2] - 0.5), f(c[3] - 0.5)],
        );
        s.scatter(Plane::OPACITY, i, [f(4.0 * d[0] - 1.0)]);
        for k in Plane::SH..Plane::count(degree) {
            let e = u(i, 10 + k as u64);
            s.scatter(k, i, [f(e[0] * 1.2 - 0.4)]);
        }
    }
    let camera = Camera {
        rotation: DMat3::from_rotation_y(0.1),
        translation: DVec3::new(0.1, -0.05, 3.0),
        fx: f64::from(w) * 1.1,
        fy: f64::from(w) * 1.05,
        cx: f64::from(w) * 0.47,
        cy: f64::from(h) * 0.55,
        width: w,
        height: h,
    };
    let data = (0..3 * w * h)
        .map(|i| (u(i as usize, 99)[0] * 255.0) as u8)
        .collect();
    Case {
        name: format!("{n} Gaussians, {w}x{h}, SH {degree}"),
        splats: s,
        view: View {
            name: "v".into(),
            camera,
            photo: Photo {
                width: w,
                height: h,
                channels: 3,
                data,
            },
        },
        background: [0.2, 0.5, 0.1],
        alpha_min: 1.0 / 255.0,
        sh_degree: degree,
        lambdas: [0.2, 0.01, 0.01],
        rates: LearningRates {
            position: 1e-3,
            scale: 5e-3,
            rotation: 1e-3,
            opacity: 0.025,
            sh0: 2.5e-3,
            sh: 1e-4,
        },
        edits: vec![],
    }
}

#[test]
fn smoke() {
    let device = Device::open(None).unwrap();
    println!("{:?}", device.info());
    let c = case(500, 75, 50, 3, 7);
    let a = chain::run::<f64>(&device, Tuning::CPU, &c).unwrap();
    let b = chain::run::<f32>(&device, Tuning::CPU, &c).unwrap();
    let g = chain::run::<f32>(&device, Tuning::GPU, &c).unwrap();
    println!("loss {:?} {:?} {:?}", a.loss, b.loss, g.loss);
    let pairs: usize = a.tiles.iter().map(Vec::len).sum();
    println!(
        "visible {} pairs {} counted {}",
        a.records.iter().flatten().count(),
        pairs,
        a.counted
    );
    let diff = |x: &[f64], y: &[f64]| {
        x.iter()
            .zip(y)
            .map(|(p, q)| (p - q).abs())
            .fold(0.0, f64::max)
    };
    println!(
        "image f32 {:e} gpu {:e}",
        diff(&a.image, &b.image),
        diff(&a.image, &g.image)
    );
    println!(
        "dimage {:e} {:e} max {:e}",
        diff(&a.dimage, &b.dimage),
        diff(&a.dimage, &g.dimage),
        diff(&a.dimage, &vec![0.0; a.dimage.len()])
    );
    for p in 0..a.grads.len() {
        println!(
            "grad {p}: {:e} {:e} of {:e}",
            diff(&a.grads[p], &b.grads[p]),
            diff(&a.grads[p], &g.grads[p]),
            diff(&a.grads[p], &vec![0.0; a.grads[p].len()])
        );
    }
    println!("{:?}", b.seconds);
}
