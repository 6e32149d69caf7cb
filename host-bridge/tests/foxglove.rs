//! Tests the Foxglove server on loopback sockets.
//! The advertised channels must match those of a session file. The messages must match the simulator's state.
//! The test also checks which clients may connect.
//! `tests/foxglove/check.py` runs similar checks with third-party packages.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use host_bridge::config::{Config, HandInput};
use host_bridge::engine::Engine;
use host_bridge::foxglove::{Foxglove, FoxgloveOptions};
use host_bridge::keyboard::HandKey;
use host_bridge::robot::Door as _;
use host_bridge::topics::{Origin, Topic};
use host_bridge::web::{WebError, WebOptions};
use serde_json::{Value, json};
use shared_proto::message::Heading;
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

#[path = "support/moving.rs"]
mod moving;

use moving::{Robot, Virtual as _, live as live_engine};

type Live = Engine<'static, Robot>;

/// Limit in wall-clock time, so that a test cannot hang forever.
const PATIENCE: Duration = Duration::from_secs(120);
const ORIGIN: Origin = Origin { nanoseconds: 1_700_000_000_000_000_000 };

fn any_port() -> FoxgloveOptions {
    FoxgloveOptions {
        server: WebOptions { port: 0, ..WebOptions::default() },
        origins: vec!["http://localhost:8080".to_owned()],
    }
}

fn open(
    foxglove: &Foxglove,
    origin: Option<&str>,
    protocol: &str,
    query: &str,
) -> Result<WebSocket<TcpStream>, u16> {
    let stream = TcpStream::connect(foxglove.address()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut request = format!("ws://{}/{query}", foxglove.address()).into_client_request().unwrap();
    if let Some(origin) = origin {
        request.headers_mut().insert("Origin", origin.parse().unwrap());
    }
    if !protocol.is_empty() {
        request.headers_mut().insert("Sec-WebSocket-Protocol", protocol.parse().unwrap());
    }
    match tungstenite::client(request, stream) {
        Ok((socket, response)) => {
            let chosen = response.headers().get("sec-websocket-protocol").unwrap();
            assert!(protocol.contains(chosen.to_str().unwrap()));
            Ok(socket)
        }
        Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response))) => {
            Err(response.status().as_u16())
        }
        Err(error) => panic!("{error}"),
    }
}

fn words(socket: &mut WebSocket<TcpStream>) -> Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            return serde_json::from_str(text.as_str()).unwrap();
        }
    }
}

/// Subscription id, session time in ms, and the payload after the four bytes that state its encoding.
type Data = (u32, u64, Vec<u8>);

/// Returns the messages that have arrived or arrive shortly afterwards.
fn arrived(socket: &mut WebSocket<TcpStream>) -> Vec<Data> {
    socket.get_ref().set_read_timeout(Some(Duration::from_millis(5))).unwrap();
    let arrived = std::iter::from_fn(|| match socket.read() {
        Ok(Message::Binary(bytes)) => {
            assert_eq!((bytes[0], &bytes[13..17]), (1, &[0, 1, 0, 0][..]));
            let time_ns = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
            let time_ms = (time_ns - ORIGIN.nanoseconds) / 1_000_000;
            Some((u32::from_le_bytes(bytes[1..5].try_into().unwrap()), time_ms, bytes[17..].to_vec()))
        }
        Ok(other) => panic!("{other}"),
        Err(tungstenite::Error::Io(error)) => {
            assert!(matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut), "{error}");
            None
        }
        Err(error) => panic!("{error}"),
    });
    let arrived = arrived.collect();
    socket.get_ref().set_read_timeout(Some(PATIENCE)).unwrap();
    arrived
}

fn session(foxglove: &Foxglove) -> Live {
    let mut live = live_engine(&Config::default(), HandInput::Keyboard, HandInput::Keyboard);
    live.tap_mut().add(Box::new(foxglove.teller()));
    for now_ms in 1..500 {
        live.advance(now_ms, [true; 2]);
    }
    live
}

#[test]
fn a_viewer_is_told_every_topic_and_gets_what_it_subscribes_to_as_the_simulator_has_it() {
    let foxglove = Foxglove::start(&any_port(), ORIGIN).unwrap();
    assert!(foxglove.url().starts_with("ws://127.0.0.1:"));
    let mut live = session(&foxglove);
    let mut socket = open(&foxglove, None, "foxglove.websocket.v1", "").unwrap();
    let info = words(&mut socket);
    assert_eq!((&info["op"], &info["sessionId"]), (&json!("serverInfo"), &json!("1700000000000000000")));
    let told = words(&mut socket);
    let channels = told["channels"].as_array().unwrap();
    let named = |name: &str| channels.iter().find(|c| c["topic"] == name).unwrap()["id"].as_u64().unwrap();
    assert_eq!(channels.len(), Topic::ALL.len());
    let wish = json!({ "op": "subscribe", "subscriptions": [
        { "id": 41, "channelId": named("/odom") }, { "id": 42, "channelId": named("/joint_states") } ] });
    socket.send(Message::text(wish.to_string())).unwrap();

    // Nothing shows when the subscription takes effect.
    // The session therefore runs until enough messages have arrived.
    let mut now_ms = 500;
    live.press(HandKey::Arrow(Heading::Forward), now_ms);
    live.press(HandKey::Gesture(2), now_ms);
    let mut states = std::collections::BTreeMap::new();
    let mut seen = [0, 0];
    let began = Instant::now();
    while now_ms < 1500 || seen[0] < 20 || seen[1] < 40 {
        assert!(began.elapsed() < PATIENCE, "{seen:?}");
        for _ in 0..100 {
            now_ms += 1;
            live.advance(now_ms, [true; 2]);
            let robot = live.door().picture();
            states.insert(now_ms, (robot.arm, robot.odometry, robot.wheels_rad));
        }
        for (id, time_ms, payload) in arrived(&mut socket) {
            let (arm, odometry, wheels_rad) = &states[&time_ms];
            let has = |values: &[f64]| {
                let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
                payload.windows(bytes.len()).any(|window| window == bytes)
            };
            match id {
                41 => assert!(has(&[odometry.x_m, odometry.y_m, 0.0])),
                42 => assert!(has(&[&arm.joints_rad[..7], wheels_rad].concat())),
                other => panic!("subscription {other}"),
            }
            seen[(id - 41) as usize] += 1;
        }
    }
    assert!(live.door().odometry().x_m > 0.01 && !live.door().arm().at_rest(), "something moved");

    socket.send(Message::text(r#"{"op":"unsubscribe","subscriptionIds":[41,42]}"#)).unwrap();
    socket.send(Message::text(r#"{"op":"advertise","channels":[]}"#)).unwrap();
    socket.send(Message::binary(vec![1, 0, 0, 0, 0])).unwrap();
    for _ in 0..2 {
        let refused = words(&mut socket);
        assert_eq!((&refused["op"], &refused["level"]), (&json!("status"), &json!(1)), "{refused}");
    }
    for _ in 0..100 {
        now_ms += 1;
        live.advance(now_ms, [true; 2]);
    }
    foxglove.end();
    assert!(matches!(socket.read(), Ok(Message::Close(_)) | Err(_)), "nothing more, and the end");
}

#[test]
fn strangers_stay_out_and_foxglove_comes_in() {
    let foxglove = Foxglove::start(&any_port(), ORIGIN).unwrap();
    let v1 = "foxglove.sdk.v1";
    for origin in
        ["http://evil.example", "null", "https://app.foxglove.dev.evil.example", "http://localhost:8081"]
    {
        assert_eq!(open(&foxglove, Some(origin), v1, "").err(), Some(403), "{origin}");
    }
    for origin in [None, Some("https://app.foxglove.dev"), Some("file://"), Some("http://localhost:8080")] {
        assert!(open(&foxglove, origin, v1, "").is_ok(), "{origin:?}");
    }
    assert_eq!(open(&foxglove, None, "", "").err(), Some(400), "no protocol");
    assert_eq!(open(&foxglove, None, "foxglove.sdk.v9", "").err(), Some(400), "another protocol");
    assert!(open(&foxglove, None, "foxglove.sdk.v9, foxglove.websocket.v1", "").is_ok());

    let mut stream = TcpStream::connect(foxglove.address()).unwrap();
    stream.write_all(b"GET / HTTP/1.1\r\nHost: robot.evil.example\r\n\r\n").unwrap();
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    assert!(answer.starts_with("HTTP/1.1 403"), "{answer}");

    let token = "0123456789abcdef";
    let mut options = any_port();
    options.server.token = Some(token.to_owned());
    let closed = Foxglove::start(&options, ORIGIN).unwrap();
    assert!(closed.url().ends_with(&format!("/?token={token}")));
    assert_eq!(open(&closed, None, v1, "").err(), Some(403));
    assert!(open(&closed, None, v1, &format!("?token={token}")).is_ok());
    options.server = WebOptions { address: "0.0.0.0".parse().unwrap(), port: 0, token: None };
    assert!(matches!(Foxglove::start(&options, ORIGIN), Err(WebError::TokenNeeded(_))));

    options.server = WebOptions { port: foxglove.address().port(), ..any_port().server };
    let taken = Foxglove::start(&options, ORIGIN).err().unwrap().to_string();
    assert!(taken.contains("in use") && taken.contains("--foxglove="), "{taken}");
}

#[test]
fn a_viewer_that_takes_nothing_loses_messages_and_delays_nobody() {
    let foxglove = Foxglove::start(&any_port(), ORIGIN).unwrap();
    let mut live = session(&foxglove);
    let mut socket = open(&foxglove, None, "foxglove.sdk.v1", "").unwrap();
    let all: Vec<Value> = (0..Topic::ALL.len()).map(|k| json!({ "id": k, "channelId": k })).collect();
    socket.send(Message::text(json!({ "op": "subscribe", "subscriptions": all }).to_string())).unwrap();
    // Reads the server information and the list of channels.
    words(&mut socket);
    words(&mut socket);
    let (mut now_ms, began) = (500, Instant::now());
    let mut pass = |steps| {
        for _ in 0..steps {
            now_ms += 1;
            live.advance(now_ms, [true; 2]);
        }
    };
    while arrived(&mut socket).is_empty() {
        assert!(began.elapsed() < PATIENCE, "the subscription takes effect");
        pass(100);
    }
    // If the session waited for a client, this loop would never end.
    // The data far exceeds the capacity of the sockets and the queue.
    pass(100_000);
    let lost = (0..1_000_000).find_map(|_| match socket.read().unwrap() {
        Message::Text(text) if text.as_str().contains("too slow for") => Some(text.to_string()),
        _ => None,
    });
    println!("{lost:?}");
    assert!(lost.is_some());
}
