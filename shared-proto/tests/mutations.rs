//! Damages streams of frames in every way in which a line can damage them.
//! Only frames that were sent may be accepted, and all undamaged frames must be accepted.
//!
//! `cargo test -p shared-proto --test mutations` runs 200 000 streams.
//! To run ten million and print statistics, use
//! `BIMANUAL_FULL=1 cargo test --release -p shared-proto --test mutations -- --nocapture`.
//! `BIMANUAL_SEED=n` selects another seed.

mod common;

use common::{Material, Rng};
use shared_proto::frame::*;

/// A collection of frames without their delimiters.
struct Pool(Vec<Vec<u8>>);

impl Pool {
    fn new(rng: &mut Rng) -> Self {
        let mut buffer = [0; BOARD_FRAME_MAX];
        Self(
            (0..4096)
                .map(|k| {
                    let material = Material::random(rng);
                    let frame = if k % 2 == 0 {
                        encode_board(&material.board(), &mut buffer)
                    } else {
                        encode_host(&material.host(), &mut buffer)
                    };
                    let frame = frame.expect("the largest buffer holds every message");
                    frame[..frame.len() - 1].to_vec()
                })
                .collect(),
        )
    }
}

/// Returns a random part of `len` bytes. The part is usually short.
fn part(rng: &mut Rng, len: usize) -> std::ops::Range<usize> {
    let start = rng.below(len + 1);
    let most = if rng.below(4) == 0 { len - start } else { (len - start).min(8) };
    start..start + rng.below(most + 1)
}

fn a_delimiter(rng: &mut Rng, stream: &[u8]) -> Option<usize> {
    let start = rng.below(stream.len() + 1);
    stream[start..].iter().position(|&byte| byte == DELIMITER).map(|k| start + k)
}

/// Damages the stream once. `donor` is another intact stream.
fn mutate(rng: &mut Rng, stream: &mut Vec<u8>, donor: &[u8]) {
    let at = rng.below(stream.len() + 1);
    match rng.below(14) {
        0 | 1 if at < stream.len() => stream[at] ^= 1 << rng.below(8),
        2 if at < stream.len() => stream[at] = rng.next() as u8,
        3 => stream.insert(at, rng.next() as u8),
        4 if at < stream.len() => {
            stream.remove(at);
        }
        5 => {
            let part = part(rng, stream.len());
            stream.drain(part);
        }
        6 => stream.truncate(at),
        7 => {
            stream.drain(..at);
        }
        // Inserts a copy of a part of the stream at another place.
        8 => {
            let copy = stream[part(rng, stream.len())].to_vec();
            stream.splice(at..at, copy);
        }
        // Inserts a part of another stream, or overwrites a part with it.
        9 => {
            let copy = donor[part(rng, donor.len())].to_vec();
            let over = part(rng, stream.len());
            stream.splice(over, copy);
        }
        10 => {
            if let Some(at) = a_delimiter(rng, stream) {
                stream.remove(at);
            }
        }
        11 => {
            if let Some(at) = a_delimiter(rng, stream) {
                stream[at] = rng.next() as u8;
            }
        }
        12 => stream.insert(at, DELIMITER),
        13 => {
            let noise: Vec<u8> = (0..1 + rng.below(300)).map(|_| rng.next() as u8).collect();
            stream.splice(at..at, noise);
        }
        _ => {}
    }
}

#[derive(Default)]
struct Tally {
    sent: u64,
    whole: u64,
    damaged: u64,
}

/// Feeds the stream to a decoder of `N` bytes, and compares the result with the expected frames.
fn check<const N: usize>(stream: &[u8], sent: &[&[u8]], tally: &mut Tally, name: impl Fn() -> String) {
    let mut decoder = Decoder::<N>::new();
    let mut rest = stream;
    let mut whole = 0;
    // A chunk is valid if it equals a sent frame and ends with a delimiter.
    // The delimiter before the chunk belongs to the previous chunk, unless the stream starts here.
    while let Some(end) = rest.iter().position(|&byte| byte == DELIMITER) {
        let chunk = &rest[..end];
        // Frames in this test are short enough for one code byte, so the decoded length is one less.
        let expected = (chunk.len() <= N + 1 && sent.contains(&chunk)).then_some(chunk);
        for &byte in chunk {
            assert!(decoder.push(byte).is_none(), "{}: a frame before its delimiter", name());
        }
        let got = decoder.push(DELIMITER);
        match (expected, got) {
            (None, None) => {}
            (Some(chunk), Some(payload)) => {
                whole += 1;
                assert!(unstuffed(chunk).eq(payload.iter().copied()), "{}: changed", name());
            }
            (Some(_), None) => panic!("{}: a whole frame was dropped", name()),
            (None, Some(payload)) => panic!("{}: accepted {payload:02x?}, which was not sent", name()),
        }
        rest = &rest[end + 1..];
    }
    for &byte in rest {
        assert!(decoder.push(byte).is_none(), "{}: a frame without its delimiter", name());
    }
    let counters = decoder.counters();
    assert_eq!(counters.frames, whole, "{}", name());
    tally.whole += u64::from(whole);
    tally.damaged += u64::from(counters.damaged());
}

/// Decodes a frame by the definition of COBS, if all its blocks are shorter than 254 bytes.
/// In such a frame, each code byte is the distance to the next zero.
fn unstuffed(chunk: &[u8]) -> impl Iterator<Item = u8> {
    let mut next_code = usize::from(chunk[0]);
    let payload = chunk.len() - 1 - 4;
    chunk.iter().enumerate().skip(1).take(payload).map(move |(k, &byte)| {
        if k == next_code {
            next_code = k + usize::from(byte);
            0
        } else {
            byte
        }
    })
}

#[test]
fn damaged_streams_yield_exactly_the_frames_left_whole() {
    let number = |name: &str| {
        std::env::var(name)
            .ok()
            .map(|text| text.parse::<u64>().unwrap_or_else(|_| panic!("{name}={text}: not a number")))
    };
    let full = std::env::var("BIMANUAL_FULL").is_ok_and(|value| value == "1");
    let streams = if full { 10_000_000 } else { 200_000 };
    let seed = number("BIMANUAL_SEED").unwrap_or(20_261_122);
    println!("seed {seed} (BIMANUAL_SEED), {streams} streams");

    let pool = Pool::new(&mut Rng(seed));
    let mut tally = Tally::default();
    let (mut stream, mut donor) = (Vec::new(), Vec::new());
    for k in 0..streams {
        let mut rng = Rng(Rng(seed ^ (k << 20)).next());
        let mut sent: Vec<&[u8]> = Vec::with_capacity(12);
        for (bytes, frames) in [(&mut stream, 2 + rng.below(5)), (&mut donor, 1 + rng.below(3))] {
            bytes.clear();
            for _ in 0..frames {
                let frame = &pool.0[rng.below(pool.0.len())][..];
                sent.push(frame);
                bytes.extend_from_slice(frame);
                bytes.push(DELIMITER);
            }
            tally.sent += frames as u64;
        }
        for _ in 0..1 + rng.below(4) {
            mutate(&mut rng, &mut stream, &donor);
        }
        let name = || format!("seed {seed}, stream {k}");
        if rng.below(4) == 0 {
            check::<LEFT_BOARD_FRAME_MAX>(&stream, &sent, &mut tally, name);
        } else {
            check::<BOARD_FRAME_MAX>(&stream, &sent, &mut tally, name);
        }
    }
    let Tally { sent, whole, damaged } = tally;
    println!("{sent} frames drawn, {whole} left whole and all accepted, {damaged} damaged and all dropped");
    println!("row: damaged frames taken | {streams} streams, {damaged} damaged frames | 0 | 0");
    // If there were fewer cases, the run would have tested too little.
    assert!(whole > streams && damaged > streams / 2);
}
