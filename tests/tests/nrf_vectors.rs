//! Checks in the linked images that no used interrupt leads to the default handler.
//!
//! If one image contains two register crates, it can link silently without some handlers (see `firmware-nano33/pac`).
#![cfg(feature = "nrf")]

use shared_board::update::SLOT_A;
use tests::nrf::build::{Variant, image};
use tests::nrf::image::Image;

const USED: [(usize, &str); 4] = [(2, "UARTE0"), (3, "TWISPI0"), (17, "RTC1"), (39, "USBD")];

fn check(image: &Image, used: &[(usize, &str)], origin: u32) {
    assert_eq!(image.vector_table, origin);
    let default = image.function("DefaultHandler_");
    for &(irq, name) in used {
        let handler = image.word(origin + 4 * (16 + irq as u32)).expect("the table is in the image") & !1;
        println!("{name:<12} interrupt {irq:>2} -> {handler:#x}");
        assert_ne!(handler, default, "{name} ends in the default handler");
        assert!(handler > origin, "{name} has no handler");
    }
    // This check can fail: unused interrupts do lead to the default handler.
    assert_eq!(image.word(origin + 4 * (16 + 28)).unwrap() & !1, default);
}

#[test]
fn every_used_vector_of_the_image_for_the_stock_bootloader_is_handled() {
    let mut used = USED.to_vec();
    used.push((0, "CLOCK_POWER"));
    check(&image(Variant::Bootloader), &used, 0x10000);
}

#[test]
fn every_used_vector_of_the_image_behind_s140_is_handled() {
    let mut used = USED.to_vec();
    used.extend([(6, "GPIOTE"), (22, "SWI2_EGU2")]);
    check(&image(Variant::Ble), &used, 0x27000);
}

#[test]
fn every_used_vector_of_the_image_with_bluetooth_linked_in_is_handled() {
    if !tests::has_linked_image() {
        return;
    }
    let mut used = USED.to_vec();
    used.extend([
        (0, "CLOCK_POWER"),
        (1, "RADIO"),
        (6, "GPIOTE"),
        (8, "TIMER0"),
        (11, "RTC0"),
        (20, "EGU0_SWI0"),
    ]);
    // The second stage is stored before the image.
    check(&image(Variant::Trouble), &used, 0x10000 + SLOT_A);
}
