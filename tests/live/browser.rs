//! The page in headless Chromium, where there is one.

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use image::RgbImage;

use mhsplat::Device;
use mhsplat::Error;
use mhsplat::Result;
use mhsplat::capture::Camera;
use mhsplat::capture::photo::{Alpha, Photo};
use mhsplat::device::Defines;
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::{Quantity, RenderOptions, Rendered, Renderer};
use mhsplat::run::checkpoint;
use mhsplat::run::live::Scenery;
use mhsplat::run::report::gallery::{colormap, error_map};

use super::operated::{Changes, operate};
use super::server::{page, serve};
use super::training::watched;
use crate::cli::{done, text};
use crate::determinism::room;
use crate::viewer::browser::{alike, browser, rendered};
use crate::viewer::pages::{scene, views};

/// PSNR that the page's picture has against the kernels' at least, dB: what JPEG costs.
const ALIKE: f64 = 30.0;

/// A scene on the device.
struct Drawn(GaussianBuffers, Renderer);

impl Scenery for Drawn {
    fn render(&mut self, camera: &Camera, quantity: Quantity) -> Result<Rendered> {
        let options = RenderOptions {
            sh_degree: self.0.sh_degree,
            background: self.background(),
            quantity,
            active_only: false,
        };
        self.1.image(&self.0, camera, &options)
    }

    fn photo(&mut self, view: usize) -> Result<Option<(Camera, Photo)>> {
        let camera = views()[view].camera;
        let (w, h) = (camera.width, camera.height);
        let pixel = |i: u32| [(i % w) as u8, (i / w) as u8, 90];
        let bytes: Vec<u8> = (0..w * h).flat_map(pixel).collect();
        let photo = Photo::from_interleaved(w, h, Alpha::None, &bytes)?;
        Ok(Some((camera, photo)))
    }

    fn background(&self) -> [f32; 3] {
        [0.25, 0.5, 0.75]
    }

    fn reach(&self) -> f64 {
        1.0
    }
}

/// The pictures that the page is to show of a view, by the kernels and by their definitions.
fn expected(drawn: &mut Drawn, view: usize, color: &RgbImage) -> Result<HashMap<String, RgbImage>> {
    let (camera, photo) = drawn.photo(view)?.unwrap();
    let of = |rgb| RgbImage::from_raw(camera.width, camera.height, rgb).unwrap();
    let depths = drawn.render(&camera, Quantity::Depth)?.mean_depths();
    let near = |z: f64| match z > 0.0 {
        true => colormap(drawn.reach() / (drawn.reach() + z)),
        false => [0; 3],
    };
    let error = error_map(color.as_raw(), &photo.rgb_over(drawn.background()))?;
    let pictures = [
        ("color", color.clone()),
        ("depth", of(depths.into_iter().flat_map(near).collect())),
        ("error", of(error)),
    ];
    Ok(pictures.map(|(name, image)| (name.into(), image)).into())
}

/// Chooses each picture by the list and by the key, and the photo.
const CHOOSE: &str = r#"use(async () => {
  const shows = (mode) => () => !busy && shown.url.includes('mode=' + mode) && $('notice').hidden;
  const see = async (mode) => { await until(mode, shows(mode)); await keep(mode); };
  await see('color');
  choose('depth'); await see('depth');
  choose('error'); await see('error');
  key('KeyM'); await until('color by key', shows('color'));
  key('KeyM'); await until('depth by key', shows('depth'));
  key('KeyM'); await until('error by key', shows('error'));
  const before = [...view.center];
  canvas.dispatchEvent(new WheelEvent('wheel', { deltaY: -100, cancelable: true }));
  await until('color of a place without a photo', shows('color'));
  check('moves', moved && Math.hypot(...add(view.center, before, -1)) > 0.01);
  key('KeyR'); await until('error again', shows('error'));
  $('compare').click();
  await until('photo', () => !$('photo').hidden && $('picture').naturalWidth > 0);
  check('pressed', $('compare').getAttribute('aria-pressed') === 'true');
  $('compare').click(); await until('no photo', () => $('photo').hidden);
  $('next').click(); await until('next', () => shown.url.includes('view=5') && !busy);
  check('message', $('message').hidden);
});"#;

#[test]
fn the_browser_shows_what_is_chosen() {
    let Some(browser) = browser() else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let (splats, all) = (scene(3000, 2), views());
    let colors = rendered(&splats, false, &all);
    let device = Device::open(None).unwrap();
    let defines = Defines::new(device.tuning());
    let renderer = Renderer::new(&device, defines, 2, false).unwrap();
    let buffers = GaussianBuffers::upload(&device, &splats, 0).unwrap();
    let mut drawn = Drawn(buffers, renderer);
    let expected = expected(&mut drawn, 4, &colors[4]).unwrap();
    let mut shown = |seconds: u32, changes: &Changes<'_>| {
        serve(&page(false), &mut drawn, |client| {
            let place = (client, "view=4&size=160x120");
            operate((&browser, dir.path()), place, (CHOOSE, seconds), changes)
        })
    };
    let right = shown(60, &[]);
    assert_eq!(right.verdict, "all as told");
    assert_eq!(right.kept.len(), expected.len());
    for (name, picture) in &expected {
        let like = alike(&right.kept[name], picture);
        println!("{name}: {like:.1} dB");
        assert!(like > ALIKE, "{name}: {like} dB");
    }
    // Another camera's picture, and that of another quantity, must not pass.
    assert!(alike(&right.kept["color"], &colors[3]) < 25.0);
    assert!(alike(&right.kept["color"], &expected["depth"]) < 25.0);
    let deaf = [("=== 'error' ? 'color'", "!== 'births' ? 'color'")];
    assert_eq!(shown(5, &deaf).verdict, "never depth");
    let upside_down = [(
        "rotation: view.rows.flat()",
        "rotation: view.rows.flat().map((v, k) => (k < 6 ? -v : v))",
    )];
    let wrong = shown(60, &upside_down);
    assert!(alike(&wrong.kept["color"], &expected["color"]) < 25.0);
}

/// Pauses a run, saves it, lets it go on, looks at it while it rests, and ends it.
const CONTROL: &str = r#"use(async () => {
  const rest = async () => {
    $('pause').click();
    await until('paused', () => run.state === 'paused' && $('pause').textContent === 'Continue');
    // The iteration in which it was asked for ends.
    await pause(300); await look();
  };
  await until('begun', () => run && run.iteration > 0);
  if (run.state === 'paused') await wish('continue');
  await until('curves', () => run.state === 'training' && $('curve-loss').textContent.includes('0.'));
  // The last value is at the right end, whatever the run is to have.
  const last = () => $('curve-loss').querySelector('polyline').getAttribute('points').split(/[ ,]/).at(-2);
  await until('a curve as wide as its box', () => last() > 50);
  await rest();
  const at = run.iteration;
  await pause(300); await look();
  check('rests', run.iteration === at);
  $('checkpoint').click();
  await until('saved', () => run.saved === at && $('saved').textContent.includes(number(at)));
  $('pause').click();
  await until('going on', () => run.state === 'training' && $('pause').textContent === 'Pause' && run.iteration > at + 5);
  await rest();
  choose('births');
  await until('births', () => !busy && $('notice').hidden && shown.url.includes('mode=births'));
  await keep('births');
  choose('color'); await until('color', () => !busy && shown.url.includes('mode=color'));
  stale = true; frame();
  await until('picture', () => !stale && !busy && $('notice').hidden && shown.iteration === run.iteration);
  await keep('resting');
  globalThis.confirm = () => false;
  $('stop').click(); await pause(300); await look();
  check('asks before it stops', run.state === 'paused');
  globalThis.confirm = () => true;
  $('stop').click();
  await until('stopped', () => run.state === 'stopping' || !$('notice').hidden);
});"#;

/// Has a run controlled in the browser, by broken pages at first; what the right one has shown last.
fn controlled(browser: &Path, dir: &Path) -> RgbImage {
    let folder = dir.join("run");
    let (mut run, client) = watched(&folder, 1_000_000);
    let camera = room(64).test[1].camera;
    let hash = format!("view=1&size={}x{}", camera.width, camera.height);
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let visitor = scope.spawn(|| {
            let used = |seconds: u32, changes: &Changes<'_>| {
                operate(
                    (browser, dir),
                    (&client, &hash),
                    (CONTROL, seconds),
                    changes,
                )
            };
            for (right, wrong, never) in [
                (
                    "=== 'paused' ? 'continue' : 'pause')",
                    "=== 'paused' ? 'pause' : 'continue')",
                    "paused",
                ),
                ("wish('checkpoint')", "wish('pause')", "saved"),
            ] {
                let verdict = used(10, &[(right, wrong)]).verdict;
                assert_eq!(verdict, format!("never {never}"));
            }
            let told = used(60, &[]);
            client.post("/stop");
            told
        });
        let driven = run.drive(&stop, |_| ()).map(|_| ());
        let mut told = visitor.join().unwrap();
        assert_eq!(told.verdict, "all as told");
        assert!(matches!(driven, Err(Error::Interrupted)), "{driven:?}");
        let saved = checkpoint::read(&folder).unwrap().state.iteration;
        assert_eq!(run.saved(), Some(saved));
        // Births are yellow, what is there beside them grey; of the first steps there is nothing, or there are some.
        let coloured = |p: &&image::Rgb<u8>| p.0[0].abs_diff(p.0[2]) > 60;
        let births = &told.kept["births"];
        let resting = told.kept["resting"].pixels().filter(coloured).count();
        assert!(births.pixels().filter(coloured).count() < resting / 2);
        told.kept.remove("resting").unwrap()
    })
}

#[test]
fn the_page_controls_a_run_and_shows_what_render_does() {
    let Some(browser) = browser() else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let found = controlled(&browser, dir.path());
    let [run, images] = ["run", "images"].map(|name| dir.path().join(name));
    done(&[
        "render",
        text(&run),
        "--held-out",
        "--max-size",
        "64",
        "-o",
        text(&images),
    ]);
    let render = |view: usize| {
        let name = Path::new(&room(64).test[view].name).with_extension("png");
        let file = images.join(name.file_name().unwrap());
        image::open(file).unwrap().to_rgb8()
    };
    let like = alike(&found, &render(1));
    println!("{like:.1} dB");
    assert!(like > ALIKE, "{like} dB");
    assert!(alike(&found, &render(2)) < 25.0);
}
