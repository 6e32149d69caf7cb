//! Tests that the image starts after the stock bootloader, sends a hello over UART and samples on its grid.
#![cfg(feature = "nrf")]

use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, encode_host};
use shared_proto::message::{Board as Which, BoardMessage, HostMessage};
use tests::nrf::board::{Board, Boot};
use tests::nrf::build::{Variant, image};
use tests::nrf::lsm9ds1::Still;

#[test]
fn the_image_starts_and_says_hello_over_uart() {
    let mut board = Board::new(image(Variant::Bootloader), Boot::StockBootloader, Box::new(Still));
    board.run_ms(1500);
    println!("resets {:?}", board.resets);
    println!("pages without a model: {:x?}", board.soc().unknown);
    println!("awake {:.3}, {} instructions", board.awake_share(), board.instructions());
    let mut buffer = [0; 256];
    let request = encode_host(&HostMessage::HelloRequest, &mut buffer).unwrap();
    board.uart_in(request);
    board.run_ms(1000);
    let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
    let mut hello = 0;
    for byte in board.uart_out() {
        if let Some(message) = decoder.push_board(byte) {
            println!("{message:?}");
            if let BoardMessage::Hello(h) = message {
                assert_eq!(h.board, Which::RightNano33);
                hello += 1;
            }
        }
    }
    // The board sends a hello at its start and on request.
    assert_eq!(hello, 2, "{:?}", decoder.counters());
}
