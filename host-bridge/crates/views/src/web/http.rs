//! Answers one request with a compiled-in file, the live WebSocket, or a refusal with its reason.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::gate::{Claims, Refused};
use super::server::Seat;
use super::{Shared, client};

/// Longest head of a request.
const HEAD_MAX: usize = 8192;
const HEADERS_MAX: usize = 64;

/// Time after which a client without a request is disconnected.
const PATIENCE: Duration = Duration::from_secs(5);

/// Permits no external or inline content, and no embedding in frames.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// Path, type and content of all files.
const FILES: [(&str, &str, &str); 9] = [
    ("/", HTML, include_str!("page/index.html")),
    ("/page.css", "text/css; charset=utf-8", include_str!("page/page.css")),
    ("/icon.svg", "image/svg+xml", include_str!("page/icon.svg")),
    ("/main.js", SCRIPT, include_str!("page/main.js")),
    ("/link.js", SCRIPT, include_str!("page/link.js")),
    ("/panels.js", SCRIPT, include_str!("page/panels.js")),
    ("/robot.js", SCRIPT, include_str!("page/robot.js")),
    ("/draw.js", SCRIPT, include_str!("page/draw.js")),
    ("/matrix.js", SCRIPT, include_str!("page/matrix.js")),
];

/// Answers the only request of a connection.
pub(super) fn serve(stream: TcpStream, place: &Seat, shared: &Shared) {
    with_request(stream, |stream, request, rest| {
        place.heard();
        page_or_file(stream, &request, rest, (place, shared));
    });
}

/// One request.
pub struct Request<'a, 'h> {
    pub head: &'a httparse::Request<'h, 'a>,
    pub path: &'a str,
    pub claims: Claims<'a>,
}

/// Reads a request and passes it to `then` with the bytes after it.
/// If there is no request, the answer contains the reason.
pub fn with_request(mut stream: TcpStream, then: impl FnOnce(TcpStream, Request<'_, '_>, Vec<u8>)) {
    // If a socket refuses its settings, it is broken, and reading from it fails too.
    let _ = stream.set_nodelay(true);
    let _ = stream.set_write_timeout(Some(PATIENCE));
    let mut buffer = Vec::new();
    let Some(length) = read_head(&mut stream, &mut buffer) else {
        answer(&mut stream, "431 Request Header Fields Too Large", "text/plain", "too long a request", true);
        return;
    };
    if length == 0 {
        return;
    }
    let rest = buffer.split_off(length);
    let mut headers = [httparse::EMPTY_HEADER; HEADERS_MAX];
    let mut head = httparse::Request::new(&mut headers);
    let Ok(httparse::Status::Complete(_)) = head.parse(&buffer) else {
        answer(&mut stream, "400 Bad Request", "text/plain", "no request that this server reads", true);
        return;
    };
    let (path, query) = split_target(head.path.unwrap_or_default());
    let claims = Claims {
        host: header(&head, "host"),
        origin: header(&head, "origin"),
        token: query.split('&').find_map(|pair| pair.strip_prefix("token=")),
    };
    then(stream, Request { head: &head, path, claims }, rest);
}

/// Says no.
pub fn refuse(stream: &mut TcpStream, refused: Refused) {
    answer(stream, "403 Forbidden", "text/plain; charset=utf-8", &format!("{refused}\n"), true);
}

fn page_or_file(
    mut stream: TcpStream,
    request: &Request<'_, '_>,
    rest: Vec<u8>,
    (place, shared): (&Seat, &Shared),
) {
    let Request { head, path, claims } = request;
    if *path == "/live" {
        match (shared.gate.live(claims), client::accept(head)) {
            (Err(refused), _) => refuse(&mut stream, refused),
            (Ok(()), None) => {
                answer(&mut stream, "426 Upgrade Required", "text/plain", "a WebSocket\n", true)
            }
            (Ok(()), Some(response)) => {
                if stream.write_all(&response).is_ok() {
                    client::run(stream, rest, place, shared);
                }
            }
        }
        return;
    }
    let with_body = match head.method {
        Some("GET") => true,
        Some("HEAD") => false,
        _ => {
            answer(&mut stream, "405 Method Not Allowed", "text/plain", "GET or HEAD\n", true);
            return;
        }
    };
    let Some((_, kind, content)) = FILES.iter().find(|(known, ..)| known == path) else {
        answer(&mut stream, "404 Not Found", "text/plain", "there is only the page at /\n", with_body);
        return;
    };
    match if *path == "/" { shared.gate.page(claims) } else { shared.gate.file(claims) } {
        Ok(()) => answer(&mut stream, "200 OK", kind, content, with_body),
        Err(refused) => refuse(&mut stream, refused),
    }
}

/// Reads up to the empty line. Returns the head's length:
/// 0 without a request, `None` if the head is too long.
fn read_head(stream: &mut TcpStream, buffer: &mut Vec<u8>) -> Option<usize> {
    let until = Instant::now() + PATIENCE;
    let mut piece = [0; 2048];
    while buffer.len() < HEAD_MAX {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() || stream.set_read_timeout(Some(left)).is_err() {
            return Some(0);
        }
        match stream.read(&mut piece) {
            Ok(0) | Err(_) => return Some(0),
            Ok(count) => buffer.extend_from_slice(&piece[..count]),
        }
        if let Some(end) = buffer.windows(4).position(|four| four == b"\r\n\r\n") {
            return Some(end + 4);
        }
    }
    None
}

/// Returns a header that occurs exactly once.
pub fn header<'a>(head: &httparse::Request<'_, 'a>, name: &str) -> Option<&'a str> {
    let mut found = head.headers.iter().filter(|h| h.name.eq_ignore_ascii_case(name));
    let only = found.next().filter(|_| found.next().is_none())?;
    Some(std::str::from_utf8(only.value).unwrap_or_default())
}

fn split_target(target: &str) -> (&str, &str) {
    target.split_once('?').unwrap_or((target, ""))
}

pub fn answer(stream: &mut TcpStream, status: &str, kind: &str, content: &str, with_body: bool) {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\
         Cache-Control: no-store\r\nContent-Security-Policy: {POLICY}\r\nX-Content-Type-Options: nosniff\r\n\
         Referrer-Policy: no-referrer\r\nCross-Origin-Resource-Policy: same-origin\r\n\r\n",
        content.len()
    );
    let body = if with_body { content.as_bytes() } else { &[] };
    // A client that disconnects during an answer does not need the rest of it.
    let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(body));
}
