//! Tests that power cuts lose no stored laptop, and that the number of stored laptops is limited.

use proptest::prelude::*;
use shared_board::bonds::{Bond, BondLog, Laptops, NotKept, REMEMBERED};
use shared_board::memory::{RamFlash, at_once};

/// Number of records in a page: 4096 bytes without a header of 16 bytes, at 48 bytes each.
const PER_PAGE: u32 = 85;

/// Returns a bond with a laptop. A different `key` stands for a different pairing with the same laptop.
fn laptop(number: u8, key: u8) -> Bond {
    Bond {
        key: [key; 16],
        resolving: [0; 16],
        address: [number, 1, 2, 3, 4, 5],
        address_is_random: false,
        authenticated: false,
        listens: false,
    }
}

fn remembered(flash: &RamFlash) -> Vec<Bond> {
    BondLog::open(flash.clone()).laptops().iter().copied().collect()
}

fn keep(flash: RamFlash, bond: Bond) -> (RamFlash, Result<(), NotKept>) {
    let mut log = BondLog::open(flash);
    let result = at_once(log.keep(bond));
    (log.into_flash(), result)
}

fn keep_all(flash: RamFlash, bonds: impl IntoIterator<Item = Bond>) -> RamFlash {
    bonds.into_iter().fold(flash, |flash, bond| {
        let (flash, result) = keep(flash, bond);
        assert_eq!(result, Ok(()));
        flash
    })
}

#[test]
fn four_laptops_are_remembered_over_a_restart_and_a_fifth_takes_the_place_of_the_oldest() {
    assert_eq!(REMEMBERED, 4);
    let all: Vec<Bond> = (0..5).map(|i| laptop(i, i + 10)).collect();
    let flash = keep_all(RamFlash::blank(), all[..4].iter().copied());
    assert_eq!(remembered(&flash), all[..4]);
    let flash = keep_all(flash, [all[4]]);
    assert_eq!(remembered(&flash), all[1..]);
}

#[test]
fn a_laptop_that_pairs_again_is_remembered_once_with_its_new_keys() {
    let flash = keep_all(RamFlash::blank(), [laptop(1, 1), laptop(2, 2), laptop(1, 3)]);
    assert_eq!(remembered(&flash), [laptop(2, 2), laptop(1, 3)]);
}

#[test]
fn only_a_bond_without_a_passkey_weakens_one_with_a_passkey() {
    let with_passkey = |number, key| Bond { authenticated: true, ..laptop(number, key) };
    let mut laptops = Laptops::default();
    laptops.keep(with_passkey(1, 1));
    laptops.keep(laptop(2, 2));
    assert!(laptops.would_be_weakened_by(&laptop(1, 3)));
    for fine in [with_passkey(1, 3), laptop(2, 3), with_passkey(2, 3), laptop(3, 3)] {
        assert!(!laptops.would_be_weakened_by(&fine), "{fine:?}");
    }
}

#[test]
fn a_laptop_that_changes_its_address_is_known_by_its_resolving_key() {
    let with = |number, key| Bond { resolving: [7; 16], ..laptop(number, key) };
    let flash = keep_all(RamFlash::blank(), [with(1, 1), laptop(3, 3), with(2, 2)]);
    assert_eq!(remembered(&flash), [laptop(3, 3), with(2, 2)]);
    // Without this key, only the address identifies the laptop.
    let flash = keep_all(RamFlash::blank(), [laptop(1, 1), laptop(2, 2)]);
    assert_eq!(remembered(&flash), [laptop(1, 1), laptop(2, 2)]);
}

#[test]
fn every_field_survives_and_what_is_known_already_is_not_written() {
    let bond = Bond {
        key: core::array::from_fn(|i| i as u8),
        resolving: core::array::from_fn(|i| 0xF0 | i as u8),
        address: [0xC0, 0xFF, 0xEE, 0, 0x80, 0xFF],
        address_is_random: true,
        authenticated: true,
        listens: true,
    };
    let flash = keep_all(RamFlash::blank(), [bond]);
    assert_eq!(remembered(&flash), [bond]);
    let operations = flash.operations;
    let flash = keep_all(flash, [bond]);
    assert_eq!(flash.operations, operations);
    // A record of twelve words needs one operation per word.
    let flash = keep_all(flash, [Bond { listens: false, ..bond }]);
    assert_eq!(flash.operations, operations + 12);
    assert_eq!(remembered(&flash), [Bond { listens: false, ..bond }]);
}

#[test]
fn full_pages_take_turns_and_nothing_is_forgotten() {
    let mut flash = keep_all(RamFlash::blank(), [laptop(1, 1), laptop(2, 2)]);
    for i in 0..3 * PER_PAGE {
        let bond = laptop(3, i as u8);
        flash = keep_all(flash, [bond]);
        assert_eq!(remembered(&flash), [laptop(1, 1), laptop(2, 2), bond], "after {i}");
    }
}

#[test]
fn what_another_image_left_there_counts_as_nothing() {
    let mut flash = RamFlash::blank();
    for (i, byte) in b"BMB2 and keys of the image for S140".iter().enumerate() {
        *flash.byte_mut(0x1000 + i) = *byte;
        *flash.byte_mut(i) = !*byte;
    }
    assert_eq!(remembered(&flash), []);
    let flash = keep_all(flash, [laptop(1, 1)]);
    assert_eq!(remembered(&flash), [laptop(1, 1)]);
}

#[test]
fn a_damaged_record_is_left_out_and_the_others_count() {
    let mut flash = keep_all(RamFlash::blank(), [laptop(1, 1), laptop(2, 2), laptop(3, 3)]);
    *flash.byte_mut(16 + 48 + 5) ^= 1;
    assert_eq!(remembered(&flash), [laptop(1, 1), laptop(3, 3)]);
    let flash = keep_all(flash, [laptop(4, 4)]);
    assert_eq!(remembered(&flash), [laptop(1, 1), laptop(3, 3), laptop(4, 4)]);
}

#[test]
fn power_that_goes_at_any_word_leaves_what_was_or_what_is_new_and_the_next_laptop_is_kept() {
    // Tests the first bond, an appended bond, a bond that fills the page, and a bond that fills the second page.
    for written in [0, 3, PER_PAGE, PER_PAGE + 1, 2 * PER_PAGE, 2 * PER_PAGE - 2] {
        let before = keep_all(RamFlash::blank(), (0..written).map(|i| laptop(i as u8 % 4, i as u8)));
        let old = remembered(&before);
        let (after, _) = keep(before.clone(), laptop(9, 99));
        let (all, new) = (after.operations - before.operations, remembered(&after));
        for cut in 1..=all {
            let mut flash = before.clone();
            flash.cut_after = Some(cut);
            flash.torn = cut;
            let (mut flash, result) = keep(flash, laptop(9, 99));
            assert_eq!(result, Err(NotKept), "cut at {cut} of {all}");
            flash.power_up();
            let found = remembered(&flash);
            assert!(found == old || found == new, "after {written}, cut at {cut} of {all}: {found:?}");
            let flash = keep_all(flash, [laptop(10, 100)]);
            let found_next = remembered(&flash);
            assert_eq!(found_next.last(), Some(&laptop(10, 100)), "after {written}, cut at {cut}");
            let mut expected: Laptops = Laptops::default();
            found.iter().for_each(|bond| expected.keep(*bond));
            expected.keep(laptop(10, 100));
            assert_eq!(found_next, expected.iter().copied().collect::<Vec<_>>());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// After repeated power cuts at any word and any bit, all stored bonds remain.
    /// Only the bond of another laptop may replace a stored bond.
    #[test]
    fn no_number_of_power_cuts_makes_a_board_forget(
        filled in 0..2 * PER_PAGE,
        cuts in prop::collection::vec((1u32..80, any::<u32>(), 0u8..6), 1..12),
    ) {
        let mut flash = keep_all(RamFlash::blank(), (0..filled).map(|i| laptop(i as u8 % 3, i as u8)));
        for (i, &(cut, torn, number)) in cuts.iter().enumerate() {
            let old = remembered(&flash);
            let bond = laptop(number, 200 + i as u8);
            flash.cut_after = Some(cut);
            flash.torn = torn;
            let mut log = BondLog::open(flash);
            let _ = at_once(log.keep(bond));
            flash = log.into_flash();
            flash.power_up();
            let mut new = Laptops::default();
            old.iter().for_each(|bond| new.keep(*bond));
            new.keep(bond);
            let found = remembered(&flash);
            prop_assert!(found == old || found == new.iter().copied().collect::<Vec<_>>(), "{found:?}");
        }
    }
}
