//! Requests, good and bad, of a scene that needs no device.

use std::io::Write;
use std::time::{Duration, Instant};

use mhsplat::Result;
use mhsplat::capture::Camera;
use mhsplat::capture::photo::{Alpha, Photo};
use mhsplat::pipeline::forward::{Quantity, Rendered};
use mhsplat::run::live::http::MAX_HEAD;
use mhsplat::run::live::{Door, LivePage, Scenery, Server};

use super::client::{Client, read};
use crate::viewer::pages::views;

/// Colours of a painted scene.
const COLOR: [f32; 3] = [0.2, 0.6, 0.8];

/// A wall of one colour two units before every camera; the first view has a grey photo.
pub struct Painted;

impl Scenery for Painted {
    fn render(&mut self, camera: &Camera, quantity: Quantity) -> Result<Rendered> {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let value = |c: usize| match quantity {
            Quantity::Color => COLOR[c],
            Quantity::Depth => 2.0,
        };
        Ok(Rendered {
            width,
            height,
            rgb: (0..3)
                .flat_map(|c| std::iter::repeat_n(value(c), width * height))
                .collect(),
            transmittance: vec![0.0; width * height],
        })
    }

    fn photo(&mut self, view: usize) -> Result<Option<(Camera, Photo)>> {
        let camera = views()[view].camera;
        let bytes = vec![128; (3 * camera.width * camera.height) as usize];
        let (w, h) = (camera.width, camera.height);
        let photo = Photo::from_interleaved(w, h, Alpha::None, &bytes)?;
        Ok((view == 0).then_some((camera, photo)))
    }

    fn background(&self) -> [f32; 3] {
        [0.0; 3]
    }

    fn reach(&self) -> f64 {
        1.0
    }
}

pub fn page(training: bool) -> LivePage {
    LivePage {
        title: "<made> up".into(),
        views: views(),
        photos: true,
        training,
        largest: 512,
        gaussians: 3000,
        reach: 1.0,
    }
}

/// Serves a scene as long as somebody visits it.
pub fn serve<T: Send>(
    page: &LivePage,
    scenery: &mut dyn Scenery,
    visit: impl FnOnce(&Client) -> T + Send,
) -> T {
    let door = Door::open("--port", Some(0)).unwrap();
    let client = Client::of(&door.url());
    let server = Server::start(door, page).unwrap();
    std::thread::scope(|scope| {
        let visitor = scope.spawn(|| visit(&client));
        while !visitor.is_finished() {
            server.attend(scenery, Duration::from_millis(5));
        }
        visitor.join().unwrap()
    })
}

const CAMERA: &str = "lens=130,120,84.5,57&rotation=1,0,0,0,1,0,0,0,1&center=0,0,-2";

#[test]
fn pictures_are_those_that_are_asked_for() {
    serve(&page(false), &mut Painted, |client| {
        let all = client.get("/", "");
        assert_eq!(all.status, 200);
        let html = all.text();
        assert!(html.contains("&lt;made&gt; up") && !html.contains("<made>"));
        assert!(html.contains("id=\"shown\"") && !html.contains("id=\"wishes\""));
        assert!(
            all.head
                .contains("Content-Security-Policy: default-src 'none'; style-src 'nonce-")
        );
        // Nothing is loaded from elsewhere: this is a name.
        assert_eq!(html.matches("http").count(), 1);
        assert!(html.contains("'http://www.w3.org/2000/svg'"));
        let close = |a: &[u8; 3], b: [f32; 3]| {
            let mut pairs = a.iter().zip(b);
            pairs.all(|(a, b)| (f32::from(*a) - 255.0 * b).abs() < 4.0)
        };
        for query in ["view=2&mode=color", CAMERA] {
            let picture = client.get("/frame", &format!("{query}&width=70&height=50"));
            let picture = picture.picture();
            assert_eq!(picture.dimensions(), (70, 50));
            assert!(close(&picture.get_pixel(30, 20).0, COLOR));
        }
        let depth = client.get("/frame", &format!("{CAMERA}&mode=depth&width=70&height=50"));
        let depth = depth.picture().get_pixel(1, 1).0;
        let near = mhsplat::run::report::gallery::colormap(1.0 / 3.0);
        assert!(
            close(&depth, near.map(|v| f32::from(v) / 255.0)),
            "{depth:?}"
        );
        let at = client.get("/depth", &format!("{CAMERA}&width=70&height=50&at=69.5,0"));
        assert_eq!(at.json()["depth"], 2.0);
        let photo = client.get("/photo", "view=0&width=80&height=60").picture();
        assert_eq!(photo.dimensions(), (80, 60));
        assert!(close(&photo.get_pixel(9, 9).0, [128.0 / 255.0; 3]));
        let error = client.get("/frame", "mode=error&view=0&width=80&height=60");
        assert_eq!(error.picture().dimensions(), (80, 60));
        let none = client.get("/frame", "mode=births&view=0&width=80&height=60");
        assert_eq!(
            (none.status, html.contains("value=\"births\"")),
            (404, false)
        );
        for path in ["/photo", "/frame"] {
            let none = client.get(path, "mode=error&view=1&width=80&height=60");
            assert_eq!(none.status, 404, "{path}");
        }
        // Nothing is trained here.
        for path in ["/status", "/pause"] {
            assert!((404..=405).contains(&client.get(path, "").status));
        }
        assert_eq!(client.post("/stop").status, 404);
    });
}

#[test]
fn who_does_not_know_the_token_gets_nothing() {
    serve(&page(true), &mut Painted, |client| {
        let mut wrong = client.clone();
        let last = if client.token.ends_with('0') {
            "1"
        } else {
            "0"
        };
        let almost = format!("{}{last}", &client.token[..31]);
        for token in [
            "",
            "0",
            &almost,
            &client.token[..31],
            &format!("{}0", client.token),
        ] {
            wrong.token = token.to_owned();
            for path in [
                "/", "/frame", "/photo", "/depth", "/status", "/pause", "/nothing",
            ] {
                for method in ["GET", "POST"] {
                    let answer = wrong.request(method, path, "view=0&width=9&height=9");
                    assert_eq!(answer.status, 403, "{method} {path}");
                    assert!(!answer.text().contains(&client.token));
                }
            }
        }
        let none = client.send(b"GET / HTTP/1.1\r\n\r\n").unwrap();
        assert_eq!(none.status, 403);
        assert_eq!(client.get("/status", "").json()["state"], "training");
    });
}

#[test]
fn bad_requests_are_refused_and_the_server_lives_on() {
    serve(&page(true), &mut Painted, |client| {
        let token = &client.token;
        let line = |more: &str| format!("GET /?token={token} HTTP/1.1\r\n{more}\r\n");
        let long = "a".repeat(MAX_HEAD);
        let many = "A: b\r\n".repeat(100);
        let sent: Vec<(u16, Vec<u8>)> = vec![
            (
                400,
                b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n".to_vec(),
            ),
            (400, b"GET\r\n\r\n".to_vec()),
            (400, b"GET / HTTP/7.5\r\n\r\n".to_vec()),
            (400, b"GET /\xff\xfe\x00 HTTP/1.1\r\n\r\n".to_vec()),
            (400, line("no colon\r\n").into_bytes()),
            (405, b"BREW / HTTP/1.1\r\n\r\n".to_vec()),
            (405, b"OPTIONS * HTTP/1.1\r\n\r\n".to_vec()),
            (413, line("Content-Length: 7\r\n").into_bytes()),
            (413, line("Content-Length: x\r\n").into_bytes()),
            (413, line("Transfer-Encoding: chunked\r\n").into_bytes()),
            (431, line(&many).into_bytes()),
            (431, line(&format!("A: {long}\r\n")).into_bytes()),
            (431, format!("GET /{long}{long}").into_bytes()),
            (431, vec![b'G'; 1 << 20]),
        ];
        for (status, bytes) in &sent {
            let answer = client.send(bytes).unwrap();
            let shown = String::from_utf8_lossy(&bytes[..bytes.len().min(60)]);
            assert_eq!(answer.status, *status, "{shown:?}: {}", answer.text());
            assert!(answer.head.contains("Connection: close"));
        }
        for query in [
            "",
            "width=9",
            "width=0&height=9&view=0",
            "width=513&height=9&view=0",
            "width=9&height=99999999999&view=0",
            "width=-1&height=9&view=0",
            "width=9&height=9&view=6",
            "width=9&height=9&view=%30",
            "width=9&height=9&mode=sound&view=0",
            "width=9&height=9&mode=error",
            "width=9&height=9&lens=1,1,1&rotation=1,0,0,0,1,0,0,0,1&center=0,0,0",
            "width=9&height=9&lens=0,1,1,1&rotation=1,0,0,0,1,0,0,0,1&center=0,0,0",
            "width=9&height=9&lens=1,1,1,1&rotation=2,0,0,0,1,0,0,0,1&center=0,0,0",
            "width=9&height=9&lens=1,1,1,1&rotation=-1,0,0,0,1,0,0,0,1&center=0,0,0",
            "width=9&height=9&lens=1,1,1,1&rotation=1,0,0,0,1,0,0,0,1&center=0,NaN,0",
            "width=9&height=9&lens=1,1,1,1&rotation=1,0,0,0,1,0,0,0,1&center=0,1e300,0",
        ] {
            let answer = client.get("/frame", query);
            assert_eq!(answer.status, 400, "{query}: {}", answer.text());
        }
        assert_eq!(client.get("/status", "since=x").status, 400);
        assert_eq!(client.get("/pause", "").status, 405);
        assert_eq!(client.post("/frame").status, 405);
        assert_eq!(client.post("/everything").status, 404);
        // Two requests at once on one connection, and one byte by byte.
        let mut stream = client.connect();
        let two = format!("{}{}", line(""), line(""));
        stream.write_all(two.as_bytes()).unwrap();
        let (mut answers, mut part) = (Vec::new(), [0; 4096]);
        while String::from_utf8_lossy(&answers)
            .matches("HTTP/1.1 200")
            .count()
            < 2
        {
            let n = std::io::Read::read(&mut stream, &mut part).unwrap();
            assert!(n > 0);
            answers.extend_from_slice(&part[..n]);
        }
        let mut stream = client.connect();
        for byte in line("").into_bytes() {
            stream.write_all(&[byte]).unwrap();
        }
        assert_eq!(read(&mut stream).unwrap().status, 200);
        assert_eq!(client.get("/frame", "width=9&height=9&view=0").status, 200);
    });
}

#[test]
fn connections_are_counted() {
    serve(&page(false), &mut Painted, |client| {
        let idle: Vec<_> = (0..40).map(|_| client.connect()).collect();
        let begun = Instant::now();
        let refused = loop {
            let answer = client.send(b"GET / HTTP/1.1\r\n\r\n");
            if let Some(answer) = answer.filter(|a| a.status == 503) {
                break answer;
            }
            assert!(begun.elapsed() < Duration::from_secs(10));
        };
        assert!(refused.text().contains("connections"));
        drop(idle);
        while client
            .send(b"GET / HTTP/1.1\r\n\r\n")
            .is_none_or(|a| a.status != 403)
        {
            assert!(begun.elapsed() < Duration::from_secs(10));
        }
    });
}

#[test]
fn a_port_that_is_taken_is_said() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let error = Door::open("--port", Some(port)).unwrap_err().to_string();
    assert!(
        error.starts_with(&format!("--port: port {port} is in use")),
        "{error}"
    );
    // Without one there is always one.
    let doors = [None, None].map(|port| Door::open("--port", port).unwrap());
    assert_ne!(doors[0].port(), doors[1].port());
    assert_ne!(doors[0].url()[30..], doors[1].url()[30..]);
}
