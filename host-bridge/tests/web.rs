//! Tests the web server with a browser's requests, foreign requests and misbehaving clients, on loopback sockets.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use host_bridge::bridge::Prompt;
use host_bridge::config::{Config, HandInput};
use host_bridge::engine::Engine;
use host_bridge::episodes::Mark;
use host_bridge::safety::State;
use host_bridge::web::{CONNECTIONS_MAX, IN_FLIGHT_MAX, INTERVAL, Web, WebError, WebOptions};
use serde_json::Value;
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

#[path = "support/moving.rs"]
mod moving;

use moving::{Robot, live as live_engine};

type Live = Engine<'static, Robot>;

/// Limit in wall-clock time, so that a test cannot hang forever.
const PATIENCE: Duration = Duration::from_secs(120);

fn any_port() -> WebOptions {
    WebOptions { port: 0, ..WebOptions::default() }
}

/// Returns the status and the body of the reply to a request with these headers.
fn ask(address: SocketAddr, request: &str, headers: &[(&str, &str)]) -> (String, String) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let headers: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    stream.write_all(format!("{request} HTTP/1.1\r\n{headers}\r\n").as_bytes()).unwrap();
    let mut answer = String::new();
    // A server that does not read all of an invalid request resets the connection after its reply.
    let _ = stream.read_to_string(&mut answer);
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    (head.to_owned(), body.to_owned())
}

fn open(web: &Web, origin: Option<&str>, query: &str) -> Result<WebSocket<TcpStream>, u16> {
    let stream = TcpStream::connect(web.address()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut request = format!("ws://{}/live{query}", web.address()).into_client_request().unwrap();
    if let Some(origin) = origin {
        request.headers_mut().insert("Origin", origin.parse().unwrap());
    }
    match tungstenite::client(request, stream) {
        Ok((socket, _)) => Ok(socket),
        Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response))) => {
            Err(response.status().as_u16())
        }
        Err(error) => panic!("{error}"),
    }
}

fn own_origin(web: &Web) -> String {
    format!("http://{}", web.address())
}

fn message(socket: &mut WebSocket<TcpStream>) -> Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            return serde_json::from_str(text.as_str()).unwrap();
        }
    }
}

/// Creates a session with keys for both hands, and its web page.
fn session() -> (Web, Live) {
    let web = Web::start(&any_port()).unwrap();
    let mut live = live_engine(&Config::default(), HandInput::Keyboard, HandInput::Keyboard);
    live.tap_mut().add(Box::new(web.watcher("a test\nsecond line")));
    for now_ms in 1..499 {
        live.advance(now_ms, [true; 2]);
    }
    publish_step(&mut live, 499);
    assert_eq!(live.bridge().safety().state(), State::Armed);
    (web, live)
}

/// Publishes a step whose state is sent to pages.
/// The number of earlier states that are sent depends on the machine's speed.
fn publish_step(live: &mut Live, now_ms: u64) {
    std::thread::sleep(INTERVAL);
    live.advance(now_ms, [true; 2]);
}

#[test]
fn a_page_marks_episodes_where_the_session_takes_marks() {
    for takes in [true, false] {
        let web = Web::start_with(&any_port(), takes).unwrap();
        let mut live = live_engine(&Config::default(), HandInput::Keyboard, HandInput::Keyboard);
        live.tap_mut().add(Box::new(web.watcher("a test")));
        publish_step(&mut live, 1);
        let mut page = open(&web, Some(&own_origin(&web)), "").unwrap();
        assert_eq!(message(&mut page)["marks"], takes);
        page.send(Message::text("mark again")).unwrap();
        let _ = page.send(Message::text("mark it"));
        // A message that no page sends ends the connection. By then, all earlier messages were read.
        while page.read().is_ok() {}
        let marks = web.marks();
        assert_eq!(marks(), takes.then_some(Mark::Again));
        assert_eq!(marks(), None);
    }
}

#[test]
fn a_page_is_told_what_the_wearer_is_asked_and_presses_the_button() {
    let web = Web::start(&any_port()).unwrap();
    let mut live = live_engine(&Config::default(), HandInput::Keyboard, HandInput::Keyboard);
    live.tap_mut().add(Box::new(web.watcher("a test")));
    let text = "show each gesture".to_owned();
    live.set_prompt(Some(Prompt { text, button: Some("show three of each") }));
    publish_step(&mut live, 1);
    let mut page = open(&web, Some(&own_origin(&web)), "").unwrap();
    assert_eq!(message(&mut page)["hello"], 1);
    let right = &message(&mut page)["state"]["right"];
    assert_eq!(right["prompt"]["text"], "show each gesture");
    assert_eq!((&right["prompt"]["button"], &right["nearly"]), (&"show three of each".into(), &Value::Null));
    page.send(Message::text("show")).unwrap();
    let _ = page.send(Message::text("show it"));
    // A message that no page sends ends the connection. By then, all earlier messages were read.
    while page.read().is_ok() {}
    let shows = web.shows();
    assert!(shows() && !shows());
}

#[test]
fn the_page_and_its_files_come_whole_with_a_strict_policy_and_nothing_else_does() {
    let web = Web::start(&any_port()).unwrap();
    let host = web.address().to_string();
    let get = |target: &str| ask(web.address(), &format!("GET {target}"), &[("Host", &host)]);
    let (head, page) = get("/");
    assert!(head.starts_with("HTTP/1.1 200 OK"), "{head}");
    assert!(head.contains("default-src 'none'") && head.contains("frame-ancestors 'none'"), "{head}");
    assert!(page.ends_with("</html>\n"));
    for (file, kind) in [("page.css", "text/css"), ("main.js", "text/javascript"), ("icon.svg", "image/svg")]
    {
        assert!(page.contains(file), "{file}");
        let (head, _) = get(&format!("/{file}"));
        assert!(head.starts_with("HTTP/1.1 200") && head.contains(kind), "{head}");
    }
    // The page must not load anything from other servers, because it must work offline.
    for file in
        ["/", "/page.css", "/main.js", "/link.js", "/panels.js", "/robot.js", "/draw.js", "/matrix.js"]
    {
        let (_, text) = get(file);
        assert!(!text.contains("https://") && !text.contains("//cdn"), "{file}");
        // The server must offer every imported module.
        for import in text.lines().filter(|line| line.starts_with("import ")) {
            let name = import.split('"').nth(1).unwrap().trim_start_matches('.');
            assert!(get(name).0.starts_with("HTTP/1.1 200"), "{file} imports {name}");
        }
    }
    for (target, status) in [("/secret", "404"), ("/../Cargo.toml", "404"), ("/live", "403")] {
        assert!(get(target).0.starts_with(&format!("HTTP/1.1 {status}")), "{target}: {}", get(target).0);
    }
    let (head, _) = ask(web.address(), "POST /", &[("Host", &host)]);
    assert!(head.starts_with("HTTP/1.1 405"), "{head}");
    let (head, body) = ask(web.address(), "HEAD /", &[("Host", &host)]);
    assert!(head.starts_with("HTTP/1.1 200") && body.is_empty(), "{head}");
}

#[test]
fn foreign_names_and_foreign_pages_are_refused() {
    let (web, _live) = session();
    let host = web.address().to_string();
    let (head, body) = ask(web.address(), "GET /", &[("Host", "robot.evil.example")]);
    assert!(head.starts_with("HTTP/1.1 403") && body.contains("localhost"), "{head} {body}");
    let (head, _) = ask(web.address(), "GET /", &[]);
    assert!(head.starts_with("HTTP/1.1 403"), "no Host: {head}");
    let (head, _) = ask(web.address(), "GET /", &[("Host", &host), ("Host", "127.0.0.1")]);
    assert!(head.starts_with("HTTP/1.1 403"), "two of them: {head}");
    let (head, _) = ask(web.address(), "GET /main.js", &[("Host", &host), ("Origin", "http://evil.example")]);
    assert!(head.starts_with("HTTP/1.1 403"), "{head}");
    for origin in [None, Some("http://evil.example"), Some("null"), Some("https://127.0.0.1")] {
        assert_eq!(open(&web, origin, "").err(), Some(403), "{origin:?}");
    }
    let mut socket = open(&web, Some(&own_origin(&web)), "").unwrap();
    assert_eq!(message(&mut socket)["hello"], 1);
}

#[test]
fn a_token_is_needed_where_it_was_set_and_set_where_others_can_come_in() {
    let everybody = "0.0.0.0".parse().unwrap();
    let open_door = Web::start(&WebOptions { address: everybody, port: 0, token: None });
    assert!(matches!(open_door, Err(WebError::TokenNeeded(_))));
    let weak = Web::start(&WebOptions { token: Some("secret".to_owned()), ..any_port() });
    assert!(matches!(weak, Err(WebError::BadToken)));

    let token = "0123456789abcdef";
    let web = Web::start(&WebOptions { token: Some(token.to_owned()), ..any_port() }).unwrap();
    assert!(web.url().ends_with(&format!("/?token={token}")));
    let host = web.address().to_string();
    assert!(ask(web.address(), "GET /", &[("Host", &host)]).0.starts_with("HTTP/1.1 403"));
    let known = ask(web.address(), &format!("GET /?token={token}"), &[("Host", &host)]).0;
    assert!(known.starts_with("HTTP/1.1 200"), "{known}");
    let origin = own_origin(&web);
    assert_eq!(open(&web, Some(&origin), "").err(), Some(403));
    assert_eq!(open(&web, Some(&origin), "?token=0123456789abcdeX").err(), Some(403));
    assert!(open(&web, Some(&origin), &format!("?token={token}")).is_ok());
}

#[test]
fn a_taken_port_is_an_error_that_names_another() {
    let web = Web::start(&any_port()).unwrap();
    let again = Web::start(&WebOptions { port: web.address().port(), ..any_port() });
    let text = again.err().unwrap().to_string();
    assert!(text.contains("in use") && text.contains("--web="), "{text}");
}

#[test]
fn a_page_is_told_setting_and_state_and_its_stop_stops_the_robot_as_the_stop_key_does() {
    let (web, mut live) = session();
    let mut socket = open(&web, Some(&own_origin(&web)), "").unwrap();
    let hello = message(&mut socket);
    assert_eq!(hello["title"], "a test\nsecond line");
    assert_eq!(hello["setting"]["joints"].as_array().unwrap().len(), 7);
    let frame = message(&mut socket);
    assert_eq!(frame["state"]["safety"], "armed");
    assert_eq!(frame["state"]["time_ms"], 499);
    socket.send(Message::text("took")).unwrap();
    assert!(!web.take_stop());
    socket.send(Message::text("stop")).unwrap();
    let began = Instant::now();
    while !web.take_stop() {
        assert!(began.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(!web.take_stop(), "once");
    live.stop_key(500);
    web.end(&live.now(501));
    let frame = message(&mut socket);
    assert_eq!(frame["state"]["safety"], "stopped");
    assert_eq!(frame["state"]["time_ms"], 501);
    assert_eq!(message(&mut socket)["over"], true);
}

#[test]
fn a_page_that_takes_nothing_gets_two_frames_and_then_only_the_newest() {
    let (web, mut live) = session();
    let mut socket = open(&web, Some(&own_origin(&web)), "").unwrap();
    message(&mut socket);
    let mut last = message(&mut socket);
    for now_ms in (500..).take(IN_FLIGHT_MAX as usize - 1) {
        publish_step(&mut live, now_ms);
        last = message(&mut socket);
    }
    // No page acknowledges these frames.
    for now_ms in 590..600 {
        publish_step(&mut live, now_ms);
    }
    socket.get_ref().set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    assert!(socket.read().is_err(), "one frame too many");
    socket.get_ref().set_read_timeout(Some(PATIENCE)).unwrap();
    socket.send(Message::text("took")).unwrap();
    let next = message(&mut socket);
    let number = |frame: &Value| frame["frame"].as_u64().unwrap();
    assert_eq!(number(&next), number(&last) + 10);
    assert_eq!(next["state"]["time_ms"], 599);
}

#[test]
fn rude_clients_are_let_go_and_others_are_still_served() {
    let (web, _live) = session();
    let origin = own_origin(&web);
    for rude in [Message::text("drive"), Message::text("took"), Message::binary(vec![0; 64])] {
        let mut socket = open(&web, Some(&origin), "").unwrap();
        // The first frame is acknowledged late.
        // One acknowledgement is accepted, and a second one is an error.
        for _ in 0..8 {
            let _ = socket.send(rude.clone());
        }
        let ended = (0..50).any(|_| socket.read().is_err());
        assert!(ended, "{rude:?}");
    }
    let mut socket = open(&web, Some(&origin), "").unwrap();
    let _ = socket.send(Message::text("x".repeat(100_000)));
    assert!((0..50).any(|_| socket.read().is_err()), "long messages");
    assert!(!web.take_stop(), "none of it was a stop");

    let (head, _) = ask(web.address(), "GET /", &[("Host", "x"), ("Pad", &"y".repeat(9000))]);
    assert!(head.is_empty() || head.starts_with("HTTP/1.1 431"), "{head}");
    let (head, _) = ask(web.address(), "nonsense\u{1}", &[]);
    assert!(head.starts_with("HTTP/1.1 400"), "{head}");

    // Clients that open connections and send nothing must not block others permanently.
    let silent: Vec<TcpStream> =
        (0..CONNECTIONS_MAX).map(|_| TcpStream::connect(web.address()).unwrap()).collect();
    drop(silent);
    let host = web.address().to_string();
    let began = Instant::now();
    loop {
        let mut stream = TcpStream::connect(web.address()).unwrap();
        let _ = stream.write_all(format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n").as_bytes());
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        if answer.starts_with(b"HTTP/1.1 200") {
            break;
        }
        assert!(began.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(5));
    }
}
