//! Tests the right hand over Bluetooth with the real program and the real btleplug.
//! BlueZ is replaced by a simulated service on a private bus.
//! The board is the emulated Nano 33, and a pseudo-terminal carries its frames instead of a radio.
//!
//! BlueZ, D-Bus and btleplug use wall-clock time.
//! Board and program share a time that is never faster than the wall clock and is slower on a busy machine.
//! The tests therefore wait for events instead of fixed durations.
#![cfg(all(feature = "ble", feature = "nrf", unix))]

use std::process::{Command, ExitStatus};
use std::time::Duration;

use models::synth::{Motion, Wearer};
use tests::bluez::{Bluez, Bus};
use tests::desk::program::{Desk, Running};
use tests::desk::programs::folder;
use tests::desk::right::{Right, RightStation};

/// Maximum number of attempts. The model does not recognise every simulated gesture.
const DRAWINGS: u32 = 3;
const SOON: Duration = Duration::from_secs(12);

/// Creates a desk whose time is never faster than the wall clock.
fn desk(name: &str) -> Desk {
    let desk = Desk::new(name);
    desk.time().keep_pace();
    desk
}

fn bridge(desk: &Desk, bus: &str, args: &[&str]) -> Running {
    println!("$ host-bridge {}", args.join(" "));
    let mut command = Command::new(folder().join("host-bridge"));
    command.args(args).env("DBUS_SYSTEM_BUS_ADDRESS", bus);
    desk.start(command)
}

fn run(desk: &Desk, bus: &Bus, args: &[&str]) -> (ExitStatus, String) {
    bridge(desk, &bus.address, args).end()
}

fn draw(run: &mut Running, right: &RightStation) {
    for _ in 0..DRAWINGS {
        if !run.is_armed() {
            run.wait(&["\"event\":\"state\"", "armed"]);
        }
        right.with(|board| board.perform(Motion::Circle, 4.0));
        if run.wait_for(SOON, &["\"gesture\"", "circle", "started"]).is_some() {
            return;
        }
    }
    panic!("no gesture moves the arm; there were\n{}", run.seen.join("\n"));
}

#[test]
fn a_board_is_found_by_its_service_answers_and_is_told_apart_from_a_bluetooth_that_is_off() {
    let desk = desk("ble-list");
    let bus = Bus::start(&desk.path(""));
    // The D-Bus has no Bluetooth service.
    let (status, text) = run(&desk, &bus, &["list"]);
    assert!(!status.success() && text.contains("sudo systemctl start bluetooth"), "{text}");
    let (status, text) = bridge(&desk, "unix:path=/no/such/bus", &["doctor", "--right", "ble"]).end();
    assert!(!status.success() && text.contains("Bluetooth"), "{text}");

    let right = Right::start(&desk, "air", Wearer::demo(1));
    let bluez = Bluez::start(&bus, &desk.path("air"));
    let (status, text) = run(&desk, &bus, &["list"]);
    assert!(status.success(), "{text}");
    for word in [
        "ble:bimanual-right",
        "C0:FF:EE:00:00:33, -57 dBm, heard in the last 3 s",
        "the right hand (Nano 33 BLE Sense), firmware",
        "model ",
    ] {
        assert!(text.contains(word), "{word} in\n{text}");
    }
    let (_, text) = run(&desk, &bus, &["doctor", "--right", "ble:c0:ff:ee:00:00:33", "--seconds", "2"]);
    for word in ["idle, up-down", "ping and back", "ppm", " 0 damaged", "-57 dBm when found; newest state "] {
        assert!(text.contains(word), "{word} in\n{text}");
    }

    // Only a paired laptop may write.
    bluez.pair(false);
    let (status, text) = run(&desk, &bus, &["doctor", "--right", "ble", "--seconds", "1"]);
    assert!(!status.success() && text.contains("bluetoothctl pair C0:FF:EE:00:00:33"), "{text}");
    bluez.pair(true);

    bluez.power(false);
    let (status, text) = run(&desk, &bus, &["list"]);
    assert!(
        !status.success() && text.contains("Bluetooth: Bluetooth is off") || text.contains("is off"),
        "{text}"
    );
    assert!(text.contains("bluetoothctl power on"), "{text}");
    bluez.power(true);
    right.pull();
    let (status, text) = run(&desk, &bus, &["list"]);
    assert!(!status.success() && text.contains("no hand is in reach"), "{text}");
}

#[test]
fn a_gesture_over_bluetooth_moves_the_arm_and_a_lost_link_halts_it_and_comes_back_by_itself() {
    let desk = desk("ble-run");
    let bus = Bus::start(&desk.path(""));
    let right = Right::start(&desk, "air", Wearer::demo(1));
    let bluez = Bluez::start(&bus, &desk.path("air"));
    bluez.power(false);
    let args = ["run", "--right", "ble:bimanual-right", "--json", "--seconds", "600"];
    let mut run = bridge(&desk, &bus.address, &args);
    run.wait(&["\"open\":false", "Bluetooth is off"]);
    bluez.power(true);
    run.wait(&["\"open\":true"]);
    draw(&mut run, &right);

    // The board is out of range for a while.
    right.pull();
    run.wait(&["\"open\":false", "is gone"]);
    if run.is_armed() {
        run.wait(&["\"halt\""]);
    }
    right.plug();
    run.wait(&["\"open\":true"]);
    run.wait(&["hand-started"]);
    draw(&mut run, &right);

    // Bluetooth is switched off during the connection.
    bluez.power(false);
    run.wait(&["\"open\":false"]);
    bluez.power(true);
    run.wait(&["\"open\":true"]);
    draw(&mut run, &right);
}
