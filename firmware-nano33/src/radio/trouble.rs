//! Bluetooth that is linked into the image. This file connects `nano33_radio::trouble` to the other tasks.

use core::task::{Context, Poll};

use embassy_executor::Spawner;
use embassy_nrf::Peri;
use embassy_nrf::peripherals::USBD;
use embassy_nrf::usb::vbus_detect::SoftwareVbusDetect;
use nano33_radio::trouble::{self, Parts, SlotFlash};
use shared_board::bonds::BondLog;
use shared_board::say_pairing;
use shared_proto::message::PairingKind;

pub use nano33_radio::trouble::{cable, passkey};

use crate::link::{Frame, Inlet, Outbox, WayOut};
use crate::storage::{BONDS_BYTES, BONDS_START, Flash, FlashFailed, Region};

type Log = BondLog<Region<RadioFlash, BONDS_START, BONDS_BYTES>>;

/// Writes to flash between radio events.
#[derive(Clone, Copy)]
pub struct RadioFlash(SlotFlash);

impl Flash for RadioFlash {
    async fn erase_page(&mut self, address: u32) -> Result<(), FlashFailed> {
        self.0.erase_page(address).await.map_err(|_| FlashFailed)
    }

    async fn write(&mut self, address: u32, words: &[u32]) -> Result<(), FlashFailed> {
        self.0.write(address, words).await.map_err(|_| FlashFailed)
    }
}

impl trouble::Outbox for Outbox {
    fn set_open(&self, open: bool) {
        Outbox::set_open(self, open);
    }

    fn poll_next(&self, context: &mut Context<'_>) -> Poll<Frame> {
        Outbox::poll_next(self, context)
    }
}

/// Sends the passkey over both cables. It must never leave over the air.
pub fn say_passkey(passkey: u32) {
    for mut cable in [WayOut::Usb, WayOut::Uart] {
        say_pairing(PairingKind::Passkey, passkey, &mut cable);
    }
}

/// Tells the laptop over Bluetooth how it was paired.
pub fn say_paired() {
    let kind = match trouble::paired() {
        Some(trouble::Pairing::JustWorks) => PairingKind::JustWorks,
        Some(trouble::Pairing::PasskeyTyped) => PairingKind::PasskeyTyped,
        None => return,
    };
    say_pairing(kind, 0, &mut WayOut::Ble);
}

/// The running radio.
pub struct Radio(trouble::Radio);

impl Radio {
    /// Starts clocks and time slots.
    pub fn start(parts: Parts) -> Self {
        Self(trouble::Radio::start(parts))
    }

    /// A random number.
    pub fn random(&mut self) -> u32 {
        self.0.random()
    }

    /// Returns access to the flash that shares time with the radio.
    pub fn flash(&mut self) -> RadioFlash {
        RadioFlash(self.0.flash())
    }

    /// Starts everything else.
    pub fn spawn(mut self, spawner: Spawner, usbd: Peri<'static, USBD>) {
        let log = Log::open(Region(self.flash()));
        let vbus = self.0.spawn(spawner, log.laptops(), WayOut::Ble.outbox());
        spawner.spawn(save(log).expect("spawned once"));
        spawner.spawn(receive().expect("spawned once"));
        spawner.spawn(run_usb(usbd, vbus).expect("spawned once"));
    }
}

/// Writes bonds to flash.
#[embassy_executor::task]
async fn save(mut log: Log) -> ! {
    loop {
        if log.keep(trouble::bonded().await).await.is_err() {
            defmt::warn!("the bond was not saved; pair again after a restart");
        }
    }
}

/// Passes on the data that a trusted laptop writes.
#[embassy_executor::task]
async fn receive() -> ! {
    let mut inlet = Inlet::new(WayOut::Ble);
    loop {
        match trouble::written().await {
            Some(bytes) => inlet.take(&bytes, true).await,
            // Another link begins.
            // An incomplete frame from the previous link must not be joined with its first frame.
            None => inlet = Inlet::new(WayOut::Ble),
        }
    }
}

#[embassy_executor::task]
async fn run_usb(usbd: Peri<'static, USBD>, vbus: &'static SoftwareVbusDetect) {
    crate::usb::run(usbd, vbus).await
}
