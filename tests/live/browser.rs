//! The page in headless Chromium, where there is one.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use mhsplat::Device;
use mhsplat::capture::Camera;
use mhsplat::capture::photo::Photo;
use mhsplat::device::Defines;
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::{Quantity, RenderOptions, Rendered, Renderer};
use mhsplat::run::live::Scenery;
use mhsplat::{Error, Result};

use super::client::Client;
use super::server::{page, serve};
use super::training::watched;
use crate::viewer::browser::{alike, browser, rendered, visit};
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

    fn photo(&mut self, _: usize) -> Result<Option<(Camera, Photo)>> {
        Ok(None)
    }

    fn background(&self) -> [f32; 3] {
        [0.25, 0.5, 0.75]
    }

    fn reach(&self) -> f64 {
        1.0
    }
}

/// Title that a page has in the end.
fn title(dom: &str) -> &str {
    let start = dom.find("<title>").unwrap() + 7;
    &dom[start..dom.find("</title>").unwrap()]
}

#[test]
fn the_browser_shows_what_the_kernels_render() {
    let Some(browser) = browser() else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let (splats, all) = (scene(3000, 2), views());
    let expected = rendered(&splats, false, &all);
    let device = Device::open(None).unwrap();
    let defines = Defines::new(device.tuning());
    let renderer = Renderer::new(&device, defines, 2, false).unwrap();
    let buffers = GaussianBuffers::upload(&device, &splats, 0).unwrap();
    let picture = dir.path().join("shot.png");
    let shot = format!("--screenshot={}", picture.display());
    serve(&page(false), &mut Drawn(buffers, renderer), |client| {
        let (port, token) = (client.port, &client.token);
        let url = format!("http://127.0.0.1:{port}/?token={token}#view=4&size=160x120&bare");
        visit(&browser, dir.path(), &url, &[&shot]);
    });
    let found = image::open(&picture).unwrap().to_rgb8();
    let found = image::imageops::crop_imm(&found, 0, 0, 160, 120).to_image();
    let like = alike(&found, &expected[4]);
    println!("{like:.1} dB");
    assert!(like > ALIKE, "{like} dB");
    assert!(alike(&found, &expected[3]) < 25.0);
}

/// Operates the page of a run as a user does, and puts what came of it into the title.
const USE: &str = r#"
const told = [], check = (name, good) => { document.title = 'after: ' + name; if (!good) told.push(name); };
// The browser's clock stands still while an answer is waited for, and runs ahead else.
const until = async (is) => {
  for (let k = 0; k < 5000 && !is(); k++) { await look(); await new Promise((r) => setTimeout(r, 1)); }
  return is();
};
const key = (code) => dispatchEvent(new KeyboardEvent('keydown', { code, key: code }));
globalThis.confirm = () => true;
(async () => {
  check('begins', await until(() => run && run.iteration > 0 && shown.url && !busy));
  check('open', !$('run').hidden && $('message').hidden);
  check('curves', await until(() => curves.loss.length > 0 && $('curve-loss').textContent.includes('0.')));
  $('pause').click();
  check('pauses', await until(() => run.state === 'paused' && $('pause').textContent === 'Continue'));
  const at = run.iteration;
  $('checkpoint').click();
  check('saves', await until(() => run.saved === at && $('saved').textContent.includes('checkpoint')));
  const url = shown.url, before = [...view.center];
  canvas.setPointerCapture = () => {};
  const drag = (type, x, more) => canvas.dispatchEvent(new PointerEvent(type, { pointerId: 1, clientX: x, clientY: 200, ...more }));
  drag('pointerdown', 200); drag('pointermove', 260, { buttons: 1 }); drag('pointerup', 260);
  check('moves', moved && Math.hypot(...add(view.center, before, -1)) > 0.01);
  check('shows', await until(() => shown.url !== url && !busy && $('notice').hidden));
  key('KeyR'); key('KeyM'); check('depth', await until(() => shown.url.includes('mode=depth')));
  key('KeyM'); check('error', await until(() => shown.url.includes('mode=error') && $('notice').hidden));
  key('KeyC'); check('photo', await until(() => !$('photo').hidden && $('picture').naturalWidth > 0));
  $('pause').click();
  check('goes on', await until(() => run.state === 'training' && run.iteration > at));
  $('stop').click();
  check('stops', await until(() => run.state === 'stopping'));
  document.title = told.length ? 'failed: ' + told : 'all as told';
})();
"#;

/// Passes a page on with a script at its end, and everything else as it is.
fn pass(listener: &TcpListener, client: &Client, over: &AtomicBool) {
    std::thread::scope(|scope| {
        for stream in listener.incoming() {
            if over.load(Ordering::Relaxed) {
                return;
            }
            let mut stream = stream.unwrap();
            scope.spawn(move || {
                let mut head = Vec::new();
                let mut byte = [0];
                while !head.ends_with(b"\r\n\r\n") && stream.read(&mut byte).unwrap_or(0) > 0 {
                    head.push(byte[0]);
                }
                let head = String::from_utf8(head).unwrap();
                let Some(line) = head.lines().next().filter(|l| l.contains(' ')) else {
                    return;
                };
                let request = format!("{line}\r\nConnection: close\r\n\r\n");
                let Some(mut answer) = client.send(request.as_bytes()) else {
                    return;
                };
                if line.starts_with("GET /?") {
                    let html = answer.text().replacen(
                        "begin();\n</script>",
                        &format!("begin();\n{USE}</script>"),
                        1,
                    );
                    answer.body = html.into_bytes();
                }
                let length = answer.body.len();
                let (first, rest) = answer.head.split_once("Content-Length: ").unwrap();
                let rest = rest.split_once("\r\n").unwrap().1;
                let head = format!("{first}Content-Length: {length}\r\n{rest}\r\n\r\n");
                let _ = stream.write_all(&[head.as_bytes(), &answer.body].concat());
            });
        }
    });
}

fn run_seen(browser: &Path, dir: &Path) -> String {
    let (mut run, client) = watched(&dir.join("run"), 1_000_000);
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let (stop, over) = (AtomicBool::new(false), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let passing = scope.spawn(|| pass(&listener, &client, &over));
        let visitor = scope.spawn(|| {
            let url = format!("http://127.0.0.1:{port}/?token={}", client.token);
            let dom = visit(browser, dir, &url, &["--dump-dom"]);
            stop.store(true, Ordering::Relaxed);
            dom
        });
        let driven = run.drive(&stop, |_| ()).map(|_| ());
        assert!(matches!(driven, Err(Error::Interrupted)));
        let dom = visitor.join().unwrap();
        over.store(true, Ordering::Relaxed);
        drop(std::net::TcpStream::connect(("127.0.0.1", port)));
        passing.join().unwrap();
        dom
    })
}

#[test]
fn the_page_of_a_run_does_as_it_is_told() {
    let Some(browser) = browser() else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let dom = run_seen(&browser, dir.path());
    assert_eq!(title(&dom), "all as told");
}
