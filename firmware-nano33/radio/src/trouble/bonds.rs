//! Decides who may read states and write: only laptops that have bonded. Their keys are kept in flash.
//!
//! Pairing uses LE Secure Connections.
//! If digits can be typed at the laptop, its owner types a passkey that the board shows.
//! Otherwise, pairing is "just works", which protects against listeners.
//! "Just works" does not protect against an attacker nearby who answers in place of the laptop.
//! Any laptop may bond while no bond exists, and for [`PAIRING`] after each start.
//! Later, only laptops whose keys are stored are trusted.

use core::cell::RefCell;

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::Instant;
use shared_board::bonds::{Bond, Laptops};
use trouble_host::connection::SecurityLevel;
use trouble_host::prelude::{AddrKind, BdAddr, BondInformation, IdentityResolvingKey, LongTermKey};
use trouble_host::{Address, Identity};

use super::Stack;
use crate::PAIRING;

/// Bonds that have not been written to flash yet.
static TO_SAVE: Channel<CriticalSectionRawMutex, Bond, 4> = Channel::new();

/// Returns the next bond that must be written to flash.
pub async fn bonded() -> Bond {
    TO_SAVE.receive().await
}

/// The laptops that are trusted.
pub struct Bonds(RefCell<Laptops>);

impl Bonds {
    /// Starts with the laptops that are stored in flash.
    pub fn new(laptops: Laptops) -> Self {
        Self(RefCell::new(laptops))
    }

    /// Returns whether a laptop may bond now.
    pub fn may_bond(&self) -> bool {
        self.0.borrow().is_empty() || Instant::now().as_ticks() < PAIRING.as_ticks()
    }

    /// Returns the laptop to which these stored keys belong.
    pub fn of(&self, keys: &BondInformation) -> Option<Bond> {
        let key = keys.ltk.to_le_bytes();
        self.0.borrow().iter().find(|bond| bond.key == key).copied()
    }

    /// Returns whether this bond would replace a bond that was paired with a passkey by one that was not.
    pub fn would_be_weakened_by(&self, bond: &Bond) -> bool {
        self.0.borrow().would_be_weakened_by(bond)
    }

    /// Stores a new laptop, or the changed keys of a known laptop.
    pub fn keep(&self, bond: Bond) {
        self.0.borrow_mut().keep(bond);
        // The newest bond is the most important one.
        while let Err(embassy_sync::channel::TrySendError::Full(_)) = TO_SAVE.try_send(bond) {
            let _ = TO_SAVE.try_receive();
        }
    }

    /// Gives the stack exactly the stored keys.
    /// If a laptop has paired outside the permitted time, it has replaced some keys in the stack.
    pub fn restore(&self, stack: &Stack) {
        let laptops = *self.0.borrow();
        loop {
            let foreign = stack.with_bond_information(|all| {
                all.iter()
                    .find(|keys| !laptops.iter().any(|bond| into_keys(bond) == **keys))
                    .map(|keys| keys.identity)
            });
            let Some(identity) = foreign else { break };
            if stack.remove_bond_information(identity).is_err() {
                break;
            }
        }
        for bond in laptops.iter() {
            let keys = into_keys(bond);
            if !stack.with_bond_information(|all| all.contains(&keys))
                && stack.add_bond_information(keys).is_err()
            {
                defmt::warn!("the stack has no room for a bond");
            }
        }
    }
}

/// Returns the part of new keys that is stored.
pub fn from_keys(keys: &BondInformation) -> Bond {
    Bond {
        key: keys.ltk.to_le_bytes(),
        resolving: keys.identity.irk.map_or([0; 16], IdentityResolvingKey::to_le_bytes),
        address: keys.identity.addr.addr.into_inner(),
        address_is_random: keys.identity.addr.kind.as_raw() & 1 != 0,
        authenticated: keys.security_level == SecurityLevel::EncryptedAuthenticated,
        listens: false,
    }
}

fn into_keys(bond: &Bond) -> BondInformation {
    let kind = if bond.address_is_random { AddrKind::RANDOM } else { AddrKind::PUBLIC };
    let level =
        if bond.authenticated { SecurityLevel::EncryptedAuthenticated } else { SecurityLevel::Encrypted };
    let identity = Identity {
        addr: Address::new(kind, BdAddr::new(bond.address)),
        irk: IdentityResolvingKey::from_le_bytes(bond.resolving),
    };
    BondInformation::new(identity, LongTermKey::from_le_bytes(bond.key), level, true)
}
