//! Images of a few instructions that obey or violate S140's rules. The model must distinguish them.

use super::APPLICATION;
use crate::nrf::board::{Board, Boot};
use crate::nrf::image::Image;
use crate::nrf::lsm9ds1::Still;
use crate::nrf::memory::RAM_START;

/// The code is: movs r0, #0; movs r1, #1 (an odd address as fault handler); svc 16.
const ENABLE: [u16; 3] = [0x2000, 0x2101, 0xDF10];
/// b .
const STAY: u16 = 0xE7FE;

fn run(code: &[u16]) -> Board {
    let mut bytes = vec![0; 0x100];
    bytes[..4].copy_from_slice(&0x2004_0000u32.to_le_bytes());
    bytes[4..8].copy_from_slice(&(APPLICATION + 0x101).to_le_bytes());
    for half in code.iter().chain(&[STAY]) {
        bytes.extend(half.to_le_bytes());
    }
    let image = Image { pieces: vec![(APPLICATION, bytes)], vector_table: APPLICATION, ..Image::default() };
    let mut board = Board::new(image, Boot::SoftDevice, Box::new(Still));
    board.run_ms(2);
    board
}

#[test]
fn an_image_that_only_enables_s140_breaks_nothing() {
    let mut board = run(&ENABLE);
    assert!(board.softdevice().is_enabled());
    assert_eq!(board.softdevice().calls[&16], 1);
}

/// This code reads POWER at 0x40000400: movs r2, #0x40; lsls r2, #24; movs r3, #4; lsls r3, #8; ldr r3, [r2, r3].
const READ_POWER: [u16; 5] = [0x2240, 0x0612, 0x2304, 0x021B, 0x58D3];

#[test]
fn before_s140_is_enabled_its_peripherals_may_be_touched() {
    run(&[&READ_POWER[..], &ENABLE].concat());
}

#[test]
#[should_panic(expected = "reads POWER/CLOCK")]
fn afterwards_they_may_not() {
    run(&[&ENABLE[..], &READ_POWER].concat());
}

/// cpsid i; movs r0, #COUNT; subs r0, #1; bne; cpsie i.
const fn masked_for(count: u8) -> [u16; 5] {
    [0xB672, 0x2000 | count as u16, 0x3801, 0xD1FD, 0xB662]
}

#[test]
fn interrupts_may_be_masked_for_a_moment() {
    run(&[&ENABLE[..], &masked_for(100)].concat());
}

#[test]
#[should_panic(expected = "PRIMASK held all interrupts")]
fn but_not_for_long() {
    run(&[&ENABLE[..], &masked_for(250)].concat());
}

#[test]
#[should_panic(expected = "with interrupts masked")]
fn calls_need_interrupts() {
    run(&[&[0xB672], &ENABLE[..]].concat());
}

#[test]
fn s140_refuses_to_start_where_an_interrupt_has_its_priority() {
    // Enables RTC1's interrupt at priority 0: r2 = 0xE0000000, r3 = 0xE100, r4 = 1 << 17, str r4, [r2, r3].
    let enable_rtc1 = [0x22E0, 0x0612, 0x23E1, 0x021B, 0x2401, 0x0464, 0x50D4];
    // This code stores the answer in RAM: movs r2, #0x20; lsls r2, #24; str r0, [r2].
    let keep_answer = [0x2220, 0x0612, 0x6010];
    let mut board = run(&[&enable_rtc1[..], &ENABLE, &keep_answer].concat());
    assert_eq!(board.soc().ram.word(RAM_START), super::abi::error::INTERRUPT_CONFIGURATION);
    assert!(!board.softdevice().is_enabled());
}

#[test]
#[should_panic(expected = "S140 needs RAM")]
fn an_image_whose_ram_begins_too_low_is_told_so() {
    // This code stores the start of the image's RAM (r3 = 0x20001000) at r2 + 64, and sets r0 = r2 + 64.
    // Then it calls svc 96 (sd_ble_enable).
    let ble_enable = [0x2220, 0x0612, 0x2301, 0x031B, 0x189B, 0x6413, 0x2040, 0x1880, 0xDF60];
    run(&[&ENABLE[..], &ble_enable].concat());
}
