//! Who may read states and write: the laptops that have bonded, kept in flash.
//!
//! Pairing is LE Secure Connections, "just works": it keeps out strangers and listeners, not one who is near and answers in the
//! laptop's place while you pair. So as long as nobody has bonded, and for [`PAIRING`] after each start, any laptop may bond;
//! later only those whose keys are kept are trusted.

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

/// Bonds that flash has yet to take.
static TO_SAVE: Channel<CriticalSectionRawMutex, Bond, 4> = Channel::new();

/// The next bond to be kept over a restart.
pub async fn bonded() -> Bond {
    TO_SAVE.receive().await
}

/// The laptops that are trusted.
pub struct Bonds(RefCell<Laptops>);

impl Bonds {
    /// With the laptops that flash holds.
    pub fn new(laptops: Laptops) -> Self {
        Self(RefCell::new(laptops))
    }

    /// Whether a laptop may bond now.
    pub fn may_bond(&self) -> bool {
        self.0.borrow().is_empty() || Instant::now().as_ticks() < PAIRING.as_ticks()
    }

    /// The laptop whose kept keys these are.
    pub fn of(&self, keys: &BondInformation) -> Option<Bond> {
        let key = keys.ltk.to_le_bytes();
        self.0.borrow().iter().find(|bond| bond.key == key).copied()
    }

    /// Keeps a new laptop, or what has changed about one.
    pub fn keep(&self, bond: Bond) {
        self.0.borrow_mut().keep(bond);
        // The newest matters most.
        while let Err(embassy_sync::channel::TrySendError::Full(_)) = TO_SAVE.try_send(bond) {
            let _ = TO_SAVE.try_receive();
        }
    }

    /// Makes the stack know exactly the kept keys: one that paired outside its time has left others in their place.
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

/// What is kept of new keys.
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
