//! Emulates Nordic's multiprotocol service layer (MPSL): clocks, interrupts and time slots.

use super::super::soc::Soc;
use super::super::time::us;
use super::slots::{Request, Slot};
use super::{CLOCK_POWER, Controller, EAGAIN, ENOMEM, EPERM, RADIO, RTC0, TIMER0, load, store};

impl Controller {
    pub(super) fn mpsl(&mut self, name: &str, args: [u32; 4], soc: &mut Soc) -> i32 {
        match name {
            "mpsl_init" => {
                let irq = args[1] as usize;
                self.low_priority = Some(irq);
                let irqs = [irq, CLOCK_POWER, RADIO, TIMER0, RTC0];
                soc.write(0xE000_E100, irqs.iter().fold(0, |bits, irq| bits | 1 << irq), 4);
                let [source] = load(soc, args[0]);
                soc.write(0x4000_0518, source.into(), 4);
                soc.write(0x4000_0008, 1, 4);
                0
            }
            "mpsl_uninit" | "MPSL_IRQ_RADIO_Handler" | "MPSL_IRQ_RTC0_Handler" => 0,
            "MPSL_IRQ_CLOCK_Handler" => {
                soc.write(0x4000_0100, 0, 4);
                soc.write(0x4000_0104, 0, 4);
                0
            }
            "mpsl_clock_hfclk_src_request" | "mpsl_clock_hfclk_request" => {
                let call_back = if name == "mpsl_clock_hfclk_request" { args[0] } else { args[1] };
                self.clock_wanted = Some(call_back);
                soc.write(0x4000_0000, 1, 4);
                0
            }
            "mpsl_clock_hfclk_src_release" | "mpsl_clock_hfclk_release" => {
                soc.write(0x4000_0004, 1, 4);
                0
            }
            "mpsl_clock_hfclk_src_is_running" | "mpsl_clock_hfclk_is_running" => {
                let place = if name == "mpsl_clock_hfclk_is_running" { args[0] } else { args[1] };
                let is_running = u32::from(soc.power.crystal);
                store(soc, place, &is_running.to_le_bytes());
                0
            }
            "mpsl_is_initialized" => i32::from(self.low_priority.is_some()),
            // The temperature is 25.00 °C, in units of a quarter of a degree.
            "mpsl_temperature_get" => 100,
            "mpsl_timeslot_session_count_set" => 0,
            "mpsl_timeslot_session_open" => {
                if self.session.is_some() {
                    return ENOMEM;
                }
                self.session = Some(args[0]);
                store(soc, args[1], &[0]);
                0
            }
            "mpsl_timeslot_session_close" => match self.session.take() {
                Some(call_back) => {
                    self.slot = Slot::None;
                    self.low.push_back((call_back, [0, 9]));
                    self.pend_low(&mut soc.nvic);
                    0
                }
                None => EAGAIN,
            },
            "mpsl_timeslot_request" => {
                self.plan(args[1], soc);
                0
            }
            _ => {
                self.broken.push(format!("`{name}` is not modelled"));
                EPERM
            }
        }
    }

    /// Plans the time slot that is requested at this address.
    fn plan(&mut self, at: u32, soc: &Soc) {
        let ([kind], [priority]) = (load(soc, at), load(soc, at + 5));
        if kind != 0 {
            self.broken.push(format!("time slots of kind {kind} are not modelled"));
        }
        let word = |at: u32| u64::from(u32::from_le_bytes(load(soc, at)));
        let request = Request { length: us(word(at + 8)), high: priority == 0, timeout: us(word(at + 12)) };
        self.slot = Slot::plan(request, self.link.as_ref(), soc.now);
    }

    /// The image's callback for a slot has returned, and requests the action at the address `wishes`.
    pub(super) fn slot_returned(&mut self, wishes: u32, soc: &mut Soc) {
        if let Slot::Running { until } = self.slot
            && soc.now > until
        {
            self.broken.push(format!("a time slot was overstayed by {} us", (soc.now - until) / us(1)));
        }
        self.slot = Slot::None;
        match load(soc, wishes) {
            [2] => {
                if let Some(call_back) = self.session {
                    self.low.push_back((call_back, [0, 7]));
                    self.pend_low(&mut soc.nvic);
                }
            }
            [3] => self.plan(u32::from_le_bytes(load(soc, wishes + 4)), soc),
            [action] => self.broken.push(format!("action {action} after a time slot is not modelled")),
        }
    }
}
