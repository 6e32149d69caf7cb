//! Answers HCI commands. The answer comes either from bumble's controller or from this module.

use super::super::soc::Soc;
use super::commands::{self, Command, Length, Who};
use super::link::{LONG, SHORT};
use super::{Controller, EVENT, LE_META, UNKNOWN_COMMAND, bytes, load, store};

impl Controller {
    pub(super) fn command(&mut self, name: &str, args: [u32; 4], soc: &mut Soc) -> u32 {
        let Some(command) = commands::find(name) else {
            self.broken.push(format!("`{name}` is not modelled"));
            return UNKNOWN_COMMAND.into();
        };
        let length = match command.arguments {
            Length::Fixed(length) => length,
            Length::Counted { fixed, count, each } => {
                let [counted] = load(soc, args[0] + count as u32);
                fixed + usize::from(counted) * each
            }
        };
        let arguments = bytes(soc, args[0], length);
        let out = if length == 0 { args[0] } else { args[1] };
        let (status, returned) = match command.who {
            Who::Here => self.answer_here(name, &arguments, soc),
            Who::Bumble => self.ask_bumble(name, command, &arguments, soc),
        };
        if command.returns > 0 {
            let mut returned = returned;
            returned.resize(command.returns, 0);
            store(soc, out, &returned);
        }
        status.into()
    }

    fn ask_bumble(&mut self, name: &str, command: Command, arguments: &[u8], soc: &mut Soc) -> (u8, Vec<u8>) {
        let mut packet = vec![1];
        packet.extend(command.opcode.to_le_bytes());
        packet.push(arguments.len() as u8);
        packet.extend(arguments);
        self.answer = None;
        self.send(&packet, soc);
        match self.answer.take() {
            Some(answer) if answer[0] != UNKNOWN_COMMAND => (answer[0], answer[1..].to_vec()),
            other => {
                self.broken.push(format!("bumble answers `{name}` with {other:?}"));
                (UNKNOWN_COMMAND, Vec::new())
            }
        }
    }

    fn answer_here(&mut self, name: &str, arguments: &[u8], soc: &mut Soc) -> (u8, Vec<u8>) {
        let handle = arguments.get(..2).unwrap_or(&[0; 2]).to_vec();
        match name.trim_start_matches("sdc_hci_cmd_") {
            "le_read_buffer_size" => {
                let ([size, _], [count, _]) = self.buffers;
                (0, [&size.to_le_bytes()[..], &[count]].concat())
            }
            "le_read_max_data_length" => {
                let [sent, received] = self.buffers.0.map(u16::to_le_bytes);
                let time = 2120u16.to_le_bytes();
                (0, [sent, time, received, time].concat())
            }
            "le_set_data_length" => {
                let asked = u16::from_le_bytes([arguments[2], arguments[3]]);
                if let Some(link) = &mut self.link {
                    link.octets = asked.clamp(SHORT, LONG).min(self.buffers.0[0]);
                    let (octets, time) = (link.octets.to_le_bytes(), 2120u16.to_le_bytes());
                    let mut event = vec![EVENT, LE_META, 11, 7];
                    event.extend(handle.iter().chain(&octets).chain(&time).chain(&octets).chain(&time));
                    link.down.push_back(event);
                }
                (0, handle)
            }
            "le_set_phy" => {
                let fast = arguments[3] & 2 != 0;
                if let Some(link) = &mut self.link {
                    link.fast = fast;
                    let phy = if fast { 2 } else { 1 };
                    link.down.push_back(vec![EVENT, LE_META, 6, 12, 0, handle[0], handle[1], phy, phy]);
                }
                (0, Vec::new())
            }
            "le_read_phy" => {
                let phy = if self.link.as_ref().is_some_and(|link| link.fast) { 2 } else { 1 };
                (0, [&handle[..], &[phy, phy]].concat())
            }
            "sp_read_rssi" => (0, [&handle[..], &[-60i8 as u8]].concat()),
            _ => {
                let _ = soc;
                (0, Vec::new())
            }
        }
    }
}
