//! The commands, as a user types them.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::Value;

use super::client::Client;
use crate::cli::{done, mhsplat, program, room, stderr, text};
use crate::viewer::browser::alike;

/// PSNR between a picture and the render that it is of at least, dB: what JPEG costs.
const ALIKE: f64 = 30.0;

/// A `view` that runs until it is dropped.
struct Viewing(Child);

impl Drop for Viewing {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Begins to view a scene.
fn viewing(args: &[&str]) -> (Viewing, Client) {
    let mut child = program()
        .arg("view")
        .args(args)
        .args(["--port", "0"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let viewing = Viewing(child);
    let first = lines.next().unwrap().unwrap();
    let client = Client::of(first.strip_prefix("view: ").unwrap());
    let (port, second) = (client.port, lines.next().unwrap().unwrap());
    assert!(
        second.contains(&format!("ssh -L {port}:127.0.0.1:{port} ")),
        "{second}"
    );
    (viewing, client)
}

fn meta(client: &Client) -> Value {
    crate::viewer::pages::meta(&client.get("/", "").text())
}

#[test]
fn view_shows_what_render_does() {
    let dir = tempfile::tempdir().unwrap();
    let [run, images] = ["run", "images"].map(|name| dir.path().join(name));
    let small = ["--iterations", "80", "--max-size", "64", "--view", "0"];
    let room = room();
    let train = [&["train", &room, "-o", text(&run)], &small[..]].concat();
    let trained = mhsplat(&train);
    let said = stderr(&trained);
    assert!(trained.status.success(), "{said}");
    assert!(
        said.contains("view: http://127.0.0.1:") && said.contains("ssh -L "),
        "{said}"
    );
    done(&["render", text(&run), "--held-out", "-o", text(&images)]);
    let (mut viewing, client) = viewing(&[text(&run)]);
    let meta = meta(&client);
    let camera = &meta["cameras"][1];
    assert!(camera["held_out"] == true && camera["psnr"].is_number());
    let name = Path::new(camera["name"].as_str().unwrap());
    let file = images.join(name.with_extension("png").file_name().unwrap());
    let render = image::open(file).unwrap().to_rgb8();
    let (w, h) = render.dimensions();
    let list = |key: &str| {
        let values = camera[key].as_array().unwrap().iter();
        let values: Vec<String> = values.map(ToString::to_string).collect();
        format!("{key}={}", values.join(","))
    };
    let spelt = [list("lens"), list("rotation"), list("center")].join("&");
    for of in ["view=1", &spelt] {
        let query = format!("{of}&width={w}&height={h}");
        let like = alike(&client.get("/frame", &query).picture(), &render);
        println!("{like:.1} dB");
        assert!(like > ALIKE, "{like} dB");
    }
    let other = client.get("/frame", &format!("view=3&width={w}&height={h}"));
    assert!(alike(&other.picture(), &render) < 25.0);
    let photo = client
        .get("/photo", &format!("view=1&width={w}&height={h}"))
        .picture();
    assert!(alike(&photo, &render) > 10.0);
    for mode in ["depth", "error"] {
        let query = format!("view=1&mode={mode}&width={w}&height={h}");
        assert_eq!(client.get("/frame", &query).picture().dimensions(), (w, h));
    }
    // Ctrl-C is its end.
    #[cfg(unix)]
    {
        let id = viewing.0.id().to_string();
        let sent = Command::new("kill").args(["-INT", &id]).status().unwrap();
        assert!(sent.success());
        assert_eq!(viewing.0.wait().unwrap().code(), Some(0));
    }
}

#[test]
fn a_scene_file_is_seen_from_around() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("a.ply");
    let splats = crate::viewer::pages::scene(500, 1);
    mhsplat::scene::ply::write(&file, &splats, &mhsplat::capture::Frame::IDENTITY).unwrap();
    let (_viewing, client) = viewing(&[text(&file)]);
    let meta = meta(&client);
    assert_eq!(meta["cameras"].as_array().unwrap().len(), 8);
    assert_eq!(meta["cameras"][0]["photo"], Value::Null);
    let picture = client.get("/frame", "view=7&width=60&height=40").picture();
    assert!(picture.pixels().any(|p| p.0.iter().any(|v| *v > 40)));
    assert_eq!(client.get("/photo", "view=0&width=9&height=9").status, 404);
    let error = client.get("/frame", "mode=error&view=0&width=9&height=9");
    assert_eq!(error.status, 404);
}

#[test]
fn mistakes_are_said() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let room = room();
    let (room, run) = (room.as_str(), text(&run));
    for (args, said) in [
        (
            &["train", room, "-o", run, "--view", &port][..],
            "is in use on this machine",
        ),
        (&["train", "--view", room, "-o", run], "put --view last"),
        (&["view", room, "--port", "0"], "holds no scene.ply"),
        (&["view", room, "--port", "70000"], "70000"),
        (&["eval", run], "is not there"),
        (&["render", run, "-o", run], "is not there"),
    ] {
        let output = mhsplat(args);
        let found = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {found}");
        assert!(found.contains(said), "{args:?}: {found}");
    }
    assert!(!Path::new(run).exists());
    // Of a page that nobody has asked for nothing is said.
    let mut quiet = String::new();
    let mut child = program()
        .args([
            "train",
            room,
            "-o",
            run,
            "--iterations",
            "5",
            "--max-size",
            "32",
        ])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut pipe = child.stderr.take().unwrap();
    pipe.read_to_string(&mut quiet).unwrap();
    assert!(
        child.wait().unwrap().success() && !quiet.contains("http"),
        "{quiet}"
    );
}
