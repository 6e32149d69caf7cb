//! Simulates a laptop at the USB cable.
//! The laptop enumerates the serial port request by request, sets its line parameters, and reads and writes bytes.

use std::collections::VecDeque;

use super::board::Board;
use super::time::ms;
use super::usbd::Reply;

/// Vendor and product ids of a sketch on an Arduino Nano 33 BLE, and of a program on a XIAO nRF52840 Sense.
const IDS: [&[u8]; 2] = [&[0x41, 0x23, 0x5A, 0x80], &[0x86, 0x28, 0x45, 0x80]];

/// Requests that the host sends to endpoint 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Request {
    DeviceDescriptor,
    /// The string with this number.
    Text(u8),
    SetAddress,
    /// The first 9 bytes of the configuration, which contain its length.
    ConfigurationHead,
    Configuration(u8),
    Configure,
    /// Bit rate of the line, in bits per second.
    Baud(u32),
    /// Whether a program has opened the port.
    Open(bool),
}

impl Request {
    fn packets(self) -> ([u8; 8], Vec<u8>) {
        match self {
            Request::DeviceDescriptor => ([0x80, 6, 0, 1, 0, 0, 18, 0], vec![]),
            Request::Text(number) => ([0x80, 6, number, 3, 9, 4, 255, 0], vec![]),
            Request::SetAddress => ([0x00, 5, 7, 0, 0, 0, 0, 0], vec![]),
            Request::ConfigurationHead => ([0x80, 6, 0, 2, 0, 0, 9, 0], vec![]),
            Request::Configuration(total) => ([0x80, 6, 0, 2, 0, 0, total, 0], vec![]),
            Request::Configure => ([0x00, 9, 1, 0, 0, 0, 0, 0], vec![]),
            Request::Baud(baud) => {
                let mut coding = baud.to_le_bytes().to_vec();
                coding.extend([0, 0, 8]);
                ([0x21, 0x20, 0, 0, 0, 0, 7, 0], coding)
            }
            Request::Open(dtr) => ([0x21, 0x22, u8::from(dtr), 0, 0, 0, 0, 0], vec![]),
        }
    }
}

/// The laptop's side of the cable. Call [`UsbHost::step`] every millisecond.
#[derive(Debug, Default)]
pub struct UsbHost {
    plugged: bool,
    /// The cycle at which the first request is due, after the device has attached.
    begins: Option<u64>,
    to_ask: VecDeque<Request>,
    asked: Option<Request>,
    /// The device's serial number, if it has a serial number.
    pub serial_number: Option<String>,
    /// Bulk endpoints of the serial port, in and out.
    bulk: Option<(usize, usize)>,
}

impl UsbHost {
    /// Connects the cable. The port is [ready](Self::is_ready) after some steps.
    pub fn plug_in(&mut self, board: &mut Board) {
        let soc = board.soc();
        soc.usb.plugged = true;
        soc.usb.host_reads = true;
        soc.usb.received = Default::default();
        soc.power.set_vbus(true, soc.now);
        soc.settle();
        let first = [
            Request::DeviceDescriptor,
            Request::SetAddress,
            Request::ConfigurationHead,
            Request::Configure,
            Request::Baud(115_200),
            Request::Open(true),
        ];
        *self = Self { plugged: true, to_ask: first.into(), ..Self::default() };
    }

    /// Disconnects the cable.
    pub fn unplug(&mut self, board: &mut Board) {
        let soc = board.soc();
        soc.usb.unplug();
        soc.power.set_vbus(false, soc.now);
        soc.settle();
        *self = Self::default();
    }

    /// Opens or closes the port, as a program does.
    pub fn open(&mut self, open: bool) {
        self.to_ask.extend([Request::Baud(115_200), Request::Open(open)]);
    }

    /// Opens the port at 1200 baud and closes it, which is Arduino's method of starting the bootloader.
    pub fn touch(&mut self) {
        self.to_ask.extend([Request::Baud(1200), Request::Open(false)]);
    }

    /// Returns whether the port is open and all requests are complete.
    pub fn is_ready(&self) -> bool {
        self.bulk.is_some() && self.to_ask.is_empty() && self.asked.is_none()
    }

    /// Sends the next request of the enumeration.
    ///
    /// # Panics
    /// Panics if the device does not answer like a serial port with Arduino's ids.
    pub fn step(&mut self, board: &mut Board) {
        if !self.plugged || board.in_bootloader {
            return;
        }
        let soc = board.soc();
        let Some(begins) = self.begins else {
            self.begins = soc.usb.is_attached().then(|| soc.now + ms(10));
            return;
        };
        if let Some(request) = self.asked {
            match soc.usb.take_replies().as_slice() {
                [] => return,
                [Reply::Done(data)] => self.answered(request, data),
                other => panic!("{request:?}: {other:?}"),
            }
        }
        self.asked = if soc.now < begins { None } else { self.to_ask.pop_front() };
        if let Some(request) = self.asked {
            let (setup, data) = request.packets();
            soc.usb.control(setup, &data, soc.now);
            soc.settle();
        }
    }

    fn answered(&mut self, request: Request, data: &[u8]) {
        match request {
            Request::DeviceDescriptor => {
                assert_eq!(data.len(), 18);
                assert!(IDS.contains(&&data[8..12]), "ids: {:x?}", &data[8..12]);
                if data[16] != 0 {
                    self.to_ask.push_front(Request::Text(data[16]));
                }
            }
            Request::Text(_) => {
                let units: Vec<u16> =
                    data[2..].chunks_exact(2).map(|c| u16::from_le_bytes([c[0], c[1]])).collect();
                self.serial_number = Some(String::from_utf16_lossy(&units));
            }
            Request::ConfigurationHead => self.to_ask.push_front(Request::Configuration(data[2])),
            Request::Configuration(total) => {
                assert_eq!(data.len(), usize::from(total));
                self.bulk = Some(bulk_endpoints(data));
            }
            _ => {}
        }
    }

    /// Returns the bytes from the board since the last call.
    pub fn read(&mut self, board: &mut Board) -> Vec<u8> {
        self.bulk.map_or_else(Vec::new, |(input, _)| std::mem::take(&mut board.soc().usb.received[input]))
    }

    /// Sends bytes to the board; they are lost if the port is not ready.
    pub fn write(&mut self, board: &mut Board, bytes: &[u8]) {
        if let Some((_, output)) = self.bulk {
            let soc = board.soc();
            soc.usb.send(output, bytes);
            soc.settle();
        }
    }
}

/// Returns the two bulk endpoints of a configuration descriptor, in and out.
fn bulk_endpoints(descriptor: &[u8]) -> (usize, usize) {
    let (mut input, mut output) = (0, 0);
    let mut at = 0;
    while at < descriptor.len() {
        if descriptor[at + 1] == 5 && descriptor[at + 3] == 2 {
            let number = usize::from(descriptor[at + 2] & 0xF);
            if descriptor[at + 2] & 0x80 != 0 { input = number } else { output = number }
        }
        at += usize::from(descriptor[at]);
    }
    assert!(input != 0 && output != 0, "a serial port has two bulk endpoints");
    (input, output)
}
