//! [`Server`]: the page and its pictures on a port of this machine, for those who know the token.

use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, RgbImage, imageops};
use serde_json::json;

use crate::base::error::{Error, Result};
use crate::capture::Camera;
use crate::run::live::ask::{Ask, Reader};
use crate::run::live::desk::Desk;
use crate::run::live::http::{Answer, Connection, Method, Request};
use crate::run::live::page::LivePage;
use crate::run::live::studio::{Picture, Reply, Scenery};

/// Port that is tried where none is asked for, so that a tunnel can stay; any free one where it is taken.
pub const USUAL_PORT: u16 = 7878;

/// Largest number of connections at one time.
const MAX_CONNECTIONS: usize = 32;

/// Quality of the pictures, of 100.
const JPEG_QUALITY: u8 = 90;

/// A port of this machine that is listened to, and the token that its visitors must know.
#[derive(Debug)]
pub struct Door {
    listener: TcpListener,
    port: u16,
    token: String,
}

/// 128 random bits in hexadecimal digits.
fn secret() -> Result<String> {
    let mut bytes = [0; 16];
    let failed = |e: getrandom::Error| Error::io("random numbers", std::io::Error::other(e));
    getrandom::fill(&mut bytes).map_err(failed)?;
    Ok(bytes.iter().map(|b| format!("{b:02x}")).collect())
}

impl Door {
    /// Listens to a port, 0 for any that is free; without one to [`USUAL_PORT`], or any other if that is taken. `option` is the name of
    /// what asks for it.
    ///
    /// # Errors
    /// A port that is taken or not allowed.
    pub fn open(option: &str, port: Option<u16>) -> Result<Self> {
        let bind = |port: u16| TcpListener::bind((Ipv4Addr::LOCALHOST, port));
        let bound = match port {
            Some(port) => bind(port),
            None => bind(USUAL_PORT).or_else(|_| bind(0)),
        };
        let refused = |e: std::io::Error| {
            let port = port.unwrap_or(0);
            let what = match e.kind() {
                std::io::ErrorKind::AddrInUse => "is in use on this machine".to_owned(),
                _ => format!("cannot be had ({e})"),
            };
            Error::config(
                option,
                format!("port {port} {what}; give another one, or 0 for any that is free"),
            )
        };
        let listener = bound.map_err(refused)?;
        let address = listener.local_addr().map_err(refused)?;
        Ok(Self {
            listener,
            port: address.port(),
            token: secret()?,
        })
    }

    /// The port.
    #[must_use]
    pub fn port(&self) -> u16 {
        self.port
    }

    /// The address of the page.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}/?token={}", self.port, self.token)
    }
}

/// State that the threads share.
struct Shared {
    token: String,
    page: Answer,
    cameras: Vec<Camera>,
    largest: u32,
    training: bool,
    desk: Desk,
    connections: AtomicUsize,
    closed: AtomicBool,
}

/// The page and its pictures, sent until it is dropped.
pub struct Server {
    shared: Arc<Shared>,
    port: u16,
    acceptor: Option<JoinHandle<()>>,
}

impl Server {
    /// Begins to answer.
    ///
    /// # Errors
    /// No thread to be had.
    pub fn start(door: Door, page: &LivePage) -> Result<Self> {
        let Door {
            listener,
            port,
            token,
        } = door;
        let shared = Arc::new(Shared {
            page: page.answer(&token, &secret()?),
            token,
            cameras: page.cameras(),
            largest: page.largest,
            training: page.training,
            desk: Desk::default(),
            connections: AtomicUsize::new(0),
            closed: AtomicBool::new(false),
        });
        let theirs = shared.clone();
        let acceptor = std::thread::Builder::new()
            .name("page".into())
            .spawn(move || accept(&listener, &theirs))
            .map_err(|e| Error::io("a thread for the page", e))?;
        Ok(Self {
            shared,
            port,
            acceptor: Some(acceptor),
        })
    }

    /// Answers one question about a scene, after waiting for one no longer than that.
    pub fn attend(&self, scenery: &mut dyn Scenery, longest: Duration) {
        self.desk().wait(longest);
        self.desk().answer(scenery);
    }

    pub(super) fn desk(&self) -> &Desk {
        &self.shared.desk
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.closed.store(true, Ordering::Relaxed);
        self.shared.desk.close();
        // Wakes the thread that waits for visitors.
        let woken = TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)).is_ok();
        if let Some(acceptor) = self.acceptor.take().filter(|_| woken) {
            let _ = acceptor.join();
        }
    }
}

/// Gives every visitor a thread, or a word where there are too many.
fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    for stream in listener.incoming() {
        if shared.closed.load(Ordering::Relaxed) {
            return;
        }
        let Ok(stream) = stream else {
            // No descriptor is left: some will be.
            std::thread::sleep(Duration::from_millis(50));
            continue;
        };
        let Ok(mut connection) = Connection::new(stream) else {
            continue;
        };
        if shared.connections.fetch_add(1, Ordering::Relaxed) >= MAX_CONNECTIONS {
            let _ = connection.answer(&Answer::words(503, "too many connections"), true);
            shared.connections.fetch_sub(1, Ordering::Relaxed);
            continue;
        }
        let theirs = shared.clone();
        let begun = std::thread::Builder::new()
            .name("visitor".into())
            .spawn(move || {
                converse(connection, &theirs);
                theirs.connections.fetch_sub(1, Ordering::Relaxed);
            });
        if begun.is_err() {
            shared.connections.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

/// Answers the requests of a connection.
fn converse(mut connection: Connection, shared: &Shared) {
    while let Some(request) = connection.request() {
        let (answer, last) = match request {
            Ok(request) => {
                let last = request.last || shared.closed.load(Ordering::Relaxed);
                (answer(&request, shared), last)
            }
            Err(refusal) => (refusal, true),
        };
        if connection.answer(&answer, last).is_err() {
            return;
        }
        if last {
            break;
        }
    }
    connection.end();
}

/// Compares without telling by its time where the first difference is.
fn same(a: &str, b: &str) -> bool {
    let differing = a
        .bytes()
        .zip(b.bytes())
        .fold(0, |all, (a, b)| all | (a ^ b));
    a.len() == b.len() && differing == 0
}

/// The answer to a request.
fn answer(request: &Request, shared: &Shared) -> Answer {
    if !same(request.value("token").unwrap_or_default(), &shared.token) {
        let text = "the address of the page, with its token, is what the program printed";
        return Answer::words(403, text);
    }
    let reader = Reader {
        request,
        cameras: &shared.cameras,
        largest: shared.largest,
    };
    let training = shared.training;
    let path = request.path.as_str();
    let answered = match (request.method, path) {
        (Method::Get, "/") => return shared.page.clone(),
        (Method::Get, "/frame") => picture(reader.frame(), &reader, shared),
        (Method::Get, "/photo") => picture(reader.photo(), &reader, shared),
        (Method::Get, "/depth") => depth(reader.depth(), shared),
        (Method::Get, "/status") if training => status(request, shared),
        (Method::Post, _) if training && shared.desk.wish(path.trim_start_matches('/')) => {
            Ok(Answer::words(200, "as you wish"))
        }
        (Method::Post, "/" | "/frame" | "/photo" | "/depth") => {
            Err(Answer::words(405, "GET expected"))
        }
        (Method::Post, "/status") if training => Err(Answer::words(405, "GET expected")),
        (Method::Get, "/pause" | "/continue" | "/checkpoint" | "/stop") if training => {
            Err(Answer::words(405, "POST expected"))
        }
        _ => Err(Answer::words(404, "there is nothing of that name")),
    };
    answered.unwrap_or_else(|refusal| refusal)
}

type Answered = std::result::Result<Answer, Answer>;

fn unread(what: String) -> Answer {
    Answer::words(400, &what)
}

fn status(request: &Request, shared: &Shared) -> Answered {
    let since = request.value("since").map(str::parse).transpose();
    let since = since.map_err(|_| unread("since: an iteration expected".into()))?;
    let json = shared.desk.status(since);
    let json = json.ok_or_else(|| Answer::words(503, "the state cannot be told"))?;
    Ok(Answer::of("application/json", json))
}

fn depth(ask: std::result::Result<Ask, String>, shared: &Shared) -> Answered {
    let reply = shared.desk.ask(ask.map_err(unread)?)?;
    let depth = match reply {
        Reply::Depth(depth) => depth,
        _ => None,
    };
    let text = json!({ "depth": depth }).to_string();
    Ok(Answer::of("application/json", text.into_bytes()))
}

fn picture(
    ask: std::result::Result<Ask, String>,
    reader: &Reader<'_>,
    shared: &Shared,
) -> Answered {
    let (ask, size) = (ask.map_err(unread)?, reader.size().map_err(unread)?);
    let found = match shared.desk.ask(ask)? {
        Reply::Picture(picture) => encoded(picture, size),
        _ => {
            return Err(Answer::words(
                404,
                "there is no photo of this view, or no such thing of this scene, or not yet",
            ));
        }
    };
    let jpeg = found.ok_or_else(|| Answer::words(503, "the picture cannot be encoded"))?;
    Ok(Answer::of("image/jpeg", jpeg))
}

/// A picture of another size, if need be, as a JPEG file.
fn encoded(picture: Picture, [width, height]: [u32; 2]) -> Option<Vec<u8>> {
    let Picture {
        width: w,
        height: h,
        rgb,
    } = picture;
    let mut image = RgbImage::from_raw(w, h, rgb)?;
    if [w, h] != [width, height] {
        image = imageops::resize(&image, width, height, imageops::FilterType::Triangle);
    }
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY)
        .encode(image.as_raw(), width, height, ExtendedColorType::Rgb8)
        .ok()?;
    Some(jpeg)
}
