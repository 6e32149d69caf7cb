//! Both emulated boards with one bridge and one simulated robot, in virtual time.
//!
//! ```text
//! voltages -> ATmega328P (simavr) -> serial bytes -------\
//!             or nRF52840 (unicorn)  -> BLE
//!                                                          bridge -> robot, 1 ms per step
//! motion   -> nRF52840 (unicorn)  -> UART, USB, BLE -----/
//! ```
//!
//! Each board has its own clock. In a step, both boards run up to the same moment of the desk's time.

use host_bridge::arm::Director;
use host_bridge::bridge::{Bridge, BridgeEvent};
use host_bridge::config::Config;
use host_bridge::intent::MotionMap;
use host_bridge::robot::Door as _;
use host_bridge::robots::Stage;
use host_bridge::safety::{Hand, State};
use host_bridge::sim::Simulator;
use shared_dsp::left::calibration::Calibration;
use shared_proto::frame::{DELIMITER, HOST_FRAME_MAX, encode_host};

use crate::avr::image::path as left_image;
use crate::avr::nano::{self, Nano, Voltages};
use crate::nrf::air_host::AirHost;
use crate::nrf::ble_host::BleHost;
use crate::nrf::board::{Board, Boot, Kind};
use crate::nrf::build::{Variant, image};
use crate::nrf::controller::{Air, Controller};
use crate::nrf::left_hand;
use crate::nrf::lsm9ds1::Motion;
use crate::nrf::time;
use crate::nrf::usb_host::UsbHost;

/// The left board with its cable.
pub struct Left {
    /// The emulated board.
    pub nano: Nano,
    /// Whether the cable's data lines are connected.
    pub cable: bool,
    /// The board's clock at the moment when the desk's clock was 0; negative for a board that was powered later.
    zero_cycle: i64,
}

impl Left {
    /// Takes over a running board, whose earlier messages are lost.
    pub fn new(mut nano: Nano) -> Self {
        while nano.sent().is_some() {}
        Self { cable: true, zero_cycle: nano.cycle() as i64, nano }
    }

    /// Returns the board's clock in seconds at a moment of the desk's time, for timing a wearer's movements.
    pub fn seconds_at(&self, desk_ms: u64) -> f64 {
        self.cycle_at(desk_ms) as f64 / (1000 * nano::CYCLES_PER_MS) as f64
    }

    fn cycle_at(&self, desk_ms: u64) -> u64 {
        (self.zero_cycle + (desk_ms * nano::CYCLES_PER_MS) as i64) as u64
    }

    fn run_to(&mut self, desk_ms: u64) -> Vec<u8> {
        let end = self.cycle_at(desk_ms);
        self.nano.run_until(end);
        let bytes = self.nano.sent_until(end);
        if self.cable { bytes } else { Vec::new() }
    }

    /// Disconnects and reconnects the cable, which is also the power supply. The board restarts with its EEPROM.
    pub fn power_again(&mut self, desk_ms: u64, voltages: Box<dyn Voltages>) {
        let eeprom = self.nano.eeprom();
        self.nano = Nano::new(&left_image(), &eeprom, voltages);
        self.zero_cycle = -((desk_ms * nano::CYCLES_PER_MS) as i64);
        self.cable = true;
    }
}

/// The connection of the right board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cable {
    /// The UART at D0 and D1.
    Uart,
    /// The USB cable.
    Usb,
    /// Bluetooth with the image for S140, on the model of S140.
    Ble,
    /// Bluetooth linked into the image. Bumble simulates the radio and the laptop, with an interval of 15 ms.
    Air,
}

/// The current state of the right board's connection.
#[derive(Debug)]
pub enum Wire {
    /// The UART at D0 and D1, and whether its cable is connected.
    Uart(bool),
    /// The USB cable.
    Usb(UsbHost),
    /// Bluetooth.
    Ble(BleHost),
    /// Bluetooth, simulated by bumble.
    Air(AirHost),
}

/// The right board with its cable.
pub struct Right {
    /// The emulated board.
    pub board: Board,
    /// The connection to the laptop.
    pub wire: Wire,
    zero_cycle: u64,
}

impl Right {
    /// Starts and connects a board (for UART and USB with the simulated stock bootloader).
    /// `wear` receives the board's clock in seconds at the desk's time 0, which is some seconds after power-up.
    ///
    /// # Panics
    /// Panics if the laptop is not connected by then.
    pub fn start<M: Motion + 'static>(link: Cable, wear: impl FnOnce(f64) -> M) -> Self {
        // A laptop pairs before it subscribes.
        let start_ms = match link {
            Cable::Uart | Cable::Usb => 1000,
            Cable::Ble => 4000,
            Cable::Air => 8000,
        };
        let motion = Box::new(wear(start_ms as f64 / 1000.0));
        let (variant, boot) = match link {
            Cable::Uart | Cable::Usb => (Variant::Bootloader, Boot::StockBootloader),
            Cable::Ble => (Variant::Ble, Boot::SoftDevice),
            Cable::Air => (Variant::Trouble, Boot::StockBootloader),
        };
        let image = image(variant);
        let controller = (link == Cable::Air).then(|| Controller::new(&image.symbols, Air::start(), 0));
        let mut board = Board::new(image, boot, motion);
        let mut wire = match link {
            Cable::Uart => Wire::Uart(true),
            Cable::Usb => {
                board.run_ms(50);
                let mut host = UsbHost::default();
                host.plug_in(&mut board);
                Wire::Usb(host)
            }
            Cable::Ble => {
                let mut host = BleHost::default();
                host.connect(&mut board);
                Wire::Ble(host)
            }
            Cable::Air => {
                board.answer_controller(controller.expect("made above"));
                board.run_ms(700);
                let mut host = AirHost::default();
                host.join(&mut board, 15.0);
                Wire::Air(host)
            }
        };
        while board.now() < time::ms(start_ms) {
            board.run_ms(1);
            match &mut wire {
                Wire::Uart(_) | Wire::Air(_) => {}
                Wire::Usb(host) => host.step(&mut board),
                Wire::Ble(host) => host.step(&mut board),
            }
        }
        let zero_cycle = board.now();
        let mut right = Self { board, wire, zero_cycle };
        assert!(right.is_connected(), "not connected after {start_ms} ms: {:?}", right.wire);
        right.run_to(0);
        right
    }

    /// Returns the board's emulated clock (cycles since power-up) at a moment of the desk's time.
    pub fn cycle_at(&self, desk_ms: u64) -> u64 {
        self.zero_cycle + time::ms(desk_ms)
    }

    fn is_connected(&self) -> bool {
        match &self.wire {
            Wire::Uart(cable) => *cable,
            Wire::Usb(host) => host.is_ready(),
            Wire::Ble(host) => host.is_ready(),
            Wire::Air(_) => self.board.is_connected(),
        }
    }

    fn run_to(&mut self, desk_ms: u64) -> Vec<u8> {
        let end = self.cycle_at(desk_ms);
        self.board.run_until(end);
        let uart = self.board.uart_out();
        match &mut self.wire {
            Wire::Uart(true) => uart,
            Wire::Uart(false) => Vec::new(),
            Wire::Usb(host) => {
                host.step(&mut self.board);
                host.read(&mut self.board)
            }
            Wire::Ble(host) => {
                host.step(&mut self.board);
                host.read(&mut self.board).into_iter().map(|(_, byte)| byte).collect()
            }
            Wire::Air(host) => host.read(&mut self.board).into_iter().map(|(_, byte)| byte).collect(),
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        match &mut self.wire {
            Wire::Uart(true) => self.board.uart_in(bytes),
            Wire::Uart(false) => {}
            Wire::Usb(host) => host.write(&mut self.board, bytes),
            Wire::Ble(host) => host.send(&mut self.board, bytes),
            Wire::Air(host) => host.send(&mut self.board, bytes),
        }
    }
}

/// The readings of both flex sensors at a moment of the board's clock in seconds.
pub type Flex = Box<dyn FnMut(f64) -> [f64; 2]>;

/// A left hand on a XIAO without a cable.
pub struct LeftAir {
    /// The emulated board.
    pub board: Board,
    host: AirHost,
    flex: Flex,
}

/// The time at which two boards without a cable are connected, in ms since both were powered.
pub const BOTH_CONNECTED_MS: u64 = 10_000;

/// Starts both hands without cables and connects them to one laptop at 15 ms, on the same air.
/// Both functions receive the boards' clock in seconds at the desk's time 0.
///
/// # Panics
/// Panics if the laptop is not connected to both by then.
pub fn start_both_on_air<L: Motion + 'static, R: Motion + 'static>(
    calibration: &Calibration,
    left: impl FnOnce(f64) -> (L, Flex),
    right: impl FnOnce(f64) -> R,
) -> (LeftAir, Right) {
    let start_s = BOTH_CONNECTED_MS as f64 / 1000.0;
    let air = Air::start();
    let start = |variant, kind, motion: Box<dyn Motion>, number| {
        let image = image(variant);
        let controller = Controller::new(&image.symbols, air.clone(), number);
        let mut board = Board::of_kind(kind, image, Boot::StockBootloader, motion);
        board.answer_controller(controller);
        board
    };
    let (motion, flex) = left(start_s);
    let mut left = LeftAir {
        board: start(Variant::XiaoLeft, Kind::Xiao, Box::new(motion), 1),
        host: AirHost::default(),
        flex,
    };
    left_hand::store(&mut left.board, calibration);
    let mut board = start(Variant::Trouble, Kind::Nano33, Box::new(right(start_s)), 0);
    left.run_until(time::ms(700));
    board.run_ms(700);
    // While one board is joined, the other one waits, and then catches up.
    let mut host = AirHost::default();
    host.join(&mut board, 15.0);
    left.run_until(board.now());
    left.host.join(&mut left.board, 15.0);
    for ms in 1..=BOTH_CONNECTED_MS {
        if board.now() < time::ms(ms) {
            board.run_until(time::ms(ms));
        }
        left.run_until(time::ms(ms));
    }
    let mut right = Right { board, wire: Wire::Air(host), zero_cycle: time::ms(BOTH_CONNECTED_MS) };
    assert!(right.is_connected() && left.board.is_connected(), "both are connected");
    right.run_to(0);
    left.run_to(0);
    (left, right)
}

impl LeftAir {
    /// Returns the board's clock in seconds at a moment of the desk's time.
    pub fn seconds_at(&self, desk_ms: u64) -> f64 {
        (BOTH_CONNECTED_MS + desk_ms) as f64 / 1000.0
    }

    fn run_until(&mut self, cycle: u64) {
        while self.board.now() < cycle {
            let seconds = self.board.seconds();
            left_hand::set_flex(&mut self.board, (self.flex)(seconds));
            let next = (self.board.now() + time::ms(1)).min(cycle);
            self.board.run_until(next);
        }
    }

    fn run_to(&mut self, desk_ms: u64) -> Vec<u8> {
        self.run_until(time::ms(BOTH_CONNECTED_MS + desk_ms));
        self.host.read(&mut self.board).into_iter().map(|(_, byte)| byte).collect()
    }
}

/// Simulates a bad cable, which changes the bytes from a board and adds bytes on their way to the board.
pub type Disturbance = Box<dyn FnMut(Hand, &mut Vec<u8>) -> Vec<u8>>;

/// The desk with boards, laptop and robot.
pub struct TwoHands {
    /// The left board with a cable, if it takes part.
    pub left: Option<Left>,
    /// The left board without a cable, if it takes part.
    pub left_air: Option<LeftAir>,
    /// The right board, if it takes part.
    pub right: Option<Right>,
    /// The laptop's bridge.
    pub bridge: Bridge,
    /// The simulated robot.
    pub robot: Director<Simulator>,
    /// All events on the bridge, each with the desk's time.
    pub log: Vec<BridgeEvent>,
    /// The function that disturbs the cables.
    pub disturbance: Option<Disturbance>,
    now_ms: u64,
}

impl TwoHands {
    /// Creates a desk with running boards, and a bridge that has not received anything yet.
    pub fn new(left: Option<Left>, right: Option<Right>) -> Self {
        Self {
            left,
            left_air: None,
            right,
            bridge: Bridge::new(MotionMap::default()),
            robot: Stage::bare().simulated(&Config::default()),
            log: Vec::new(),
            disturbance: None,
            now_ms: 0,
        }
    }

    /// Creates a desk with both hands over Bluetooth.
    pub fn on_air((left, right): (LeftAir, Right)) -> Self {
        Self { left_air: Some(left), ..Self::new(None, Some(right)) }
    }

    /// Returns the desk's time.
    pub fn now_ms(&self) -> u64 {
        self.now_ms
    }

    /// Returns the left board's clock in seconds.
    ///
    /// # Panics
    /// Panics if there is no left board.
    pub fn left_seconds(&self) -> f64 {
        match (&self.left, &self.left_air) {
            (Some(left), _) => left.seconds_at(self.now_ms),
            (None, left) => left.as_ref().expect("a left board").seconds_at(self.now_ms),
        }
    }

    /// Advances by one millisecond: the boards run, the bridge reads and answers, and the robot moves.
    pub fn step(&mut self) {
        self.now_ms += 1;
        let now_ms = self.now_ms;
        for hand in [Hand::Left, Hand::Right] {
            let bytes = match hand {
                Hand::Left => match (&mut self.left, &mut self.left_air) {
                    (Some(left), _) => Some(left.run_to(now_ms)),
                    (None, left) => left.as_mut().map(|left| left.run_to(now_ms)),
                },
                Hand::Right => self.right.as_mut().map(|right| right.run_to(now_ms)),
            };
            let Some(mut bytes) = bytes else { continue };
            if let Some(disturbance) = &mut self.disturbance {
                let to_board = disturbance(hand, &mut bytes);
                self.send(hand, &to_board);
            }
            self.bridge.receive(hand, &bytes, now_ms, &mut self.robot);
        }
        self.bridge.step(now_ms, &mut self.robot);
        for hand in [Hand::Left, Hand::Right] {
            while let Some(message) = self.next_message(hand) {
                let mut buffer = [0; HOST_FRAME_MAX];
                let frame = encode_host(&message, &mut buffer).expect("the bridge's messages fit");
                // This byte ends the noise on the line.
                self.send(hand, &[DELIMITER]);
                self.send(hand, frame);
            }
        }
        self.log.extend(self.bridge.take_events());
        self.robot.step(self.robot.now_ms() + 1);
    }

    fn next_message(&mut self, hand: Hand) -> Option<shared_proto::message::HostMessage<'static>> {
        let connected = match hand {
            Hand::Left => {
                self.left.as_ref().is_some_and(|left| left.cable)
                    || self.left_air.as_ref().is_some_and(|left| left.board.is_connected())
            }
            Hand::Right => self.right.as_ref().is_some_and(Right::is_connected),
        };
        // A laptop cannot write to a port that has disappeared.
        if !connected {
            return None;
        }
        self.bridge.poll(hand, self.now_ms).or_else(|| self.bridge.ping(hand, self.now_ms))
    }

    fn send(&mut self, hand: Hand, bytes: &[u8]) {
        match (hand, &mut self.left, &mut self.right) {
            (Hand::Left, Some(left), _) if left.cable => left.nano.send(bytes),
            (Hand::Left, None, _) => {
                if let Some(left) = &mut self.left_air {
                    left.host.send(&mut left.board, bytes);
                }
            }
            (Hand::Right, _, Some(right)) => right.send(bytes),
            _ => {}
        }
    }

    /// Runs for some time.
    pub fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            self.step();
        }
    }

    /// Runs until a condition holds, and returns the elapsed time.
    ///
    /// # Panics
    /// Panics if the condition does not become true in time.
    pub fn run_until(&mut self, what: &str, most_ms: u64, mut holds: impl FnMut(&Self) -> bool) -> u64 {
        let start_ms = self.now_ms;
        while !holds(self) {
            self.step();
            let passed_ms = self.now_ms - start_ms;
            assert!(passed_ms <= most_ms, "{what}: not within {most_ms} ms; {:#?}", self.last_events());
        }
        self.now_ms - start_ms
    }

    fn last_events(&self) -> &[BridgeEvent] {
        &self.log[self.log.len().saturating_sub(12)..]
    }

    /// Returns whether any wheel turns.
    pub fn base_moves(&self) -> bool {
        self.robot.robot().wheels_rad_s() != [0.0; 2]
    }

    /// Returns whether any joint turns.
    pub fn arm_moves(&self) -> bool {
        !self.robot.picture().arm.at_rest()
    }

    /// Returns whether the hands control the robot.
    pub fn is_armed(&self) -> bool {
        self.bridge.safety().state() == State::Armed
    }
}
