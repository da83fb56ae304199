//! filter: the 3D filter of each Gaussian.

use glam::{DMat3, DVec3};

use super::*;
use mhsplat::base::constants::FILTER_CHUNKS;
use mhsplat::capture::Camera;
use mhsplat::device::tuning::status;
use mhsplat::device::{Array, CameraArg};
use mhsplat::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use mhsplat::pipeline::stage::filter;
use mhsplat::scene::filters;
use mhsplat::scene::{Gaussians, Plane};

#[test]
fn agrees_with_the_reference() {
    let rows: Vec<&Row> = ROWS.iter().filter(|r| r.stage == "filter").collect();
    let filtered = scenes()
        .iter()
        .filter(|c| !c.filter_views.is_empty())
        .count();
    assert!(filtered > 0 && rows.len() >= 2 * filtered, "{}", rows.len());
    for row in rows {
        assert!(row.pass && row.non_finite == 0, "{row:?}");
    }
}

#[test]
fn a_wrong_filter_is_rejected() {
    rejects_in("filter", "standard deviation", &anti_aliased(), |s| {
        s[3] *= 1.001
    });
}

/// Looks along z from `z` with 100 × 80 pixels.
fn camera(z: f64, focal: f64) -> Camera {
    Camera {
        rotation: DMat3::IDENTITY,
        translation: DVec3::new(0.0, 0.0, -z),
        fx: focal,
        fy: 0.9 * focal,
        cx: 50.0,
        cy: 40.0,
        width: 100,
        height: 80,
    }
}

fn at(positions: &[[f32; 3]]) -> Gaussians {
    let mut splats = Gaussians::zeros(0, positions.len());
    for (i, p) in positions.iter().enumerate() {
        splats.scatter(Plane::POSITION, i, *p);
    }
    splats
}

fn filtered(splats: &Gaussians, cameras: &[Camera], overflow: u32) -> Vec<f32> {
    let device = device();
    let kernels = kernels(&device);
    let mut scene = GaussianBuffers::<f32>::upload(&device, splats, 0).unwrap();
    let args: Vec<_> = cameras
        .iter()
        .map(|c| CameraArg::new(c, device.tuning().tile))
        .collect();
    let frame = ViewBuffers::new(&device, &kernels.defines().tuning, false).unwrap();
    let flag = status::OVERFLOW as usize;
    frame.status.write(flag, &[overflow]).unwrap();
    scene.filter = Array::from_slice(&device, "filter", &vec![7.0f32; scene.stride]).unwrap();
    let cameras = Array::from_slice(&device, "cameras", &args).unwrap();
    let largest = Array::zeros(&device, "largest", FILTER_CHUNKS as usize).unwrap();
    let stage = kernels.build::<f32>("filter").unwrap();
    filter::compute(&stage, &scene, &frame, &cameras, &largest).unwrap();
    scene.filter.read(0, splats.len()).unwrap()
}

#[test]
fn the_finest_view_that_sees_a_centre_decides() {
    let cameras = [camera(0.0, 200.0), camera(1.0, 50.0), camera(2.5, 200.0)];
    let positions = [
        [0.0, 0.0, 3.0],   // depths 3, 2 and 0.5: the last view's 0.5/200
        [0.0, 0.0, 2.502], // before the last one's near plane: 2.502/200
        // The last view's image ends at x/z = 0.25, widened at 0.325.
        [0.16, 0.0, 3.0],
        [0.17, 0.0, 3.0],
        [0.0, 0.0, -4.0],     // seen by none
        [f32::NAN, 0.0, 3.0], // likewise
    ];
    let finest = [0.5 / 200.0, 2.502 / 200.0, 0.5 / 200.0, 3.0 / 200.0];
    let largest = finest[3];
    let want: Vec<f64> = finest
        .iter()
        .chain(&[largest; 2])
        .map(|d| 0.2f64.sqrt() * d)
        .collect();
    let splats = at(&positions);
    let got = filtered(&splats, &cameras, 0);
    let host = filters(positions.iter().map(|p| p.map(f64::from)), &cameras);
    for ((got, host), want) in got.iter().zip(&host).zip(&want) {
        assert!((f64::from(*got) - want).abs() < 1e-6 * want, "{got} {want}");
        assert!((host - want).abs() < 1e-6 * want, "{host} {want}");
    }
}

#[test]
fn nothing_is_filtered_where_nothing_is_seen_and_an_overflow_changes_nothing() {
    let behind = at(&[[0.0, 0.0, -1.0]; 20]);
    assert_eq!(filtered(&behind, &[camera(0.0, 100.0)], 0), [0.0; 20]);
    assert_eq!(filtered(&behind, &[camera(0.0, 100.0)], 9), [7.0; 20]);
}

/// More Gaussians than chunks, the largest filter anywhere among them.
#[test]
fn the_largest_of_many_is_found() {
    for place in [0, 1, 999, 1300] {
        let mut positions = vec![[0.0, 0.0, 2.0]; 1301];
        positions[(place + 7) % 1301] = [0.0, 0.0, -1.0];
        positions[place] = [0.0, 0.0, 5.0];
        let got = filtered(&at(&positions), &[camera(0.0, 100.0)], 0);
        assert_eq!(got[(place + 7) % 1301], got[place]);
        assert!(got[place] > 2.0 * got[(place + 1) % 1301]);
    }
}
