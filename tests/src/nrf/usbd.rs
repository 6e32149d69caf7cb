//! USBD: the USB device controller, with a host on the other side of the cable.
//!
//! The test controls the host, which performs control transfers one after another and exchanges packets with bulk endpoints.
//! The controller answers SET_ADDRESS itself, like the real controller.

use std::collections::VecDeque;

use super::events::Events;
use super::memory::Ram;
use super::time::{ms, us};

const USBRESET: u32 = 0;
const ENDEPIN: u32 = 2;
const EP0DATADONE: u32 = 10;
const ENDEPOUT: u32 = 12;
const USBEVENT: u32 = 22;
const EP0SETUP: u32 = 23;
const EPDATA: u32 = 24;
const READY: u32 = 1 << 11;
const EP0DATADONE_EP0STATUS: u32 = 1 << 2;
/// Duration of a transaction on the bus, including the wait for its turn in the frame.
const TRANSACTION: u64 = us(125);

/// A control transfer requested by the host.
#[derive(Clone, Debug)]
struct Control {
    setup: [u8; 8],
    data: Vec<u8>,
    received: Vec<u8>,
}

/// The result of a control transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    /// Success, with the data of an IN transfer.
    Done(Vec<u8>),
    /// The device refused the request.
    Stalled,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Action {
    Reset,
    Setup,
    /// The device sends data, which the host reads in EP0.
    TakeControl,
    /// The host sends the data of an OUT transfer.
    GiveControl,
    TakeBulk(usize),
}

/// The controller and the simulated host.
#[derive(Clone, Debug, Default)]
pub struct Usbd {
    /// Events of this peripheral.
    pub events: Events,
    enabled: bool,
    pull_up: bool,
    event_cause: u32,
    data_status: u32,
    setup: [u8; 8],
    ep_in_enabled: u32,
    ep_out_enabled: u32,
    pointers: [[u32; 3]; 16],
    sizes: [u32; 8],
    armed: u32,
    in_flight: [Option<Vec<u8>>; 8],
    out_buffer: [Vec<u8>; 8],
    others: std::collections::HashMap<u32, u32>,
    actions: VecDeque<(u64, Action)>,
    controls: VecDeque<Control>,
    busy: bool,
    replies: Vec<Reply>,
    /// Packets that the host has not sent yet, by endpoint.
    to_send: [VecDeque<Vec<u8>>; 8],
    /// Data that the host has read, by endpoint.
    pub received: [Vec<u8>; 8],
    /// Whether the host polls the device's IN endpoints.
    pub host_reads: bool,
    /// Whether the cable is connected.
    pub plugged: bool,
    was_reset: bool,
}

impl Usbd {
    /// Resets the chip. The host then detects a disconnection.
    pub fn reset(&mut self) {
        *self = Self { plugged: self.plugged, host_reads: self.host_reads, ..Self::default() };
    }

    fn plan(&mut self, at: u64, action: Action) {
        self.actions.push_back((at, action));
    }

    /// Returns whether the device has attached and the host has reset the bus.
    pub fn is_attached(&self) -> bool {
        self.was_reset && self.pull_up && self.plugged
    }

    /// Disconnects the cable. The host then forgets the device.
    pub fn unplug(&mut self) {
        self.plugged = false;
        self.was_reset = false;
        self.busy = false;
        self.actions.clear();
        self.controls.clear();
        self.to_send = Default::default();
        self.in_flight = Default::default();
    }

    /// Starts a control transfer of the host, which sends `data` to the device.
    pub fn control(&mut self, setup: [u8; 8], data: &[u8], now: u64) {
        self.controls.push_back(Control { setup, data: data.to_vec(), received: Vec::new() });
        if !self.busy {
            self.busy = true;
            self.plan(now + TRANSACTION, Action::Setup);
        }
    }

    /// Returns the results of control transfers since the last call.
    pub fn take_replies(&mut self) -> Vec<Reply> {
        std::mem::take(&mut self.replies)
    }

    /// Sends bytes from the host to a bulk endpoint, in packets of at most 64.
    pub fn send(&mut self, endpoint: usize, bytes: &[u8]) {
        self.to_send[endpoint].extend(bytes.chunks(64).map(<[u8]>::to_vec));
        self.give(endpoint);
    }

    fn give(&mut self, endpoint: usize) {
        let bit = 1 << endpoint;
        if self.armed & self.ep_out_enabled & bit != 0
            && let Some(packet) = self.to_send[endpoint].pop_front()
        {
            self.armed &= !bit;
            self.sizes[endpoint] = packet.len() as u32;
            self.out_buffer[endpoint] = packet;
            self.data_status |= 1 << (16 + endpoint);
            self.events.fire(EPDATA);
        }
    }

    fn finish(&mut self, reply: Reply, now: u64) {
        self.controls.pop_front();
        self.replies.push(reply);
        self.busy = !self.controls.is_empty();
        if self.busy {
            self.plan(now + TRANSACTION, Action::Setup);
        }
    }

    fn status(&mut self, now: u64) {
        if let Some(control) = self.controls.front() {
            let data = control.received.clone();
            self.finish(Reply::Done(data), now);
        }
    }

    fn do_action(&mut self, action: Action, now: u64) {
        match action {
            Action::Reset => {
                self.was_reset = true;
                self.events.fire(USBRESET);
            }
            Action::Setup => {
                let Some(control) = self.controls.front() else { return };
                self.setup = control.setup;
                // SET_ADDRESS never reaches the firmware.
                if control.setup[..2] == [0x00, 0x05] {
                    self.finish(Reply::Done(Vec::new()), now);
                } else {
                    self.events.fire(EP0SETUP);
                }
            }
            Action::TakeControl => {
                let packet = self.in_flight[0].take().unwrap_or_default();
                if let Some(control) = self.controls.front_mut() {
                    control.received.extend(packet);
                }
                self.events.fire(EP0DATADONE);
                if self.events.shorts & EP0DATADONE_EP0STATUS != 0 {
                    self.status(now);
                }
            }
            Action::GiveControl => {
                if let Some(control) = self.controls.front_mut() {
                    let len = control.data.len().min(64);
                    self.out_buffer[0] = control.data.drain(..len).collect();
                    self.sizes[0] = len as u32;
                    self.events.fire(EP0DATADONE);
                }
            }
            Action::TakeBulk(endpoint) => {
                if !self.host_reads || !self.plugged {
                    self.plan(now + TRANSACTION, action);
                    return;
                }
                if let Some(packet) = self.in_flight[endpoint].take() {
                    self.received[endpoint].extend(packet);
                    self.data_status |= 1 << endpoint;
                    self.events.fire(EPDATA);
                }
            }
        }
    }

    /// Raises all events that are due.
    pub fn advance(&mut self, now: u64, _ram: &mut Ram) {
        while let Some(place) = self.actions.iter().position(|a| a.0 <= now) {
            let (at, action) = self.actions.remove(place).expect("found");
            self.do_action(action, at);
        }
    }

    /// Returns the cycle of the next event.
    pub fn due(&self) -> Option<u64> {
        self.actions.iter().map(|a| a.0).min()
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x400 => self.event_cause,
            0x46C => self.data_status,
            0x480..=0x49C => self.setup[(offset as usize - 0x480) / 4].into(),
            0x4A0..=0x4BC => self.sizes[(offset as usize - 0x4A0) / 4],
            0x500 => self.enabled.into(),
            0x504 => self.pull_up.into(),
            0x510 => self.ep_in_enabled,
            0x514 => self.ep_out_enabled,
            _ => self.events.read(offset).unwrap_or_else(|| self.others.get(&offset).copied().unwrap_or(0)),
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64, ram: &mut Ram) {
        let task = value & 1 != 0;
        match offset {
            0x004..=0x020 if task => {
                let endpoint = (offset as usize - 4) / 4;
                let [pointer, len, _] = self.pointers[endpoint];
                let packet = ram.get(pointer, len as usize).map(<[u8]>::to_vec).unwrap_or_default();
                self.in_flight[endpoint] = Some(packet);
                self.events.fire(ENDEPIN + endpoint as u32);
                let action = if endpoint == 0 { Action::TakeControl } else { Action::TakeBulk(endpoint) };
                self.plan(now + TRANSACTION, action);
            }
            0x028..=0x044 if task => {
                let endpoint = (offset as usize - 0x28) / 4;
                let [pointer, len, _] = self.pointers[8 + endpoint];
                let packet = std::mem::take(&mut self.out_buffer[endpoint]);
                ram.put(pointer, &packet[..packet.len().min(len as usize)]);
                self.events.fire(ENDEPOUT + endpoint as u32);
            }
            0x04C if task => self.plan(now + TRANSACTION, Action::GiveControl),
            0x050 if task => self.status(now),
            0x054 if task => {
                if !self.controls.is_empty() {
                    self.finish(Reply::Stalled, now);
                }
            }
            0x400 => self.event_cause &= !value,
            0x46C => self.data_status &= !value,
            0x4A0..=0x4BC => {
                let endpoint = (offset as usize - 0x4A0) / 4;
                self.sizes[endpoint] = 0;
                if endpoint > 0 {
                    self.armed |= 1 << endpoint;
                    self.give(endpoint);
                }
            }
            0x500 => {
                if task && !self.enabled {
                    self.event_cause |= READY;
                    self.events.fire(USBEVENT);
                }
                self.enabled = task;
                if !task {
                    self.pull_up = false;
                    self.was_reset = false;
                }
            }
            0x504 => {
                if task && !self.pull_up && self.plugged {
                    self.plan(now + ms(20), Action::Reset);
                }
                self.pull_up = task;
            }
            0x510 => self.ep_in_enabled = value,
            0x514 => self.ep_out_enabled = value,
            0x600..=0x69C if (offset - 0x600) % 0x14 < 12 => {
                self.pointers[(offset as usize - 0x600) / 0x14][(offset as usize - 0x600) % 0x14 / 4] = value;
            }
            0x700..=0x79C if (offset - 0x700) % 0x14 < 12 => {
                self.pointers[8 + (offset as usize - 0x700) / 0x14][(offset as usize - 0x700) % 0x14 / 4] =
                    value;
            }
            _ => {
                if !self.events.write(offset, value) {
                    self.others.insert(offset, value);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nrf::memory::RAM_START;

    fn attached() -> (Usbd, Ram) {
        let mut usb = Usbd { plugged: true, host_reads: true, ..Usbd::default() };
        let mut ram = Ram::default();
        usb.write(0x500, 1, 0, &mut ram);
        assert_eq!(usb.read(0x400), READY);
        usb.write(0x504, 1, 0, &mut ram);
        usb.advance(ms(20), &mut ram);
        assert!(usb.is_attached() && usb.events.stands(USBRESET));
        (usb, ram)
    }

    #[test]
    fn a_control_read_takes_packets_until_the_status_stage() {
        let (mut usb, mut ram) = attached();
        usb.control([0x80, 6, 0, 1, 0, 0, 18, 0], &[], ms(30));
        usb.advance(ms(31), &mut ram);
        assert!(usb.events.stands(EP0SETUP));
        assert_eq!((usb.read(0x480), usb.read(0x484), usb.read(0x498)), (0x80, 6, 18));
        ram.put(RAM_START, b"descriptor");
        usb.write(0x600, RAM_START, 0, &mut ram);
        usb.write(0x604, 10, 0, &mut ram);
        usb.write(0x200, EP0DATADONE_EP0STATUS, 0, &mut ram);
        usb.write(0x004, 1, ms(31), &mut ram);
        usb.advance(ms(32), &mut ram);
        assert_eq!(usb.take_replies(), [Reply::Done(b"descriptor".to_vec())]);
    }

    #[test]
    fn a_bulk_out_packet_waits_until_the_endpoint_is_armed() {
        let (mut usb, mut ram) = attached();
        usb.write(0x514, 0b11, 0, &mut ram);
        usb.send(1, b"hello");
        assert_eq!(usb.read(0x46C), 0);
        usb.write(0x4A4, 0, 0, &mut ram);
        assert_eq!((usb.read(0x46C), usb.read(0x4A4)), (1 << 17, 5));
        usb.write(0x714, RAM_START, 0, &mut ram);
        usb.write(0x718, 5, 0, &mut ram);
        usb.write(0x02C, 1, 0, &mut ram);
        assert!(usb.events.stands(ENDEPOUT + 1));
        assert_eq!(ram.get(RAM_START, 5), Some(&b"hello"[..]));
    }

    #[test]
    fn a_bulk_in_packet_waits_until_the_host_reads() {
        let (mut usb, mut ram) = attached();
        usb.host_reads = false;
        ram.put(RAM_START, b"state");
        usb.write(0x628, RAM_START, 0, &mut ram);
        usb.write(0x62C, 5, 0, &mut ram);
        usb.write(0x00C, 1, 0, &mut ram);
        assert!(usb.events.stands(ENDEPIN + 2));
        usb.advance(ms(1), &mut ram);
        assert!(usb.received[2].is_empty());
        usb.host_reads = true;
        usb.advance(ms(2), &mut ram);
        assert_eq!(usb.received[2], b"state");
        assert_eq!(usb.read(0x46C), 1 << 2);
    }
}
