//! Checks that every message can be decoded from its frame and fits its maximum size.
//! Also checks that no other bytes are accepted as a message.

mod common;

use common::{BOARD_KINDS, HOST_KINDS, Material, longest};
use proptest::prelude::*;
use shared_proto::frame::*;
use shared_proto::message::{BoardMessage, Boards, Bytes, HostMessage, RAW_COUNTS_MAX, Row};

fn word() -> impl Strategy<Value = u32> {
    prop_oneof![any::<u32>(), 0u32..300, Just(u32::MAX), Just(0x8000), Just(0x7FFF)]
}

prop_compose! {
    fn material()(
        kind in 0..BOARD_KINDS * HOST_KINDS,
        words in prop::array::uniform10(word()),
        bytes in prop::collection::vec(any::<u8>(), 0..=RAW_COUNTS_MAX),
        text in any::<String>(),
    ) -> Material {
        Material { kind, words, bytes, text }
    }
}

/// Returns the largest possible message of each kind.
fn largest(kind: usize, row: &Row) -> Material {
    Material {
        kind,
        words: [0x8000_8000; 10], // values that take the most bytes as u16, i16 and u32
        bytes: vec![0xA5; RAW_COUNTS_MAX],
        text: "x".repeat(longest(row.name)),
    }
}

/// Returns the payloads of the intact frames in `bytes`.
fn payloads(bytes: &[u8]) -> (Vec<Vec<u8>>, Counters) {
    let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
    let payloads = bytes.iter().filter_map(|&byte| decoder.push(byte).map(<[u8]>::to_vec)).collect();
    (payloads, decoder.counters())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..Default::default() })]

    #[test]
    fn every_message_comes_back(material in material()) {
        let (mut board, mut host) = ([0; BOARD_FRAME_MAX], [0; HOST_FRAME_MAX]);
        let (to_host, to_board) = (material.board(), material.host());
        let board = encode_board(&to_host, &mut board).unwrap();
        let host = encode_host(&to_board, &mut host).unwrap();
        for frame in [board, host] {
            prop_assert_eq!(frame.iter().position(|&byte| byte == DELIMITER), Some(frame.len() - 1));
        }
        // The values are compared as text, because NaN is not equal to itself.
        let (from_board, _) = payloads(board);
        prop_assert_eq!(format!("{:?}", parse_board(&from_board[0])), format!("Ok({to_host:?})"));
        let (from_host, _) = payloads(host);
        prop_assert_eq!(format!("{:?}", parse_host(&from_host[0])), format!("Ok({to_board:?})"));
    }

    /// Tests the small encoder and decoder of a left board.
    #[test]
    fn a_body_alone_gives_the_same_frame_and_a_left_board_reads_the_same_requests(material in material()) {
        let (mut buffer, mut again) = ([0; BOARD_FRAME_MAX], [0; BOARD_FRAME_MAX]);
        let frame = encode_board(&material.board(), &mut buffer);
        let body = match material.board() {
            BoardMessage::Hello(body) => encode_body(&body, &mut again),
            BoardMessage::Left(body) => encode_body(&body, &mut again),
            BoardMessage::Right(body) => encode_body(&body, &mut again),
            BoardMessage::RawImu(body) => encode_body(&body, &mut again),
            BoardMessage::Status(body) => encode_body(&body, &mut again),
            BoardMessage::Fault(body) => encode_body(&body, &mut again),
            BoardMessage::Pong(body) => encode_body(&body, &mut again),
            BoardMessage::Ack(body) => encode_body(&body, &mut again),
            BoardMessage::ModelInfo(body) => encode_body(&body, &mut again),
            BoardMessage::About(body) => encode_body(&body, &mut again),
            BoardMessage::RawAdc(body) => encode_body(&body, &mut again),
            BoardMessage::Tilt(body) => encode_body(&body, &mut again),
            BoardMessage::Pairing(body) => encode_body(&body, &mut again),
        };
        prop_assert_eq!(frame, body);

        let (payloads, _) = payloads(encode_host(&material.host(), &mut buffer).unwrap());
        let request = parse_left_request(&payloads[0]);
        if material.host().row().boards == Boards::Both {
            prop_assert_eq!(format!("{:?}", request.unwrap()), format!("{:?}", material.host()));
        } else {
            prop_assert_eq!(request, Err(ParseError::Unknown));
        }
    }

    #[test]
    fn a_buffer_that_is_too_small_is_an_error_and_one_that_just_fits_is_none(material in material()) {
        let mut large = [0; BOARD_FRAME_MAX];
        let len = encode_board(&material.board(), &mut large).unwrap().len();
        for short in 0..len {
            prop_assert_eq!(encode_board(&material.board(), &mut large[..short]), Err(EncodeError));
        }
        prop_assert!(encode_board(&material.board(), &mut large[..len]).is_ok());
    }

    #[test]
    fn arbitrary_payloads_and_streams_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = parse_board(&bytes);
        let whole = parse_host(&bytes);
        match parse_left_request(&bytes) {
            Ok(request) => prop_assert_eq!(format!("{:?}", request), format!("{:?}", whole.unwrap())),
            Err(error) => prop_assert!(error == ParseError::Unknown || whole == Err(ParseError::Malformed)),
        }
        let (seen, counters) = payloads(&bytes);
        prop_assert_eq!(seen.len(), counters.frames as usize);
        let mut tiny = Decoder::<0>::new();
        prop_assert!(bytes.iter().all(|&byte| tiny.push(byte).is_none()));
    }

    /// Long payloads contain blocks of 254 bytes without a zero. Our messages contain no such blocks.
    /// Another implementation encoded the frames in this test.
    #[test]
    fn the_decoder_agrees_with_the_cobs_of_postcard_and_a_table_driven_crc(
        payload in prop::collection::vec(prop_oneof![1 => Just(0u8), 600 => any::<u8>()], 1..1200),
    ) {
        let mut plain = payload.clone();
        plain.extend(crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&payload).to_le_bytes());
        let mut frame = vec![0; plain.len() * 2];
        let mut cobs = postcard::ser_flavors::Cobs::try_new(postcard::ser_flavors::Slice::new(&mut frame)).unwrap();
        for &byte in &plain {
            postcard::ser_flavors::Flavor::try_push(&mut cobs, byte).unwrap();
        }
        let frame = postcard::ser_flavors::Flavor::finalize(cobs).unwrap();
        let mut decoder = Decoder::<2000>::new();
        let seen: Vec<Vec<u8>> =
            frame.iter().filter_map(|&byte| decoder.push(byte).map(<[u8]>::to_vec)).collect();
        prop_assert_eq!(seen, vec![payload]);
    }
}

/// Encodes and decodes our own frames with blocks of 254 bytes, which are longer than any message.
#[test]
fn blocks_without_a_zero_of_every_length_come_back() {
    for len in 1..1100 {
        let data = vec![7; len];
        let mut buffer = vec![0; len + 40];
        let sent = HostMessage::ModelChunk { request: 0x101, offset: 0x0101_0101, data: Bytes(&data) };
        let frame = encode_host(&sent, &mut buffer).unwrap();
        let mut decoder = Decoder::<1200>::new();
        let (last, first) = frame.split_last().unwrap();
        assert!(first.iter().all(|&byte| decoder.push_host(byte).is_none()));
        assert_eq!(decoder.push_host(*last), Some(sent), "{len} bytes");
    }
}

#[test]
fn the_largest_message_of_each_kind_has_the_stated_size() {
    let mut buffer = [0; 1000];
    for (kind, row) in BoardMessage::ROWS.iter().enumerate() {
        let material = largest(kind, row);
        let len = encode_board(&material.board(), &mut buffer).unwrap().len();
        assert_eq!(len, row.frame_max, "{:?}", material.board());
    }
    for (kind, row) in HostMessage::ROWS.iter().enumerate() {
        let material = largest(kind, row);
        let len = encode_host(&material.host(), &mut buffer).unwrap().len();
        assert_eq!(len, row.frame_max, "{:?}", material.host());
    }
}

/// Boards with little memory reserve buffers of these sizes, which are those of protocol 1.7.
#[test]
fn buffers_are_as_large_as_the_largest_frame_that_they_may_hold() {
    let sizes = [BOARD_FRAME_MAX, LEFT_BOARD_FRAME_MAX, HOST_FRAME_MAX, HOST_TO_LEFT_FRAME_MAX];
    assert_eq!(sizes, [174, 56, 145, 19]);
}

/// Builds a frame that contains any payload.
fn framed(payload: &[u8]) -> Vec<u8> {
    let mut plain = payload.to_vec();
    plain.extend(crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(payload).to_le_bytes());
    let mut frame = Vec::new();
    for run in plain.split(|&byte| byte == 0) {
        frame.push(run.len() as u8 + 1);
        frame.extend(run);
    }
    frame.push(DELIMITER);
    frame
}

#[test]
fn messages_of_later_versions_count_as_unknown_and_reshaped_ones_as_malformed() {
    let mut decoder = Decoder::<100>::new();
    let mut stream = framed(&[BOARD_KINDS as u8, 1, 2, 3]);
    stream.extend(framed(&[200, 1]));
    stream.extend(framed(&[6, 1])); // a pong without its time
    stream.extend(framed(&[6, 1, 2, 3])); // a pong with more than a pong has
    assert!(stream.iter().all(|&byte| decoder.push_board(byte).is_none()));
    assert_eq!(decoder.counters(), Counters { frames: 4, unknown: 2, malformed: 2, ..Default::default() });
    assert_eq!(decoder.counters().damaged(), 0);

    let mut decoder = Decoder::<100>::new();
    let mut stream = framed(&[HOST_KINDS as u8]);
    stream.extend(framed(&[2, 5, 9])); // a mode that does not exist
    assert!(stream.iter().all(|&byte| decoder.push_host(byte).is_none()));
    assert_eq!(decoder.counters(), Counters { frames: 2, unknown: 1, malformed: 1, ..Default::default() });
}

#[test]
fn a_hello_of_any_later_version_can_be_read() {
    let hello = [0, 9, 4, 77, 1, b'x', 5, 6, 7, 0xAA, 0xBB]; // a new board, and two fields more
    let Ok(BoardMessage::Hello(hello)) = parse_board(&hello) else { panic!("{:?}", parse_board(&hello)) };
    assert_eq!((hello.major, hello.minor, hello.firmware.0), (9, 4, "x"));
    assert_eq!((u8::from(hello.board), hello.boot_id, hello.model_id, hello.sample_hz), (77, 5, 6, 7));
    assert_eq!(parse_host(&[0, 1, 2]), Ok(HostMessage::HelloRequest));
}

#[test]
fn damage_is_counted_by_its_kind_and_the_next_frame_is_taken() {
    let good = framed(&[6, 1, 2]);
    let cases: [(&[u8], Counters); 5] = [
        (&[5, 1, 2, 0], Counters { bad_cobs: 1, ..Default::default() }),
        (&[4, 1, 2, 3, 0], Counters { bad_crc: 1, ..Default::default() }), // too short for a checksum
        (&[7, 6, 1, 2, 1, 1, 1, 0], Counters { bad_crc: 1, ..Default::default() }),
        // A line that always reads 0x01 looks like an empty message with the correct checksum, which is 0.
        (&[1, 1, 1, 1, 1, 0], Counters { bad_crc: 1, ..Default::default() }),
        (&[0, 0, 0, 0], Counters::default()),
    ];
    for (noise, expected) in cases {
        let (seen, counters) = payloads(&[noise, &good].concat());
        assert_eq!(seen, [[6, 1, 2]], "{noise:?}");
        assert_eq!(counters, Counters { frames: 1, ..expected }, "{noise:?}");
    }
    let long = vec![9; 5000];
    let (seen, counters) = payloads(&[&long[..], &[0], &good].concat());
    assert_eq!(seen, [[6, 1, 2]]);
    assert_eq!(counters, Counters { frames: 1, overflow: 1, ..Default::default() });
}
