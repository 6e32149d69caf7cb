//! GAP calls: advertising, connection parameters, disconnecting, keys.

use super::super::soc::Soc;
use super::super::time::us;
use super::abi::{Answer, SocEvent, bytes, call, error, event, put, reason, u8_at, u16_at, u32_at};
use super::central::{Bond, Happening, Heard};
use super::link::{Connection, HANDLE, Parameters};
use super::{SoftDevice, rules};

const NO_SET: u8 = 0xFF;
const CONNECTABLE_SCANNABLE: u8 = 1;
const FLAGS: u8 = 1;
const NAME: u8 = 9;

/// An advertising set, whose data is in the application's memory.
#[derive(Clone, Copy, Debug)]
pub(super) struct AdvertisingSet {
    data: (u32, u16),
    response: (u32, u16),
    interval: u64,
}

/// Advertising that is in progress.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beacon {
    pub(super) next: u64,
    count: u64,
}

/// Destination of the keys of a pairing (`ble_gap_sec_keyset_t`).
#[derive(Clone, Copy, Debug)]
pub(super) struct Keyset {
    own_key: u32,
    peer_identity: u32,
}

/// A pairing that is in progress.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pairing {
    keyset: Keyset,
    bond: bool,
    /// Number of connection events until the next step of the pairing.
    wait: u8,
    encrypted: bool,
}

/// Checks the structures of an advertisement: valid lengths, and no type twice.
fn structures(data: &[u8]) -> Result<Vec<u8>, u32> {
    let mut kinds = Vec::new();
    let mut rest = data;
    while let [len, ..] = *rest {
        let len = usize::from(len);
        if len == 0 || rest.len() < 1 + len || kinds.contains(&rest[1]) {
            return Err(error::INVALID_DATA);
        }
        kinds.push(rest[1]);
        rest = &rest[1 + len..];
    }
    Ok(kinds)
}

impl SoftDevice {
    pub(super) fn gap_call(&mut self, number: u8, args: [u32; 4], soc: &mut Soc) -> Answer {
        let [a, b, c, _] = args;
        match number {
            call::ADV_SET_CONFIGURE => self.configure_advertising(a, b, c, soc),
            call::ADV_START => self.start_advertising(a as u8, b as u8, soc),
            call::ADV_STOP => self.beacon.take().map(|_| ()).ok_or(error::INVALID_STATE),
            call::TX_POWER_SET => {
                let known = [-40, -20, -16, -12, -8, -4, 0, 2, 3, 4, 5, 6, 7, 8].contains(&(c as i8));
                if known { Ok(()) } else { Err(error::INVALID_PARAM) }
            }
            call::PPCP_SET => Parameters::read(soc, a).map(|_| ()),
            call::CONN_PARAM_UPDATE => {
                let parameters = Parameters::read(soc, b)?;
                let link = self.open_link(a)?;
                if link.asked.is_some() || link.update.is_some() {
                    return Err(error::BUSY);
                }
                link.asked = Some((parameters, 2));
                Ok(())
            }
            call::DISCONNECT => {
                if ![0x05, 0x13, 0x14, 0x15, 0x1A, 0x29, 0x3B].contains(&(b as u8)) {
                    return Err(error::INVALID_PARAM);
                }
                self.open_link(a)?.closing = Some(reason::LOCAL_HOST);
                Ok(())
            }
            call::PHY_UPDATE => {
                let link = self.open_link(a)?;
                link.fast_in = Some(3);
                Ok(())
            }
            call::DATA_LENGTH_UPDATE => self.data_length(a, b, c, soc),
            call::SEC_PARAMS_REPLY => self.pairing_reply(args, soc),
            call::SEC_INFO_REPLY => self.key_reply(a, b, soc),
            _ => self.unknown(number),
        }
    }

    /// Returns the link, if it is established and not about to end.
    pub(super) fn open_link(&mut self, handle: u32) -> Result<&mut Connection, u32> {
        let link =
            self.link.as_mut().filter(|_| handle as u16 == HANDLE).ok_or(error::INVALID_CONN_HANDLE)?;
        if link.closing.is_some() { Err(error::INVALID_STATE) } else { Ok(link) }
    }

    fn configure_advertising(&mut self, handle: u32, data: u32, parameters: u32, soc: &mut Soc) -> Answer {
        match (u8_at(soc, handle)?, self.set) {
            (NO_SET, None) | (0, Some(_)) => {}
            (NO_SET, Some(_)) => return Err(error::NO_MEM),
            _ => return Err(error::INVALID_ADV_HANDLE),
        }
        if self.beacon.is_some() {
            return Err(error::INVALID_STATE);
        }
        let interval = u32_at(soc, parameters + 8)?;
        let primary = u8_at(soc, parameters + 21)?;
        if u8_at(soc, parameters)? != CONNECTABLE_SCANNABLE
            || u32_at(soc, parameters + 4)? != 0
            || !(32..=16384).contains(&interval)
            || primary != 1
        {
            return Err(error::INVALID_PARAM);
        }
        let part = |at: u32| -> Result<(u32, u16), u32> { Ok((u32_at(soc, at)?, u16_at(soc, at + 4)?)) };
        let (data, response) = (part(data)?, part(data + 8)?);
        if data.1 > 31 || response.1 > 31 {
            return Err(error::INVALID_LENGTH);
        }
        let in_data = structures(&bytes(soc, data.0, data.1.into())?)?;
        let in_response = structures(&bytes(soc, response.0, response.1.into())?)?;
        if in_response.contains(&FLAGS) || (in_data.contains(&NAME) && in_response.contains(&NAME)) {
            return Err(error::INVALID_DATA);
        }
        self.set = Some(AdvertisingSet { data, response, interval: us(625 * u64::from(interval)) });
        put(soc, handle, &[0])
    }

    fn start_advertising(&mut self, handle: u8, tag: u8, soc: &Soc) -> Answer {
        if handle != 0 || self.set.is_none() {
            return Err(error::INVALID_ADV_HANDLE);
        }
        if self.beacon.is_some() {
            return Err(error::INVALID_STATE);
        }
        if self.config.tag != Some(tag) {
            return Err(error::NOT_FOUND);
        }
        if self.link.is_some() {
            return Err(error::CONN_COUNT);
        }
        self.beacon = Some(Beacon { next: soc.now + us(2000), count: 0 });
        Ok(())
    }

    /// Performs the advertising events that are due.
    pub(super) fn advance_beacon(&mut self, now: u64, soc: &mut Soc) {
        let (Some(mut beacon), Some(set)) = (self.beacon, self.set) else { return };
        if beacon.next > now {
            return;
        }
        // A random delay of up to 10 ms is added, so that two boards do not remain synchronised.
        let jitter = us(beacon.count.wrapping_mul(7919) % 10_000);
        beacon.count += 1;
        let at = beacon.next;
        beacon.next += set.interval + jitter;
        self.beacon = Some(beacon);
        if self.flash_holds(at, soc) {
            return;
        }
        self.spend(rules::ADVERTISING_EVENT, soc);
        if !self.central.in_range {
            return;
        }
        let read = |(address, len): (u32, u16)| bytes(soc, address, len.into()).unwrap_or_default();
        self.central.heard = Some(Heard { data: read(set.data), response: read(set.response) });
        self.central.advertisements += 1;
        if self.central.may_connect() {
            self.connect(at, soc);
        }
    }

    fn connect(&mut self, at: u64, soc: &mut Soc) {
        let interval = self.central.first_interval;
        let link = Connection::new(at, interval);
        let [min, max, latency, supervision] = link.parameters.as_halves();
        // The laptop's address is random and static.
        let connected = SocEvent::gap(event::CONNECTED, HANDLE)
            .with(&[1 << 1])
            .with(&self.central.address)
            .with(&[1])
            .halves(&[min, max, latency, supervision])
            .with(&[0; 20]);
        self.link = Some(link);
        self.beacon = None;
        self.raise(connected.finish(), &mut soc.nvic);
        self.central.tell(at, Happening::Connected(interval));
    }

    fn data_length(&mut self, handle: u32, wanted: u32, limits: u32, soc: &mut Soc) -> Answer {
        // Two packets of maximum length, with their acknowledgements, must fit in the event.
        let room = us(1250 * u64::from(self.config.event_length)) >= us(2 * (2120 + 150));
        let mtu = self.config.mtu;
        let long = self.central.long_packets;
        if wanted != 0 {
            self.rules.broke("data length with own values is not modelled");
        }
        let link = self.open_link(handle)?;
        if !room && limits != 0 {
            put(soc, limits, &[0, 0, 0, 0, 1, 0])?;
            return Err(error::RESOURCES);
        }
        if long {
            link.longer_in = Some(((mtu + 4).min(251), 2));
        }
        Ok(())
    }

    fn pairing_reply(&mut self, [handle, status, parameters, keyset]: [u32; 4], soc: &Soc) -> Answer {
        let flags = if status == 0 { u8_at(soc, parameters)? } else { 0 };
        let keyset = if status == 0 {
            Keyset { own_key: u32_at(soc, keyset)?, peer_identity: u32_at(soc, keyset + 20)? }
        } else {
            Keyset { own_key: 0, peer_identity: 0 }
        };
        let link = self.open_link(handle)?;
        let Some(bond) = link.pairing_asked.take() else { return Err(error::INVALID_STATE) };
        if status == 0 {
            let bond = bond && flags & 1 != 0;
            link.pairing = Some(Pairing { keyset, bond, wait: 4, encrypted: false });
        }
        Ok(())
    }

    fn key_reply(&mut self, handle: u32, key: u32, soc: &mut Soc) -> Answer {
        let key = if key == 0 { None } else { Some(bytes(soc, key, 16)?) };
        let bond = self.central.bond;
        let now = soc.now;
        let link = self.open_link(handle)?;
        if !std::mem::take(&mut link.key_asked) {
            return Err(error::INVALID_STATE);
        }
        match (key, bond) {
            (Some(key), Some(bond)) if key == bond.key => link.encrypted_in = Some(2),
            (Some(_), _) => self.rules.broke("the image answered with a key that is not the laptop's"),
            (None, _) => self.central.tell(now, Happening::KeyMissing),
        }
        Ok(())
    }

    /// Reports to the application that the link is encrypted.
    pub(super) fn encrypted(&mut self, soc: &mut Soc) {
        let link = self.link.as_mut().expect("a link");
        link.encrypted = true;
        // The link has security mode 1, level 2, and a key of 16 bytes.
        let update = SocEvent::gap(event::CONN_SEC_UPDATE, HANDLE).with(&[2 << 4 | 1, 16]);
        self.raise(update.finish(), &mut soc.nvic);
    }

    /// Performs the next step of a pairing at a link event.
    pub(super) fn advance_pairing(&mut self, at: u64, soc: &mut Soc) {
        let Some(link) = self.link.as_mut() else { return };
        let Some(mut pairing) = link.pairing.take() else { return };
        if pairing.wait > 0 {
            pairing.wait -= 1;
            link.pairing = Some(pairing);
            return;
        }
        if !pairing.encrypted {
            pairing.encrypted = true;
            pairing.wait = 2;
            link.pairing = Some(pairing);
            return self.encrypted(soc);
        }
        if pairing.bond {
            let seed = soc.now as u8;
            let bond = Bond {
                key: std::array::from_fn(|i| seed.wrapping_mul(31).wrapping_add(i as u8 * 7)),
                diversifier: u16::from(seed) | 0x4100,
                random: [seed; 8],
            };
            let mut key = bond.key.to_vec();
            key.extend([16 << 2, 0]);
            key.extend(bond.diversifier.to_le_bytes());
            key.extend(bond.random);
            let mut identity = vec![0x1E; 16];
            identity.push(1 << 1);
            identity.extend(self.central.address);
            if put(soc, pairing.keyset.own_key, &key).is_err()
                || put(soc, pairing.keyset.peer_identity, &identity).is_err()
            {
                self.rules.broke("the keys of a pairing have no place");
            }
            self.central.bond = Some(bond);
        }
        let bonded = u8::from(pairing.bond);
        // The pairing succeeded with levels 1 and 2 of mode 1; the board's own key and the peer's identity were distributed.
        let status =
            SocEvent::gap(event::AUTH_STATUS, HANDLE).with(&[0, bonded << 2, 3, 0, bonded, bonded << 1]);
        self.raise(status.finish(), &mut soc.nvic);
        self.central.tell(at, Happening::Paired { bonded: pairing.bond });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advertisements_whose_structures_do_not_fit_are_refused() {
        assert_eq!(structures(&[2, 1, 6, 3, 9, b'h', b'i']), Ok(vec![1, 9]));
        assert_eq!(structures(&[]), Ok(vec![]));
        assert_eq!(structures(&[4, 1, 6]), Err(error::INVALID_DATA));
        assert_eq!(structures(&[0, 1]), Err(error::INVALID_DATA));
        assert_eq!(structures(&[2, 1, 6, 2, 1, 6]), Err(error::INVALID_DATA));
    }
}
