//! Lets only the laptop that bonded last make permanent changes to the board.
//!
//! Pairing is "just works" with bonding, because nrf-softdevice does not support LE Secure Connections.
//! Before the first bond, and for [`PAIRING`] after each start, any laptop may bond.
//! A new bond replaces the previous bond.
//! After that time only the bonded laptop is trusted.
//! A laptop that pairs without bonding is never trusted.

use core::cell::Cell;

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Instant;
use nrf_softdevice::ble::gatt_server::{get_sys_attrs, set_sys_attrs};
use nrf_softdevice::ble::security::SecurityHandler;
use nrf_softdevice::ble::{Connection, EncryptionInfo, IdentityKey, MasterId, SecurityMode};

use nano33_radio::PAIRING;

use super::flash::SoftDeviceFlash;
use crate::link::WayOut;
use crate::storage::{BOND_PAGE, Flash, PAGE_BYTES};

/// Whether the laptop listens, and its subscription in S140's own format.
/// A bonded laptop expects the board to remember the subscription while it is away.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(C)]
struct Subscription {
    on: u8,
    len: u8,
    attributes: [u8; 30],
}

const NO_SUBSCRIPTION: Subscription = Subscription { on: 0, len: 0, attributes: [0; 30] };

/// The stored keys of the laptop that bonded last.
#[derive(Clone, Copy)]
#[repr(C)]
struct Bond {
    master_id: MasterId,
    key: EncryptionInfo,
    peer: IdentityKey,
    subscription: Subscription,
}

const BOND_MAGIC: u32 = u32::from_le_bytes(*b"BMB2");
const BOND_WORDS: usize = size_of::<Bond>().div_ceil(4);

/// Handles the SoftDevice's requests for keys.
pub struct Bonder {
    bond: Cell<Option<Bond>>,
    /// Whether the laptop requested the stored keys.
    offered: Cell<bool>,
    trusts: Cell<bool>,
    to_save: Signal<CriticalSectionRawMutex, Bond>,
}

impl Bonder {
    /// Loads the stored keys from flash.
    pub fn load() -> Self {
        let page = BOND_PAGE as *const u32;
        // SAFETY: this is memory-mapped flash that the linker does not use.
        // The magic word includes a version of the layout, so this image wrote these bytes as a bond.
        // All fields of a bond are plain integers.
        let bond = unsafe {
            (page.read_volatile() == BOND_MAGIC).then(|| page.add(1).cast::<Bond>().read_unaligned())
        };
        Self {
            bond: Cell::new(bond),
            offered: Cell::new(false),
            trusts: Cell::new(false),
            to_save: Signal::new(),
        }
    }

    /// Resets the trusted state for a new link.
    pub fn forget_link(&self) {
        self.offered.set(false);
        self.trusts.set(false);
    }

    /// Returns whether the link is encrypted with stored keys.
    pub fn trusts(&self) -> bool {
        self.trusts.get()
    }

    /// Stores whether a bonded laptop has subscribed. Only a subscription is written to flash, to reduce wear.
    pub fn keep_subscription(&self, connection: &Connection) {
        let Some(mut bond) = self.bond.get().filter(|_| self.trusts()) else { return };
        let mut now = NO_SUBSCRIPTION;
        now.on = WayOut::Ble.outbox().is_open().into();
        match get_sys_attrs(connection, &mut now.attributes) {
            Ok(len) => now.len = len as u8,
            Err(_) => return,
        }
        if now == bond.subscription {
            return;
        }
        bond.subscription = now;
        self.bond.set(Some(bond));
        if now.on != 0 {
            self.to_save.signal(bond);
        }
    }

    fn restore_subscription(&self, connection: &Connection) {
        let Some(Bond { subscription, .. }) = self.bond.get() else { return };
        let len = usize::from(subscription.len);
        if let Some(attributes @ [_, ..]) = subscription.attributes.get(..len)
            && set_sys_attrs(connection, Some(attributes)).is_ok()
        {
            WayOut::Ble.outbox().set_open(subscription.on != 0);
        }
    }
}

impl SecurityHandler for Bonder {
    fn can_bond(&self, _: &Connection) -> bool {
        self.bond.get().is_none() || Instant::now().as_ticks() < PAIRING.as_ticks()
    }

    fn on_security_update(&self, connection: &Connection, mode: SecurityMode) {
        if self.offered.get() && !matches!(mode, SecurityMode::NoAccess | SecurityMode::Open) {
            self.trusts.set(true);
            self.restore_subscription(connection);
        }
    }

    fn on_bonded(
        &self,
        connection: &Connection,
        master_id: MasterId,
        key: EncryptionInfo,
        peer: IdentityKey,
    ) {
        let bond = Bond { master_id, key, peer, subscription: NO_SUBSCRIPTION };
        self.bond.set(Some(bond));
        self.trusts.set(true);
        self.to_save.signal(bond);
        self.keep_subscription(connection);
    }

    fn get_key(&self, _: &Connection, master_id: MasterId) -> Option<EncryptionInfo> {
        let key = self.bond.get().filter(|b| b.master_id == master_id).map(|b| b.key);
        self.offered.set(key.is_some());
        key
    }
}

/// Writes bonds to flash.
#[embassy_executor::task]
pub async fn save_bonds(bonder: &'static Bonder) -> ! {
    loop {
        let bond = bonder.to_save.wait().await;
        let mut words = [0; 1 + BOND_WORDS];
        words[0] = BOND_MAGIC;
        // SAFETY: the values are plain integers. They are copied as bytes to a buffer that is large enough.
        unsafe {
            (&raw const bond)
                .cast::<u8>()
                .copy_to_nonoverlapping(words[1..].as_mut_ptr().cast(), size_of::<Bond>());
        }
        let mut flash = SoftDeviceFlash;
        let saved = match flash.erase_page(BOND_PAGE).await {
            // The magic word is written last, so an interrupted write leaves no valid bond.
            Ok(()) => match flash.write(BOND_PAGE + 4, &words[1..]).await {
                Ok(()) => flash.write(BOND_PAGE, &words[..1]).await,
                Err(e) => Err(e),
            },
            Err(e) => Err(e),
        };
        if saved.is_err() {
            defmt::warn!("the bond was not saved; pair again after a restart");
        }
    }
}

const _: () = assert!(4 + BOND_WORDS * 4 <= PAGE_BYTES as usize);
