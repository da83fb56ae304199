//! The page in a browser whose clock runs as it does for a user, operated by a script that a proxy adds to it.

use std::collections::HashMap;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

use base64::Engine;
use image::RgbImage;

use super::client::{Client, read};
use crate::viewer::browser::headless;

/// Longest time for a page to be operated.
const PATIENCE: Duration = Duration::from_secs(180);

/// Functions for scripts: `check` notes a fault, `until` waits for something on the page, `keep` hands over a picture of the canvas.
const WORDS: &str = r#"
const faults = [], pause = (ms) => new Promise((r) => setTimeout(r, ms));
const post = (path, body) => fetch(path, { method: 'POST', body });
const check = (name, good) => { if (!good) faults.push(name); };
const until = async (name, is) => {
  for (let k = 0; k < PATIENCE / 25; k++) { if (is()) return; await pause(25); }
  throw Error(name);
};
const key = (code) => dispatchEvent(new KeyboardEvent('keydown', { code, key: code }));
const choose = (mode) => { $('shown').value = mode; $('shown').dispatchEvent(new Event('change')); };
const keep = (name) => post('kept/' + name, canvas.toDataURL('image/png'));
const use = async (all) => {
  try { await all(); } catch (error) { faults.push('never ' + error.message); }
  await post('told', faults.join() || 'all as told');
};
"#;

/// Result of operating a page.
pub struct Told {
    /// The faults that the script found, or `all as told`.
    pub verdict: String,
    /// The pictures that it kept, by name.
    pub kept: HashMap<String, RgbImage>,
}

/// Something that the script sends to the test: a path and a text.
type Word = (String, String);

/// Changes to a page: texts and what comes in their places.
pub type Changes<'a> = [(&'a str, &'a str)];

/// Opens the page of a server with an address's part behind #, changed, and has a script operate it; conditions of the script are waited
/// for no longer than `seconds`.
pub fn operate(
    (browser, dir): (&Path, &Path),
    (client, hash): (&Client, &str),
    (script, seconds): (&str, u32),
    changes: &Changes<'_>,
) -> Told {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let words = WORDS.replace("PATIENCE", &(1000 * seconds).to_string());
    let script = format!("(() => {{{words}\n{script}}})();");
    let (to, said) = channel();
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for stream in listener.incoming() {
                if over.load(Ordering::Relaxed) {
                    return;
                }
                let (mut stream, to, script) = (stream.unwrap(), to.clone(), &script);
                scope.spawn(move || answer(&mut stream, client, &to, script, changes));
            }
        });
        let mut child = headless(browser, dir)
            .arg("--remote-debugging-port=0")
            .arg(format!(
                "http://127.0.0.1:{port}/?token={}#{hash}",
                client.token
            ))
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        let mut kept = HashMap::new();
        let verdict = loop {
            let Ok((path, text)) = said.recv_timeout(PATIENCE) else {
                break "nothing is said".to_owned();
            };
            match path.strip_prefix("/kept/") {
                Some(name) => kept.insert(name.to_owned(), picture(&text)),
                None => break text,
            };
        };
        let _ = child.kill();
        let _ = child.wait();
        over.store(true, Ordering::Relaxed);
        drop(TcpStream::connect(("127.0.0.1", port)));
        Told { verdict, kept }
    })
}

/// The picture of a data URI.
fn picture(uri: &str) -> RgbImage {
    let text = uri.strip_prefix("data:image/png;base64,").unwrap();
    let png = base64::engine::general_purpose::STANDARD.decode(text);
    image::load_from_memory(&png.unwrap()).unwrap().to_rgb8()
}

/// Passes a request on to the server, and hears what the script says.
fn answer(
    stream: &mut TcpStream,
    client: &Client,
    to: &Sender<Word>,
    script: &str,
    changes: &Changes<'_>,
) {
    let Some((line, body)) = request(stream) else {
        return;
    };
    let (method, rest) = line.split_once(' ').unwrap();
    let target = rest.split(' ').next().unwrap();
    let (head, body) = if target == "/told" || target.starts_with("/kept/") {
        // The test may have ended.
        let _ = to.send((target.to_owned(), body));
        ("HTTP/1.1 200 OK".to_owned(), Vec::new())
    } else {
        let sent = format!("{method} {target} HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n");
        // The server may have ended: the browser gets no answer, either.
        let server = TcpStream::connect(("127.0.0.1", client.port)).ok();
        let answered = server.and_then(|mut server| {
            server.write_all(sent.as_bytes()).ok()?;
            read(&mut server)
        });
        let Some(answer) = answered else {
            return;
        };
        let body = match target.starts_with("/?") {
            true => changed(answer.text(), script, changes).into_bytes(),
            false => answer.body,
        };
        let lines = answer.head.lines();
        let kept =
            lines.filter(|l| !l.starts_with("Content-Length") && !l.starts_with("Connection"));
        (kept.collect::<Vec<_>>().join("\r\n"), body)
    };
    let length = body.len();
    let head = format!("{head}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n");
    // The browser may have ended.
    let _ = stream.write_all(&[head.as_bytes(), &body].concat());
}

/// The first line and the body of a request.
fn request(stream: &mut TcpStream) -> Option<(String, String)> {
    let (mut bytes, mut part) = (Vec::new(), [0; 4096]);
    loop {
        let text = String::from_utf8_lossy(&bytes);
        if let Some((head, body)) = text.split_once("\r\n\r\n") {
            let length = head.to_ascii_lowercase();
            let length = length.split("content-length: ").nth(1);
            let length: usize = length.map_or(0, |l| l.lines().next().unwrap().parse().unwrap());
            if body.len() >= length {
                return Some((head.lines().next()?.to_owned(), body.to_owned()));
            }
        }
        match stream.read(&mut part) {
            Ok(n) if n > 0 => bytes.extend_from_slice(&part[..n]),
            _ => return None,
        }
    }
}

/// The page with changes and a script at its end, which its policy lets run.
fn changed(mut page: String, script: &str, changes: &Changes<'_>) -> String {
    for (right, wrong) in changes {
        assert!(page.contains(right), "{right}");
        page = page.replace(right, wrong);
    }
    let (_, nonce) = page.split_once("<script nonce=\"").unwrap();
    let nonce = nonce.split_once('"').unwrap().0;
    let own = format!("<script nonce=\"{nonce}\">{script}</script></body>");
    page.replace("</body>", &own)
}
