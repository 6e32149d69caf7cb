//! GATT server calls: the attribute table, notifications, and writes by the laptop.

use super::super::soc::Soc;
use super::abi::{Answer, SocEvent, bytes, call, error, event, put, u8_at, u16_at, u32_at};
use super::link::HANDLE;
use super::{SoftDevice, central::Happening};

/// All handles up to this number belong to S140's own services (GAP and GATT).
const OWN_HANDLES: u16 = 13;
/// Approximate size of S140's own services in the table, in bytes.
const OWN_BYTES: u32 = 200;
/// Approximate size of an attribute without its value, in bytes.
const ATTRIBUTE_BYTES: u32 = 24;
const CCCD: u16 = 0x2902;
const WRITE_REQUEST: u8 = 1;
const WRITE_COMMAND: u8 = 2;

/// Error codes of ATT.
const ATT_WRITE_NOT_PERMITTED: u8 = 0x03;
const ATT_INSUFFICIENT_AUTHENTICATION: u8 = 0x05;
const ATT_INVALID_LENGTH: u8 = 0x0D;

/// Properties of a characteristic, as bits of the headers.
const CAN_WRITE_COMMAND: u8 = 1 << 2;
const CAN_WRITE: u8 = 1 << 3;
const CAN_NOTIFY: u8 = 1 << 4;

/// The security that a write requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Permission {
    Never,
    Open,
    Encrypted,
}

fn permission(raw: u8) -> Result<Permission, u32> {
    match raw {
        0x00 => Ok(Permission::Never),
        0x11 => Ok(Permission::Open),
        0x21 => Ok(Permission::Encrypted),
        _ => Err(error::INVALID_PARAM),
    }
}

#[derive(Clone, Debug)]
struct Characteristic {
    uuid: [u8; 16],
    short: (u16, u8),
    properties: u8,
    handle: u16,
    cccd: Option<(u16, Permission)>,
    write: Permission,
    max_len: u16,
    value: Vec<u8>,
}

/// The services of the application.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    next: u16,
    free: u32,
    services: Vec<(u16, [u8; 16])>,
    characteristics: Vec<Characteristic>,
}

impl Table {
    pub(super) fn new(size: u32) -> Self {
        Self { next: OWN_HANDLES + 1, free: size.saturating_sub(OWN_BYTES), ..Self::default() }
    }

    fn take(&mut self, value: u16) -> Result<u16, u32> {
        self.free = self.free.checked_sub(ATTRIBUTE_BYTES + u32::from(value)).ok_or(error::NO_MEM)?;
        self.next += 1;
        Ok(self.next - 1)
    }

    fn by_handle(&mut self, handle: u16) -> Result<&mut Characteristic, u32> {
        self.characteristics.iter_mut().find(|c| c.handle == handle).ok_or(error::INVALID_ATTR_HANDLE)
    }

    fn first(&self, property: u8) -> Option<&Characteristic> {
        self.characteristics.iter().find(|c| c.properties & property != 0)
    }
}

impl SoftDevice {
    /// Returns the UUIDs of the application's services and characteristics, as a laptop discovers them.
    pub fn discover(&self) -> (Vec<u128>, Vec<u128>) {
        let services = self.table.services.iter().map(|(_, uuid)| u128::from_le_bytes(*uuid)).collect();
        let parts = self.table.characteristics.iter().map(|c| u128::from_le_bytes(c.uuid)).collect();
        (services, parts)
    }

    pub(super) fn gatts_call(&mut self, number: u8, args: [u32; 4], soc: &mut Soc) -> Answer {
        let [a, b, c, d] = args;
        match number {
            call::SERVICE_ADD => {
                let uuid = self
                    .whole_uuid(u16_at(soc, b)?, u8_at(soc, b + 2)?)
                    .filter(|_| a == 1)
                    .ok_or(error::INVALID_PARAM)?;
                let handle = self.table.take(16)?;
                self.table.services.push((handle, uuid));
                put(soc, c, &handle.to_le_bytes())
            }
            call::CHARACTERISTIC_ADD => self.add_characteristic(b, c, d, soc),
            call::HVX => self.notify(a, b, soc),
            call::SYS_ATTR_SET => {
                let link = self.open_link(a)?;
                if b != 0 {
                    return self.restore(b, c as usize & 0xFFFF, soc);
                }
                link.system_attributes = true;
                Ok(())
            }
            call::SYS_ATTR_GET => {
                let Some(link) = self.link.as_ref().filter(|_| a as u16 == HANDLE) else {
                    return Err(error::INVALID_CONN_HANDLE);
                };
                let cccd = self.table.first(CAN_NOTIFY).and_then(|c| c.cccd).map_or(0, |(handle, _)| handle);
                let mut saved = Vec::new();
                for half in [cccd, 2, u16::from(link.subscribed), 0x5A5A] {
                    saved.extend(half.to_le_bytes());
                }
                let room = u16_at(soc, c)?;
                put(soc, c, &(saved.len() as u16).to_le_bytes())?;
                if b == 0 {
                    return Ok(());
                }
                if usize::from(room) < saved.len() {
                    return Err(error::DATA_SIZE);
                }
                put(soc, b, &saved)
            }
            call::EXCHANGE_MTU_REPLY => {
                let most = self.config.mtu;
                let now = soc.now;
                let link = self.open_link(a)?;
                let Some(client) = link.mtu_asked else { return Err(error::INVALID_STATE) };
                let server = b as u16;
                if !(23..=most).contains(&server) {
                    return Err(error::INVALID_PARAM);
                }
                link.mtu_asked = None;
                link.mtu = client.min(server);
                let mtu = link.mtu;
                self.central.tell(now, Happening::Mtu(mtu));
                Ok(())
            }
            call::VALUE_SET | call::VALUE_GET => {
                let len = u16_at(soc, c)?;
                let place = u32_at(soc, c + 4)?;
                let written =
                    if number == call::VALUE_SET { bytes(soc, place, len.into())? } else { Vec::new() };
                let characteristic = self.table.by_handle(b as u16)?;
                if number == call::VALUE_SET {
                    characteristic.value = written;
                    return Ok(());
                }
                let value = characteristic.value.clone();
                put(soc, c, &(value.len() as u16).to_le_bytes())?;
                put(soc, place, &value[..value.len().min(len.into())])
            }
            _ => self.unknown(number),
        }
    }

    // CCCDs of a bonded laptop are restored only from saved values.
    fn restore(&mut self, place: u32, len: usize, soc: &Soc) -> Answer {
        let saved = bytes(soc, place, len)?;
        let halves: Vec<u16> = saved.chunks_exact(2).map(|h| u16::from_le_bytes([h[0], h[1]])).collect();
        let cccd = self.table.first(CAN_NOTIFY).and_then(|c| c.cccd).map_or(0, |(handle, _)| handle);
        let &[handle, 2, value, 0x5A5A] = halves.as_slice() else { return Err(error::INVALID_DATA) };
        if handle != cccd {
            return Err(error::INVALID_DATA);
        }
        let link = self.link.as_mut().expect("a link");
        link.system_attributes = true;
        link.subscribed = value & 1 != 0;
        Ok(())
    }

    fn add_characteristic(&mut self, about: u32, attribute: u32, handles: u32, soc: &mut Soc) -> Answer {
        let uuid_at = u32_at(soc, attribute)?;
        let short = (u16_at(soc, uuid_at)?, u8_at(soc, uuid_at + 2)?);
        let uuid = self.whole_uuid(short.0, short.1).ok_or(error::INVALID_PARAM)?;
        let properties = u8_at(soc, about)?;
        let metadata = u32_at(soc, attribute + 4)?;
        let write = permission(u8_at(soc, metadata + 1)?)?;
        let bits = u8_at(soc, metadata + 2)?;
        let (len, max_len) = (u16_at(soc, attribute + 8)?, u16_at(soc, attribute + 12)?);
        if max_len > 512 || len > max_len || bits >> 1 & 3 != 1 {
            return Err(error::INVALID_PARAM);
        }
        if bits >> 3 & 3 != 0 {
            self.rules.broke("reads or writes that ask the application first are not modelled");
        }
        let value = bytes(soc, u32_at(soc, attribute + 16)?.max(4), len.into())?;
        self.table.take(19)?;
        let handle = self.table.take(max_len)?;
        let cccd_metadata = u32_at(soc, about + 20)?;
        let cccd = if properties & CAN_NOTIFY != 0 {
            let permission = permission(u8_at(soc, cccd_metadata + 1)?)?;
            Some((self.table.take(2)?, permission))
        } else {
            None
        };
        self.table.characteristics.push(Characteristic {
            uuid,
            short,
            properties,
            handle,
            cccd,
            write,
            max_len,
            value,
        });
        let mut out = Vec::new();
        for half in [handle, 0, cccd.map_or(0, |(handle, _)| handle), 0] {
            out.extend(half.to_le_bytes());
        }
        put(soc, handles, &out)
    }

    fn notify(&mut self, connection: u32, parameters: u32, soc: &mut Soc) -> Answer {
        let handle = u16_at(soc, parameters)?;
        let kind = u8_at(soc, parameters + 2)?;
        let len_at = u32_at(soc, parameters + 8)?;
        let len = u16_at(soc, len_at)?;
        let data = u32_at(soc, parameters + 12)?;
        let room = self.config.notifications;
        let link = self.open_link(connection)?;
        let (mtu, waiting, exchanging) = (link.mtu, link.queue.len(), link.mtu_asked.is_some());
        let (known, subscribed) = (link.system_attributes, link.subscribed);
        let characteristic = self.table.by_handle(handle)?;
        if kind != 1 || characteristic.properties & CAN_NOTIFY == 0 {
            return Err(error::INVALID_PARAM);
        }
        if !known {
            return Err(error::SYS_ATTR_MISSING);
        }
        if exchanging || !subscribed {
            return Err(error::INVALID_STATE);
        }
        if len > characteristic.max_len {
            return Err(error::DATA_SIZE);
        }
        if waiting >= room {
            return Err(error::RESOURCES);
        }
        // Data that does not fit in the MTU is truncated.
        let sent = len.min(mtu - 3);
        let bytes = bytes(soc, data, sent.into())?;
        put(soc, len_at, &sent.to_le_bytes())?;
        characteristic.value.clone_from(&bytes);
        self.link.as_mut().expect("a link").queue.push_back(bytes);
        Ok(())
    }

    /// Enables or disables notifications.
    /// Nothing happens if the application must first restore its attributes.
    pub(super) fn subscribe(&mut self, on: bool, soc: &mut Soc) -> Option<bool> {
        let link = self.link.as_mut().expect("a link");
        if !link.system_attributes {
            if !std::mem::replace(&mut link.attributes_asked, true) {
                let missing = SocEvent::gatts(event::SYS_ATTR_MISSING, HANDLE).with(&[0, 0]).finish();
                self.raise(missing, &mut soc.nvic);
            }
            return None;
        }
        let Some((handle, permission)) = self.table.first(CAN_NOTIFY).and_then(|c| c.cccd) else {
            return Some(false);
        };
        if permission == Permission::Encrypted && !link.encrypted {
            return Some(false);
        }
        link.subscribed = on;
        let write = write_event(handle, (CCCD, 1), WRITE_REQUEST, &[u8::from(on), 0]);
        self.raise(write, &mut soc.nvic);
        Some(true)
    }

    /// Processes a frame that the laptop writes.
    pub(super) fn written(&mut self, data: &[u8], with_response: bool, soc: &mut Soc) -> Result<(), u8> {
        let (property, operation) =
            if with_response { (CAN_WRITE, WRITE_REQUEST) } else { (CAN_WRITE_COMMAND, WRITE_COMMAND) };
        let link = self.link.as_ref().expect("a link");
        let target = self.table.first(property).ok_or(ATT_WRITE_NOT_PERMITTED)?;
        match target.write {
            Permission::Never => return Err(ATT_WRITE_NOT_PERMITTED),
            Permission::Encrypted if !link.encrypted => return Err(ATT_INSUFFICIENT_AUTHENTICATION),
            _ => {}
        }
        assert!(data.len() + 3 <= link.mtu.into(), "the laptop sends more than the MTU");
        if data.len() > target.max_len.into() {
            return Err(ATT_INVALID_LENGTH);
        }
        let event = write_event(target.handle, target.short, operation, data);
        self.raise(event, &mut soc.nvic);
        Ok(())
    }
}

fn write_event(handle: u16, (uuid, kind): (u16, u8), operation: u8, data: &[u8]) -> Vec<u8> {
    SocEvent::gatts(event::WRITE, HANDLE)
        .halves(&[handle, uuid])
        .with(&[kind, 0, operation, 0])
        .halves(&[0, data.len() as u16])
        .with(data)
        .finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_runs_full_and_says_so() {
        let mut table = Table::new(OWN_BYTES + 2 * (ATTRIBUTE_BYTES + 16));
        assert_eq!((table.take(16), table.take(16)), (Ok(14), Ok(15)));
        assert_eq!(table.take(0), Err(error::NO_MEM));
    }

    #[test]
    fn a_write_of_a_full_mtu_is_an_event_of_262_bytes() {
        assert_eq!(write_event(19, (3, 2), WRITE_COMMAND, &[0; 244]).len(), 262);
    }
}
