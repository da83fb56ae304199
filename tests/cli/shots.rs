//! Views of `render` that no photo was taken from: circles within the cameras, smooth paths, keyframes; depth in 16 bits, videos.

use std::fs;
use std::path::Path;

use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use super::{done, mhsplat, program, room, stderr, text};
use mhsplat::Camera;
use mhsplat::scene::orbit::{look_at, pinhole};
use mhsplat::scene::{Keyframe, Ring, Trajectory};

/// Cameras on an arc of a circle, each looking at the centre, or away from it.
fn arc(radius: f64, degrees: f64, n: u32, outwards: bool) -> Vec<Camera> {
    let camera = |k: u32| {
        let a = degrees.to_radians() * f64::from(k) / f64::from(n);
        let eye = DVec3::new(a.cos(), 0.1, a.sin()) * radius;
        let target = if outwards { eye * 2.0 } else { DVec3::ZERO };
        pinhole(eye, look_at(eye, target, DVec3::Y), [64, 48], 1.0)
    };
    (0..n).map(camera).collect()
}

#[test]
fn circles_stay_within_the_cameras() {
    let around = Ring::inside(&arc(3.0, 360.0, 24, false)).unwrap();
    assert!(around.center.length() < 0.1 && around.target == around.center);
    assert!((1.5..3.0).contains(&around.radius), "{around:?}");
    assert!((around.up - DVec3::Y).length() < 0.05 && (0.1..0.5).contains(&around.height));
    for camera in around.cameras(7, [64, 48], 1.0) {
        let eye = camera.center();
        assert!(eye.x.hypot(eye.z) < 3.0 && eye.y > 0.0);
        let target = camera.rotation * around.target + camera.translation;
        assert!(target.z > 0.0 && target.x.abs() < 1e-9 && target.y.abs() < 1e-9);
        // Upright: y of the image points down.
        assert!(camera.rotation.row(1).y < -0.9);
    }
    // From within a room the walls are seen, not from behind them.
    let room = Ring::inside(&arc(1.0, 360.0, 24, true)).unwrap();
    assert!(
        room.center.x.hypot(room.center.z) < 0.1 && room.radius < 1.0,
        "{room:?}"
    );
    // Nobody knows what is behind a thing that was seen from one side.
    let side = Ring::inside(&arc(3.0, 60.0, 12, false)).unwrap();
    assert!(side.radius < 1.0 && side.target.length() < 0.1, "{side:?}");
    assert!(side.center.distance(side.target) > 2.0, "{side:?}");
    assert!(Ring::inside(&[]).is_none());
}

fn key(time: f64, x: f64, turn: f64) -> Keyframe {
    Keyframe {
        time,
        position: DVec3::new(x, 0.0, 0.0),
        rotation: DQuat::from_rotation_y(turn),
        fov: 1.0,
    }
}

#[test]
fn paths_go_through_their_keyframes_smoothly() {
    let keys = [
        key(0.0, 0.0, 0.0),
        key(1.0, 1.0, 0.4),
        key(4.0, 2.0, 3.0),
        key(5.0, 0.0, 6.2),
    ];
    let path = Trajectory::new(&keys).unwrap();
    let cameras = path.cameras(501, [64, 48]);
    for k in &keys {
        let camera = &cameras[(k.time * 100.0) as usize];
        assert!(camera.center().distance(k.position) < 1e-9);
        let turned = glam::DMat3::from_quat(k.rotation);
        assert!(
            (camera.rotation - turned)
                .to_cols_array()
                .iter()
                .all(|d| d.abs() < 1e-9)
        );
    }
    let steps = cameras.windows(2).map(|c| c[1].center() - c[0].center());
    let steps: Vec<DVec3> = steps.collect();
    let jerk = steps.windows(2).map(|s| (s[1] - s[0]).length());
    assert!(jerk.fold(0.0, f64::max) < 2e-3, "no corner anywhere");
    assert_eq!(
        Trajectory::new(&keys[..1])
            .unwrap()
            .cameras(3, [8, 8])
            .len(),
        3
    );
    let bad = [
        vec![],
        vec![key(1.0, 0.0, 0.0), key(1.0, 1.0, 0.0)],
        vec![key(f64::NAN, 0.0, 0.0)],
        vec![key(0.0, f64::INFINITY, 0.0)],
        vec![Keyframe {
            fov: 0.0,
            ..key(0.0, 0.0, 0.0)
        }],
        vec![Keyframe {
            rotation: DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0),
            ..key(0.0, 0.0, 0.0)
        }],
    ];
    for keys in bad {
        assert!(Trajectory::new(&keys).is_err(), "{keys:?}");
    }
}

#[test]
fn a_path_is_laid_along_cameras_that_are_in_order() {
    let ordered = arc(3.0, 360.0, 60, false);
    let path = Trajectory::along(&ordered, 1.0, 120).unwrap().unwrap();
    for camera in path.cameras(120, [64, 48]) {
        assert!(
            (camera.center().length() - 3.0).abs() < 0.1,
            "off the circle"
        );
    }
    // Every 23rd of 60: neighbours in order are far apart, and a path through them would cross what they look at.
    let mixed: Vec<Camera> = (0..60).map(|k| ordered[k * 23 % 60]).collect();
    assert!(Trajectory::along(&mixed, 1.0, 120).unwrap().is_none());
    assert!(Trajectory::along(&[], 1.0, 120).unwrap().is_none());
}

fn files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn runs_are_filmed() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let (room, run) = (room(), text(&run));
    done(&[
        "train",
        &room,
        "-o",
        run,
        "--max-size",
        "48",
        "--iterations",
        "10",
    ]);
    let out = |name: &str| dir.path().join(name);
    let render = |name: &str, more: &[&str]| {
        done(&[&["render", run, "-o", text(&out(name))], more].concat());
        files(&out(name))
    };
    // Without a word about views: along the dataset's cameras, in the photos' shape.
    let names = render("along", &["--frames", "3"]);
    assert_eq!(
        names,
        ["frame_0000.png", "frame_0001.png", "frame_0002.png"]
    );
    let size = image::image_dimensions(out("along").join(&names[0])).unwrap();
    assert_eq!(size, (48, 36));
    assert_eq!(render("held-out", &["--held-out"]).len(), 5);
    let wide = [
        "--orbit",
        "2",
        "--width",
        "64",
        "--center",
        "0,-1e-3,0",
        "--radius",
        "0.5",
    ];
    assert_eq!(
        render(
            "orbit",
            &[
                &wide[..],
                &["--orbit-height", "-0.1", "--up", "0,-1,0", "--fov", "90"]
            ]
            .concat()
        )
        .len(),
        2
    );
    let size = image::image_dimensions(out("orbit").join("orbit_0000.png")).unwrap();
    assert_eq!(size, (64, 48));
    let file = out("path.json");
    let keys = json!({ "fov": 70, "keyframes": [
        { "position": [0, 0, 0], "look_at": [1, 0, 0] },
        { "position": [0.1, 0, 0], "rotation": [1, 0, 0, 0], "time": 0.5, "fov": 50 },
    ]});
    fs::write(&file, format!("\u{feff}{keys}")).unwrap();
    let names = render(
        "keys",
        &["--path", text(&file), "--fps", "4", "--what", "depth"],
    );
    assert_eq!(
        names,
        [
            "depth.json",
            "frame_0000.png",
            "frame_0001.png",
            "frame_0002.png"
        ]
    );
    let steps: Value =
        serde_json::from_slice(&fs::read(out("keys").join("depth.json")).unwrap()).unwrap();
    let image = image::open(out("keys").join(&names[1])).unwrap();
    assert_eq!(image.color(), image::ColorType::L16);
    let largest = image.into_luma16().iter().copied().max().unwrap();
    let depth = f64::from(largest) * steps[&names[1]].as_f64().unwrap();
    assert!(
        largest == u16::MAX && (0.1..100.0).contains(&depth),
        "{depth}"
    );
    wrong_shots_are_refused(run, dir.path());
    #[cfg(unix)]
    filmed(run, dir.path());
}

/// Videos by a program of that name: one that copies its input, one that fails, and none.
#[cfg(unix)]
fn filmed(run: &str, dir: &Path) {
    use std::os::unix::fs::PermissionsExt;
    let (bin, video) = (dir.join("bin"), dir.join("film.mp4"));
    fs::create_dir(&bin).unwrap();
    let film = |name: &str, video: &Path, path: &Path| {
        let mut command = program();
        command.args(["render", run, "--frames", "2", "-o", text(&dir.join(name))]);
        command.args(["--video", text(video)]).env("PATH", path);
        command.output().unwrap()
    };
    let none = film("none", &video, &bin);
    assert_eq!(none.status.code(), Some(2));
    assert!(stderr(&none).contains("ffmpeg is not on the path") && !dir.join("none").exists());
    let write = |script: &str| {
        fs::write(bin.join("ffmpeg"), script).unwrap();
        fs::set_permissions(bin.join("ffmpeg"), fs::Permissions::from_mode(0o755)).unwrap();
    };
    write("#!/bin/sh\n[ \"$1\" = -version ] && exit 0\necho no encoder >&2\nexit 1\n");
    let failed = film("failed", &video, &bin);
    assert_eq!(failed.status.code(), Some(2));
    assert!(stderr(&failed).contains("no encoder") && !video.exists());
    assert_eq!(files(&dir.join("failed")).len(), 2, "the images are kept");
    write(
        "#!/bin/sh\n[ \"$1\" = -version ] && exit 0\n[ -f frame_0001.png ] || exit 1\nfor last; do :; done\necho \"$@\" > \"$last\"\n",
    );
    let made = film("100%d", &video, &bin);
    assert_eq!(made.status.code(), Some(0), "{}", stderr(&made));
    let asked = fs::read_to_string(&video).unwrap();
    assert!(asked.contains("-framerate 30 -i frame_%04d.png"), "{asked}");
    let again = film("again", &video, &bin);
    assert_eq!(again.status.code(), Some(2), "nothing is overwritten");
    let within = film("within", &dir.join("within/film.mp4"), &bin);
    assert_eq!(within.status.code(), Some(0), "{}", stderr(&within));
    for nowhere in ["gone/film.mp4", "lost"] {
        let lost = film("lost", &dir.join(nowhere), &bin);
        assert_eq!(lost.status.code(), Some(2));
        assert!(stderr(&lost).contains("folder") && !dir.join("lost").exists());
    }
}

/// Nothing is rendered of what could not be as it is asked for.
fn wrong_shots_are_refused(run: &str, dir: &Path) {
    let out = |name: &str| dir.join(name);
    let file = out("path.json");
    for (wrong, said) in [
        ("{}", "keyframes"),
        ("{\"keyframes\": []}", "at least one"),
        (
            "{\"keyframes\": [{\"position\": [0, 0, 0]}]}",
            "look_at and rotation",
        ),
        (
            "{\"keyframes\": [{\"position\": [0, 0, 1e999]}]}",
            "path.json",
        ),
        ("{\"keyframes\": [{\"where\": 1}]}", "where"),
        (
            "{\"up\": [0, 0, 0], \"keyframes\": [{\"position\": [0, 0, 0], \"look_at\": [1, 0, 0]}]}",
            "not 0,0,0",
        ),
        (
            "{\"keyframes\": [{\"position\": [0, 0, 0], \"rotation\": [1, 0, 0, 0]}, {\"position\": [1, 0, 0], \"rotation\": [1, 0, 0, 0], \"time\": 1e6}]}",
            "100000 frames",
        ),
    ] {
        fs::write(&file, wrong).unwrap();
        let output = mhsplat(&["render", run, "-o", text(&out("no")), "--path", text(&file)]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(said) && !out("no").exists(), "{message}");
    }
    let good = out("good.json");
    let one = r#"{"keyframes": [{"position": [0, 0, 0], "look_at": [1, 0, 0]}]}"#;
    fs::write(&good, one).unwrap();
    for (wrong, said) in [
        (&["--orbit", "2", "--up", "0,0,0"][..], "--up"),
        (&["--what", "error", "--frames", "2"], "--what error"),
        (&["--center", "0,0,0"], "--orbit"),
        (&["--held-out", "--video", "x.mp4"], "--video"),
        (&["--orbit", "4000000000"], "4000000000"),
        (&["--orbit", "100001"], "100001"),
        // What would have no effect.
        (&["--held-out", "--fov", "60"], "--fov"),
        (&["--held-out", "--width", "64"], "--width"),
        (&["--what", "error", "--height", "64"], "--height"),
        (&["--held-out", "--up", "0,1,0"], "--up"),
        (&["--up", "0,1,0"], "--up"),
        (&["--fps", "30"], "--fps"),
        (&["--orbit", "2", "--fps", "24"], "--fps"),
        (
            &["--path", text(&good), "--frames", "2", "--fps", "24"],
            "--fps",
        ),
    ] {
        let output = mhsplat(&[&["render", run, "-o", text(&out("no"))], wrong].concat());
        assert_eq!(output.status.code(), Some(2), "{wrong:?}");
        assert!(
            stderr(&output).contains(said) && !out("no").exists(),
            "{}",
            stderr(&output)
        );
    }
}
