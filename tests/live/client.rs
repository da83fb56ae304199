//! A visitor of the page.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use image::RgbImage;
use serde_json::Value;

/// Who knows the port and the token.
#[derive(Clone)]
pub struct Client {
    pub port: u16,
    pub token: String,
}

/// An answer: its status, its head and its body.
pub struct Answer {
    pub status: u16,
    pub head: String,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn text(&self) -> String {
        String::from_utf8(self.body.clone()).unwrap()
    }

    pub fn json(&self) -> Value {
        assert_eq!(self.status, 200, "{}", self.text());
        serde_json::from_slice(&self.body).unwrap()
    }

    /// The picture of the body, which is a JPEG file.
    pub fn picture(&self) -> RgbImage {
        assert_eq!(self.status, 200, "{}", self.text());
        assert!(self.head.contains("Content-Type: image/jpeg"));
        let format = image::ImageFormat::Jpeg;
        let picture = image::load_from_memory_with_format(&self.body, format);
        picture.unwrap().to_rgb8()
    }
}

/// Reads what a server sends: an answer of its length, or all until it ends.
pub fn read(stream: &mut TcpStream) -> Option<Answer> {
    let mut bytes = Vec::new();
    let mut part = [0; 4096];
    loop {
        if let Some(at) = bytes.windows(4).position(|w| w == b"\r\n\r\n") {
            let head = String::from_utf8(bytes[..at].to_vec()).unwrap();
            let length = head.split("Content-Length: ").nth(1).unwrap();
            let length: usize = length.lines().next().unwrap().parse().unwrap();
            let status = head[9..12].parse().unwrap();
            if bytes.len() >= at + 4 + length {
                let body = bytes[at + 4..at + 4 + length].to_vec();
                return Some(Answer { status, head, body });
            }
        }
        match stream.read(&mut part) {
            Ok(n) if n > 0 => bytes.extend_from_slice(&part[..n]),
            _ => return None,
        }
    }
}

impl Client {
    /// Who has read an address that the program printed.
    pub fn of(url: &str) -> Self {
        let rest = url.strip_prefix("http://127.0.0.1:").unwrap();
        let (port, token) = rest.split_once("/?token=").unwrap();
        assert_eq!(token.len(), 32);
        Self {
            port: port.parse().unwrap(),
            token: token.to_owned(),
        }
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        let patience = Some(Duration::from_secs(120));
        stream.set_read_timeout(patience).unwrap();
        stream
    }

    /// Sends bytes as they are; the answer, if there is one.
    pub fn send(&self, bytes: &[u8]) -> Option<Answer> {
        let mut stream = self.connect();
        // The server may have refused before everything was sent.
        let _ = stream.write_all(bytes);
        read(&mut stream)
    }

    pub fn request(&self, method: &str, path: &str, query: &str) -> Answer {
        let token = &self.token;
        let text = format!(
            "{method} {path}?token={token}&{query} HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"
        );
        self.send(text.as_bytes()).unwrap()
    }

    pub fn get(&self, path: &str, query: &str) -> Answer {
        self.request("GET", path, query)
    }

    pub fn post(&self, path: &str) -> Answer {
        self.request("POST", path, "")
    }
}
