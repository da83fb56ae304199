//! HTTP/1.1 as far as a page on this machine needs it: requests without bodies, answers of known length, connections that stay open.
//! Everything that is read or waited for has a bound.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

/// Largest request line with its headers, bytes.
pub const MAX_HEAD: usize = 8 << 10;

/// Largest number of headers.
const MAX_HEADERS: usize = 64;

/// Longest time from the first byte of a request to the end of its headers, and for an answer to be taken.
const PATIENCE: Duration = Duration::from_secs(10);

/// Longest time that a connection stays open without a request.
const IDLE: Duration = Duration::from_secs(30);

/// Headers of every answer: nothing is kept, and nothing but what the page says may be loaded.
const ALWAYS: &str = "Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\nCross-Origin-Resource-Policy: same-origin\r\n";

/// Methods that are answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Method {
    Get,
    Post,
}

/// A request: its parts as they were sent, nothing decoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Request {
    pub method: Method,
    pub path: String,
    pub query: Vec<(String, String)>,
    /// True if the connection ends with it.
    pub last: bool,
}

impl Request {
    /// Value of a key of the query.
    pub fn value(&self, key: &str) -> Option<&str> {
        let mut pairs = self.query.iter();
        pairs.find(|(k, _)| k == key).map(|(_, v)| v.as_str())
    }
}

/// An answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Answer {
    pub status: u16,
    /// Media type of the body.
    pub kind: &'static str,
    /// Content-Security-Policy, for pages.
    pub policy: Option<String>,
    pub body: Vec<u8>,
}

impl Answer {
    /// An answer with a body.
    pub fn of(kind: &'static str, body: Vec<u8>) -> Self {
        Self {
            status: 200,
            kind,
            policy: None,
            body,
        }
    }

    /// An answer in words: of status 200, or a refusal.
    pub fn words(status: u16, text: &str) -> Self {
        Self {
            status,
            ..Self::of(
                "text/plain; charset=utf-8",
                format!("{text}\n").into_bytes(),
            )
        }
    }
}

fn reason(status: u16) -> &'static str {
    match status {
        200 => "OK",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        408 => "Request Timeout",
        409 => "Conflict",
        413 => "Content Too Large",
        431 => "Request Header Fields Too Large",
        _ => "Service Unavailable",
    }
}

/// A connection, and what has been read of its next request.
pub(super) struct Connection {
    stream: TcpStream,
    read: Vec<u8>,
}

impl Connection {
    pub fn new(stream: TcpStream) -> std::io::Result<Self> {
        stream.set_nodelay(true)?;
        Ok(Self {
            stream,
            read: Vec::new(),
        })
    }

    /// The next request, or the answer to one that is none, with which the connection is to end; `None` once the connection is at its
    /// end.
    pub fn request(&mut self) -> Option<Result<Request, Answer>> {
        let mut begun = (!self.read.is_empty()).then(Instant::now);
        loop {
            if let Some(parsed) = parse(&mut self.read) {
                return Some(parsed);
            }
            if self.read.len() >= MAX_HEAD {
                let text = format!("more than {MAX_HEAD} bytes of headers");
                return Some(Err(Answer::words(431, &text)));
            }
            let late = || Some(Err(Answer::words(408, "the request took too long")));
            let wait = match begun {
                None => IDLE,
                Some(at) => match PATIENCE.checked_sub(at.elapsed()) {
                    Some(left) if !left.is_zero() => left,
                    _ => return late(),
                },
            };
            self.stream.set_read_timeout(Some(wait)).ok()?;
            let mut part = [0; 2048];
            match self.stream.read(&mut part) {
                Ok(0) => return None,
                Ok(n) => {
                    begun.get_or_insert_with(Instant::now);
                    self.read.extend_from_slice(&part[..n]);
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    return begun.and_then(|_| late());
                }
                Err(_) => return None,
            }
        }
    }

    /// Sends an answer; `last` if the connection ends with it.
    pub fn answer(&mut self, answer: &Answer, last: bool) -> std::io::Result<()> {
        let policy = answer.policy.iter();
        let policy: String = policy
            .map(|p| format!("Content-Security-Policy: {p}\r\n"))
            .collect();
        let head = format!(
            "HTTP/1.1 {} {}\r\nContent-Type: {}\r\nContent-Length: {}\r\nConnection: {}\r\n{ALWAYS}{policy}\r\n",
            answer.status,
            reason(answer.status),
            answer.kind,
            answer.body.len(),
            if last { "close" } else { "keep-alive" },
        );
        let whole = [head.as_bytes(), &answer.body].concat();
        let (begun, mut rest) = (Instant::now(), whole.as_slice());
        while !rest.is_empty() {
            let left = PATIENCE.checked_sub(begun.elapsed());
            let left = left.filter(|left| !left.is_zero());
            let left = left.ok_or(ErrorKind::TimedOut)?;
            self.stream.set_write_timeout(Some(left))?;
            match self.stream.write(rest) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(n) => rest = &rest[n..],
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }

    /// Ends the connection. What was sent and not read would make the system throw the answer away: some of it is read.
    pub fn end(mut self) {
        let _ = self.stream.shutdown(Shutdown::Write);
        let _ = self
            .stream
            .set_read_timeout(Some(Duration::from_millis(200)));
        let mut rest = [0; 4096];
        for _ in 0..64 {
            if !matches!(self.stream.read(&mut rest), Ok(n) if n > 0) {
                break;
            }
        }
    }
}

/// Takes a request off the bytes that were read; `None` if there is none yet.
fn parse(read: &mut Vec<u8>) -> Option<Result<Request, Answer>> {
    let wrong = |status: u16, text: &str| Some(Err(Answer::words(status, text)));
    let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
    let mut head = httparse::Request::new(&mut headers);
    let length = match head.parse(read) {
        Ok(httparse::Status::Complete(length)) => length,
        Ok(httparse::Status::Partial) => return None,
        Err(httparse::Error::TooManyHeaders) => return wrong(431, "too many headers"),
        Err(error) => return wrong(400, &format!("not an HTTP request: {error}")),
    };
    let of = |name: &'static str| {
        let all = head.headers.iter();
        all.filter(move |h| h.name.eq_ignore_ascii_case(name))
    };
    let body = of("content-length").any(|h| h.value != b"0");
    if body || of("transfer-encoding").next().is_some() {
        return wrong(413, "a request has no body here");
    }
    let closes = of("connection").any(|h| h.value.eq_ignore_ascii_case(b"close"));
    let method = match head.method {
        Some("GET") => Method::Get,
        Some("POST") => Method::Post,
        _ => return wrong(405, "GET or POST expected"),
    };
    let (path, query) = head.path.map_or(("", ""), |target| {
        target.split_once('?').unwrap_or((target, ""))
    });
    let pair = |text: &str| {
        let (key, value) = text.split_once('=').unwrap_or((text, ""));
        (key.to_owned(), value.to_owned())
    };
    let request = Request {
        method,
        path: path.to_owned(),
        query: query.split('&').map(pair).collect(),
        last: closes || head.version != Some(1),
    };
    read.drain(..length);
    Some(Ok(request))
}
