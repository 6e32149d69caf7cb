//! Lists serial ports with the probable device on each, and advice if there are none.

use serialport::SerialPortType;

/// A port with information from its USB numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortAbout {
    /// The argument for `--left` or `--right`.
    pub name: String,
    /// The device that is probably on this port.
    pub about: String,
    /// Whether a board could be on this port.
    pub is_usb: bool,
}

/// Returns the machine's serial ports sorted by name, or an empty list if the system refuses.
pub fn ports() -> Vec<PortAbout> {
    let mut ports: Vec<_> = serialport::available_ports()
        .unwrap_or_default()
        .into_iter()
        .map(|port| {
            let (about, is_usb) = match &port.port_type {
                SerialPortType::UsbPort(usb) => (about_usb(usb.vid, usb.pid), true),
                SerialPortType::BluetoothPort => ("Bluetooth serial port".to_owned(), false),
                SerialPortType::PciPort => ("built-in serial port".to_owned(), false),
                SerialPortType::Unknown => {
                    // Without udev, only the name identifies a USB port.
                    let usb = port.port_name.contains("ttyUSB") || port.port_name.contains("ttyACM");
                    ((if usb { "USB serial port" } else { "serial port" }).to_owned(), usb)
                }
            };
            PortAbout { name: port.port_name, about, is_usb }
        })
        .collect();
    ports.sort_by(|a, b| a.name.cmp(&b.name));
    ports
}

/// Interprets USB vendor and product numbers.
fn about_usb(vendor: u16, product: u16) -> String {
    let known = match (vendor, product) {
        (0x2341, 0x805a) => "Nano 33 BLE (right hand)",
        (0x2341, 0x005a) => "Nano 33 BLE (right hand) in its bootloader: press reset once, or flash it",
        (0x2341, _) => "Arduino",
        (0x0403, 0x6001) => "FT232: a Nano (left hand), probably",
        (0x1a86, 0x7523) => "CH340: a Nano clone (left hand), probably",
        (0x10c4, 0xea60) => "CP210x: a Nano clone (left hand), probably",
        _ => return format!("USB serial port {vendor:04x}:{product:04x}"),
    };
    known.to_owned()
}

/// Returns advice for a user whose hands were not found.
pub fn hints() -> [&'static str; 4] {
    [
        "cable: many USB cables carry power only; try another one, without a hub",
        "driver: Nano clones need the ch341 driver (Linux has it; macOS and Windows: CH340 driver); \
         `dmesg | tail` shows whether the system saw the board",
        "permissions: `sudo usermod -aG dialout $USER` (Arch: group uucp), then log in again",
        "firmware: a board that never answers has not been flashed: firmware-nano-avr/ (left), \
         firmware-nano33/ (right)",
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_boards_of_this_project_are_known_by_their_numbers() {
        assert!(about_usb(0x2341, 0x005a).contains("bootloader"));
        assert!(about_usb(0x1a86, 0x7523).contains("left hand"));
        assert_eq!(about_usb(0x1234, 0x00ff), "USB serial port 1234:00ff");
    }
}
