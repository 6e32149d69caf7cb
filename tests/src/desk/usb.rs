//! What an operating system does at the other end of the board's USB cable, all at once: enumerate the serial port,
//! open and close it. (`nrf::usb_host` does it step by step, beside a board that runs on.)

use crate::nrf::board::Board;
use crate::nrf::usbd::Reply;

/// Bulk endpoints of the serial port, found in the configuration descriptor as a host does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Port {
    /// From the board.
    pub input: usize,
    /// To the board.
    pub output: usize,
}

/// A control transfer; the data of an answer.
///
/// # Panics
/// Where the board does not answer it once.
pub fn control(board: &mut Board, setup: [u8; 8], data: &[u8]) -> Vec<u8> {
    let soc = board.soc();
    soc.usb.control(setup, data, soc.now);
    soc.settle();
    board.run_ms(20);
    let replies = board.soc().usb.take_replies();
    match replies.as_slice() {
        [Reply::Done(data)] => data.clone(),
        other => panic!("{setup:x?}: {other:?}"),
    }
}

/// Plugs the cable in and enumerates the device.
///
/// # Panics
/// Where the device does not show itself, or is no Arduino with a serial port.
pub fn plug_in(board: &mut Board) -> Port {
    let soc = board.soc();
    soc.usb.plugged = true;
    soc.usb.host_reads = true;
    soc.power.set_vbus(true, soc.now);
    soc.settle();
    let shown = (0..500).any(|_| {
        board.run_ms(1);
        board.soc().usb.is_attached()
    });
    assert!(shown, "the device does not show itself");
    board.run_ms(10);
    let device = control(board, [0x80, 6, 0, 1, 0, 0, 18, 0], &[]);
    assert_eq!(device.len(), 18);
    assert_eq!(device[8..12], [0x41, 0x23, 0x5A, 0x80], "Arduino's ids");
    control(board, [0x00, 5, 7, 0, 0, 0, 0, 0], &[]);
    let head = control(board, [0x80, 6, 0, 2, 0, 0, 9, 0], &[]);
    let total = head[2];
    let all = control(board, [0x80, 6, 0, 2, 0, 0, total, 0], &[]);
    assert_eq!(all.len(), usize::from(total));
    let mut port = Port { input: 0, output: 0 };
    let mut at = 0;
    while at < all.len() {
        // Bulk endpoint descriptors.
        if all[at + 1] == 5 && all[at + 3] == 2 {
            let number = usize::from(all[at + 2] & 0xF);
            if all[at + 2] & 0x80 != 0 { port.input = number } else { port.output = number }
        }
        at += usize::from(all[at]);
    }
    assert!(port.input != 0 && port.output != 0);
    control(board, [0x00, 9, 1, 0, 0, 0, 0, 0], &[]);
    port
}

/// Pulls the cable.
pub fn pull(board: &mut Board) {
    let soc = board.soc();
    soc.usb.unplug();
    soc.power.set_vbus(false, soc.now);
    soc.settle();
}

/// Sets the line as a program does that opens (`dtr`) or closes the port.
pub fn line(board: &mut Board, baud: u32, dtr: bool) {
    let mut coding = baud.to_le_bytes().to_vec();
    coding.extend([0, 0, 8]);
    control(board, [0x21, 0x20, 0, 0, 0, 0, 7, 0], &coding);
    control(board, [0x21, 0x22, u8::from(dtr), 0, 0, 0, 0, 0], &[]);
}
