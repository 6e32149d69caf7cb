//! Numbers and memory layouts of the interface of S140 7.x, from its headers (crate `nrf-softdevice-s140`).

use super::super::memory::RAM_START;
use super::super::soc::Soc;

/// Numbers of calls (SVC).
#[allow(missing_docs, reason = "the names of the headers, less their prefix sd_")]
pub mod call {
    pub const SOFTDEVICE_ENABLE: u8 = 16;
    pub const FLASH_PAGE_ERASE: u8 = 40;
    pub const FLASH_WRITE: u8 = 41;
    pub const RAND_VECTOR_GET: u8 = 49;
    pub const POWER_GPREGRET_SET: u8 = 60;
    pub const POWER_GPREGRET_CLR: u8 = 61;
    pub const HFCLK_REQUEST: u8 = 66;
    pub const HFCLK_RELEASE: u8 = 67;
    pub const EVT_GET: u8 = 75;
    pub const USBPWRRDY_ENABLE: u8 = 77;
    pub const USBDETECTED_ENABLE: u8 = 78;
    pub const USBREMOVED_ENABLE: u8 = 79;
    pub const USBREGSTATUS_GET: u8 = 80;
    pub const BLE_ENABLE: u8 = 96;
    pub const BLE_EVT_GET: u8 = 97;
    pub const UUID_VS_ADD: u8 = 98;
    pub const BLE_CFG_SET: u8 = 105;
    pub const ADV_SET_CONFIGURE: u8 = 114;
    pub const ADV_START: u8 = 115;
    pub const ADV_STOP: u8 = 116;
    pub const CONN_PARAM_UPDATE: u8 = 117;
    pub const DISCONNECT: u8 = 118;
    pub const TX_POWER_SET: u8 = 119;
    pub const PPCP_SET: u8 = 122;
    pub const SEC_PARAMS_REPLY: u8 = 127;
    pub const SEC_INFO_REPLY: u8 = 134;
    pub const PHY_UPDATE: u8 = 143;
    pub const DATA_LENGTH_UPDATE: u8 = 144;
    pub const SERVICE_ADD: u8 = 168;
    pub const CHARACTERISTIC_ADD: u8 = 170;
    pub const VALUE_SET: u8 = 172;
    pub const VALUE_GET: u8 = 173;
    pub const HVX: u8 = 174;
    pub const SYS_ATTR_SET: u8 = 177;
    pub const SYS_ATTR_GET: u8 = 178;
    pub const EXCHANGE_MTU_REPLY: u8 = 181;
}

/// Numbers of events of the Bluetooth stack.
#[allow(missing_docs, reason = "the names of the headers, less their prefix")]
pub mod event {
    pub const CONNECTED: u16 = 16;
    pub const DISCONNECTED: u16 = 17;
    pub const CONN_PARAM_UPDATE: u16 = 18;
    pub const SEC_PARAMS_REQUEST: u16 = 19;
    pub const SEC_INFO_REQUEST: u16 = 20;
    pub const AUTH_STATUS: u16 = 25;
    pub const CONN_SEC_UPDATE: u16 = 26;
    pub const TIMEOUT: u16 = 27;
    pub const PHY_UPDATE_REQUEST: u16 = 33;
    pub const PHY_UPDATE: u16 = 34;
    pub const DATA_LENGTH_UPDATE: u16 = 36;
    pub const WRITE: u16 = 80;
    pub const SYS_ATTR_MISSING: u16 = 82;
    pub const EXCHANGE_MTU_REQUEST: u16 = 85;
    pub const HVN_TX_COMPLETE: u16 = 87;
}

/// Numbers of events of the chip.
#[allow(missing_docs, reason = "the names of the headers, less their prefix")]
pub mod soc_event {
    pub const FLASH_SUCCESS: u32 = 2;
    pub const FLASH_ERROR: u32 = 3;
    pub const USB_POWER_READY: u32 = 9;
    pub const USB_DETECTED: u32 = 10;
    pub const USB_REMOVED: u32 = 11;
}

/// Results of calls. The value 0 means success.
#[allow(missing_docs, reason = "the names of the headers, less their prefix")]
pub mod error {
    pub const NOT_ENABLED: u32 = 2;
    pub const NO_MEM: u32 = 4;
    pub const NOT_FOUND: u32 = 5;
    pub const NOT_SUPPORTED: u32 = 6;
    pub const INVALID_PARAM: u32 = 7;
    pub const INVALID_STATE: u32 = 8;
    pub const INVALID_LENGTH: u32 = 9;
    pub const INVALID_DATA: u32 = 11;
    pub const DATA_SIZE: u32 = 12;
    pub const FORBIDDEN: u32 = 15;
    pub const INVALID_ADDR: u32 = 16;
    pub const BUSY: u32 = 17;
    pub const CONN_COUNT: u32 = 18;
    pub const RESOURCES: u32 = 19;
    pub const INTERRUPT_CONFIGURATION: u32 = 0x1001;
    pub const RAND_NOT_ENOUGH: u32 = 0x2007;
    pub const BLE_NOT_ENABLED: u32 = 0x3001;
    pub const INVALID_CONN_HANDLE: u32 = 0x3002;
    pub const INVALID_ATTR_HANDLE: u32 = 0x3003;
    pub const INVALID_ADV_HANDLE: u32 = 0x3004;
    pub const SYS_ATTR_MISSING: u32 = 0x3401;
}

/// Reasons for the end of a link (Bluetooth's HCI error codes).
#[allow(missing_docs, reason = "the names of the headers, less their prefix")]
pub mod reason {
    pub const TIMEOUT: u8 = 0x08;
    pub const REMOTE_USER: u8 = 0x13;
    pub const LOCAL_HOST: u8 = 0x16;
}

/// The return value of a call.
pub type Answer = Result<(), u32>;

/// Reads memory for a call. Arguments may be in RAM or flash, but results only in RAM.
pub fn bytes(soc: &Soc, address: u32, len: usize) -> Result<Vec<u8>, u32> {
    if address >= RAM_START {
        return soc.ram.get(address, len).map(<[u8]>::to_vec).ok_or(error::INVALID_ADDR);
    }
    let at = address as usize;
    soc.flash.get(at..at + len).filter(|_| at > 0).map(<[u8]>::to_vec).ok_or(error::INVALID_ADDR)
}

/// Reads a byte of the application's memory.
pub fn u8_at(soc: &Soc, address: u32) -> Result<u8, u32> {
    Ok(bytes(soc, address, 1)?[0])
}

/// Reads a half word of the application's memory.
pub fn u16_at(soc: &Soc, address: u32) -> Result<u16, u32> {
    let b = bytes(soc, address, 2)?;
    Ok(u16::from_le_bytes([b[0], b[1]]))
}

/// Reads a word of the application's memory.
pub fn u32_at(soc: &Soc, address: u32) -> Result<u32, u32> {
    let b = bytes(soc, address, 4)?;
    Ok(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

/// Writes into the application's RAM.
pub fn put(soc: &mut Soc, address: u32, data: &[u8]) -> Answer {
    if soc.ram.put(address, data) { Ok(()) } else { Err(error::INVALID_ADDR) }
}

/// An event (`ble_evt_t`) as bytes.
#[derive(Clone, Debug)]
pub struct SocEvent(Vec<u8>);

impl SocEvent {
    /// Creates a GAP event for a connection. Its parameters begin at a multiple of 4.
    pub fn gap(number: u16, connection: u16) -> Self {
        let mut event = Self::gatts(number, connection);
        event.0.extend([0, 0]);
        event
    }

    /// Creates an event of the GATT server for a connection.
    pub fn gatts(number: u16, connection: u16) -> Self {
        let mut event = Self(Vec::new());
        for half in [number, 0, connection] {
            event.0.extend(half.to_le_bytes());
        }
        event
    }

    /// Appends bytes.
    pub fn with(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    /// Appends half words.
    pub fn halves(mut self, halves: &[u16]) -> Self {
        halves.iter().for_each(|h| self.0.extend(h.to_le_bytes()));
        self
    }

    /// Completes the event with its length in the header.
    pub fn finish(mut self) -> Vec<u8> {
        let len = (self.0.len() as u16).to_le_bytes();
        self.0[2..4].copy_from_slice(&len);
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_have_the_offsets_of_the_headers() {
        // Offsets: ble_evt_t.evt 4, ble_gap_evt_t.params 4, ble_gatts_evt_t.params 2, ble_gatts_evt_write_t.data 12.
        let gap = SocEvent::gap(event::DISCONNECTED, 0).with(&[0x13]).finish();
        assert_eq!(gap, [17, 0, 9, 0, 0, 0, 0, 0, 0x13]);
        let write = SocEvent::gatts(event::WRITE, 0)
            .halves(&[19, 3])
            .with(&[2, 0, 1, 0])
            .halves(&[0, 2])
            .with(&[7, 8]);
        let write = write.finish();
        assert_eq!((write[6], write[18], write[19], write.len()), (19, 7, 8, 20));
    }
}
