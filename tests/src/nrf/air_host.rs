//! A laptop whose Bluetooth stack is bumble. A test controls its actions and reads what it received.

use serde_json::{Value, json};

use super::board::Board;
use super::session::RightRig;
use super::time::ms;

/// The characteristic with the board's notifications.
pub const OUT: &str = "b1a40002-6d61-4e75-a1b2-5c3d9e7f0a33";
/// The characteristic for writes to the board.
pub const IN: &str = "b1a40003-6d61-4e75-a1b2-5c3d9e7f0a33";
/// The MTU that a laptop requests.
pub const MTU: u16 = 517;
/// Maximum duration of any action that a test requests, in ms of virtual time.
const PATIENCE_MS: u64 = 40_000;

/// Bumble's laptop, linked to an emulated board. Frames are the same bytes as on a UART, split according to the MTU.
#[derive(Clone, Debug)]
pub struct AirHost {
    taken: usize,
    room: usize,
}

impl Default for AirHost {
    fn default() -> Self {
        Self { taken: 0, room: 20 }
    }
}

impl AirHost {
    /// Returns the bytes notified since the last call, each with the cycle of its arrival.
    pub fn read(&mut self, board: &mut Board) -> Vec<(u64, u8)> {
        let number = board.controller().number();
        let air = board.controller().air();
        let new = &air.log[self.taken..];
        let ours = new.iter().filter(|(_, said)| said["board"] == number);
        let bytes = ours.filter_map(|(at, said)| Some((*at, said["notified"].as_str()?)));
        let read = bytes.flat_map(|(at, hex)| decode(hex).into_iter().map(move |byte| (at, byte))).collect();
        self.taken = air.log.len();
        read
    }

    /// Lets the laptop perform an action, and runs until it is done. Returns the result, or bumble's error.
    ///
    /// # Panics
    /// Panics if the action takes longer than 40 s.
    pub fn want(board: &mut Board, order: Value) -> Result<Value, Value> {
        let number = board.order(order.clone());
        for _ in 0..PATIENCE_MS {
            let outcome = board.controller().air().outcome(number).cloned();
            match outcome {
                Some(failed) if failed.get("failed").is_some() => return Err(failed),
                Some(mut done) => return Ok(done["done"].take()),
                None => board.run_ms(1),
            }
        }
        panic!("{order} takes too long")
    }

    /// Lets the laptop perform an action that must succeed, and returns the result.
    ///
    /// # Panics
    /// Panics if the action fails.
    pub fn get(board: &mut Board, order: Value) -> Value {
        Self::want(board, order.clone()).unwrap_or_else(|failed| panic!("{order}: {failed}"))
    }

    /// Connects at this interval (in ms), and then pairs. If the laptop has keys, it encrypts instead.
    /// Finally, requests the largest MTU and subscribes.
    ///
    /// # Panics
    /// Panics if a step fails.
    pub fn join(&mut self, board: &mut Board, interval: f64) {
        Self::get(board, json!({"do": "connect", "interval": interval}));
        let has_keys =
            Self::get(board, json!({"do": "bonds"})).as_array().is_some_and(|bonds| !bonds.is_empty());
        Self::get(board, json!({"do": if has_keys { "encrypt" } else { "pair" }}));
        self.settle_in(board);
    }

    /// Performs the steps after encryption: MTU, discovery, subscription.
    ///
    /// # Panics
    /// Panics if a step fails.
    pub fn settle_in(&mut self, board: &mut Board) {
        let mtu = Self::get(board, json!({"do": "mtu", "mtu": MTU}));
        Self::get(board, json!({"do": "discover"}));
        Self::get(board, json!({"do": "subscribe", "uuid": OUT}));
        self.room = mtu.as_u64().expect("a number") as usize - 3;
    }

    /// Writes bytes without responses, in pieces that fit the MTU.
    pub fn send(&mut self, board: &mut Board, bytes: &[u8]) {
        let pieces: Vec<String> = bytes.chunks(self.room).map(encode).collect();
        board.order(json!({"do": "write", "uuid": IN, "bytes": pieces}));
    }
}

/// Returns bytes in the format of bumble's process.
pub fn encode(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn decode(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|i| u8::from_str_radix(&hex[i..i + 2], 16).expect("hex digits")).collect()
}

impl RightRig {
    /// Calls [`AirHost::want`].
    ///
    /// # Panics
    /// Panics for the same reasons as [`AirHost::want`].
    pub fn want(&mut self, order: Value) -> Result<Value, Value> {
        AirHost::want(&mut self.board, order)
    }

    /// Calls [`AirHost::get`].
    ///
    /// # Panics
    /// Panics for the same reasons as [`AirHost::get`].
    pub fn get(&mut self, order: Value) -> Value {
        AirHost::get(&mut self.board, order)
    }

    /// Calls [`AirHost::join`].
    ///
    /// # Panics
    /// Panics if [`AirHost::join`] does, or if the laptop does not use bumble.
    pub fn join(&mut self, interval: f64) {
        self.air.as_mut().expect("bumble's laptop").join(&mut self.board, interval);
    }

    /// Calls [`AirHost::settle_in`].
    ///
    /// # Panics
    /// Panics if [`AirHost::settle_in`] does, or if the laptop does not use bumble.
    pub fn settle_in(&mut self) {
        self.air.as_mut().expect("bumble's laptop").settle_in(&mut self.board);
    }

    /// Waits until the laptop has granted the supervision timeout that the board requests.
    ///
    /// # Panics
    /// Panics if this takes longer than 30 s.
    pub fn wait_for_parameters(&mut self) {
        let granted = |rig: &mut Self| rig.board.controller().supervision() == Some(ms(1000));
        assert!(self.run_until_that(30_000, granted), "the parameters are not granted");
    }

    /// Connects a bonded laptop again, and waits for the next state of the hand.
    /// Returns the ms since `from`, which is a cycle of the board.
    ///
    /// # Panics
    /// Panics if [`Self::join`] does, or if no state arrives.
    pub fn return_ms(&mut self, from: u64) -> u64 {
        self.join(15.0);
        let states = |rig: &Self| rig.heard.states.len() + rig.heard.lefts.len();
        let before = states(self);
        assert!(self.run_until_that(5000, |rig| states(rig) > before), "no state");
        (self.board.now() - from) / ms(1)
    }

    /// Returns the laptop's unsolicited reports with this key.
    pub fn noticed(&mut self, key: &str) -> Vec<(u64, Value)> {
        let air = self.board.controller().air();
        let noticed = air.log.iter().filter(|(_, said)| said.get(key).is_some() && said.get("id").is_none());
        noticed.map(|(at, said)| (*at, said[key].clone())).collect()
    }
}
