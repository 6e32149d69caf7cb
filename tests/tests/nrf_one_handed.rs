//! Tests one-handed mode with the firmware image of the Nano 33 on the emulated board.
//! The emulated sensor feels a simulated hand, the board sends its tilt, and the bridge drives the simulated robot.
#![cfg(feature = "nrf")]

#[path = "../../host-bridge/tests/support/wrist.rs"]
mod wrist;

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use host_bridge::arm::Director;
use host_bridge::bridge::{EventKind, GestureOutcome};
use host_bridge::config::Config;
use host_bridge::demo::Demo;
use host_bridge::engine::Engine;
use host_bridge::observe::SessionEvent;
use host_bridge::robot::Door as _;
use host_bridge::robots::Stage;
use host_bridge::safety::{HaltReason, Hand, State};
use host_bridge::sim::Simulator;
use host_bridge::source::Source;
use tests::nrf::board::{Board, Boot};
use tests::nrf::build::{Variant, image};
use tests::nrf::lsm9ds1::Motion;
use tests::nrf::recordings::rows;
use tests::nrf::time::ms;
use wrist::{Rows, Wrist};

/// Rows in which the demo's wearer only rests.
const RESTING: std::ops::Range<usize> = 4250..5100;
/// The sensor may ask for the rows of its last readings once more.
const KEPT_ROWS: usize = 64;

/// The wrist in continuous time.
struct Worn {
    wrist: Wrist,
    rows: VecDeque<[f64; 9]>,
    /// Number of the first kept row.
    first: usize,
}

struct Shared(Rc<RefCell<Worn>>);

impl Motion for Shared {
    fn at(&self, seconds: f64) -> [f64; 9] {
        let Worn { wrist, rows, first } = &mut *self.0.borrow_mut();
        let place = (100.0 * seconds).max(*first as f64);
        let (number, part) = (place as usize, place.fract());
        while *first + rows.len() < number + 2 {
            rows.push_back(wrist.sample());
            if rows.len() > KEPT_ROWS {
                rows.pop_front();
                *first += 1;
            }
        }
        let [from, to] = [0, 1].map(|next| rows[number + next - *first]);
        std::array::from_fn(|axis| from[axis] + part * (to[axis] - from[axis]))
    }
}

/// The board, its wearer, the laptop and the robot.
struct Desk {
    board: Board,
    worn: Rc<RefCell<Worn>>,
    /// Whether the cable is plugged in.
    cable: bool,
    engine: Engine<'static, Director<Simulator>>,
    now_ms: u64,
    events: Vec<EventKind>,
}

impl Desk {
    fn new() -> Self {
        let recorded: Rows = rows(&Demo::bundled().right.resampled());
        let worn = Worn { wrist: Wrist::new(recorded, RESTING), rows: VecDeque::new(), first: 0 };
        let worn = Rc::new(RefCell::new(worn));
        let motion = Box::new(Shared(Rc::clone(&worn)));
        let board = Board::new(image(Variant::Bootloader), Boot::StockBootloader, motion);
        let config = Config::parse("[one_handed]\non = true\n").unwrap();
        let robot = Stage::bare().simulated(&config);
        let sources = [Source::Nobody, Source::link()];
        let engine =
            Engine::new(config.bridge(config.motion_map()), robot, sources, 0).with_tilt(config.tilt);
        Desk { board, worn, cable: true, engine, now_ms: 0, events: Vec::new() }
    }

    fn run(&mut self, for_ms: u64) {
        for _ in 0..for_ms {
            self.now_ms += 1;
            self.board.run_until(ms(self.now_ms));
            let bytes = self.board.uart_out();
            if self.cable {
                self.engine.receive(Hand::Right, &bytes, self.now_ms);
            }
            let events = self.engine.advance(self.now_ms, [false, self.cable]);
            self.events.extend(events.into_iter().filter_map(|event| match event {
                SessionEvent::Bridge(event) => Some(event.kind),
                _ => None,
            }));
            for frame in self.engine.take_outgoing(Hand::Right) {
                self.board.uart_in(&frame);
            }
        }
    }

    /// Runs until the condition holds, and returns the passed time.
    fn until(&mut self, what: &str, most_ms: u64, holds: impl Fn(&Self) -> bool) -> u64 {
        let start_ms = self.now_ms;
        while !holds(self) {
            assert!(self.now_ms - start_ms < most_ms, "{what}: not within {most_ms} ms; {:?}", self.events);
            self.run(1);
        }
        self.now_ms - start_ms
    }

    fn tilt(&self, pitch_deg: f64, roll_deg: f64) {
        self.worn.borrow_mut().wrist.tilt(pitch_deg, roll_deg);
    }

    fn level(&mut self) {
        self.tilt(0.0, 0.0);
        self.run(700);
        assert!(self.rests());
    }

    /// Draws the gesture of the demo's recording that begins at this time, after 0.3 s of the rest before it.
    fn draw(&self, at_s: f64) {
        let onset = (100.0 * at_s) as usize;
        self.worn.borrow_mut().wrist.drawing = Some(onset - 30..onset + 400);
    }

    fn gestures(&self) -> Vec<GestureOutcome> {
        let outcome = |event: &EventKind| match event {
            EventKind::Gesture { outcome, .. } => Some(outcome.clone()),
            _ => None,
        };
        self.events.iter().filter_map(outcome).collect()
    }

    fn base(&self) -> host_bridge::base::Odometry {
        self.engine.door().robot().odometry()
    }

    fn rests(&self) -> bool {
        self.engine.door().robot().wheels_rad_s() == [0.0; 2]
    }

    fn state(&self) -> State {
        self.engine.bridge().safety().state()
    }

    fn asks_nothing(&self) -> bool {
        self.engine.bridge().twist() == host_bridge::robot::Twist::ZERO
    }
}

#[test]
fn the_image_of_the_right_hand_alone_drives_the_base_and_its_gestures_move_only_the_arm() {
    let mut desk = Desk::new();
    let armed_ms = desk.until("armed", 8000, |desk| desk.state() == State::Armed);
    println!("armed {armed_ms} ms after power-on");
    assert!(desk.rests() && desk.base().path_m == 0.0);

    for side in 1..=4 {
        let path_m = desk.base().path_m;
        desk.tilt(25.0, 0.0);
        desk.until("forward", 2000, |desk| !desk.asks_nothing());
        desk.until("a side", 4000, |desk| desk.base().path_m > path_m + 0.9);
        desk.level();
        desk.tilt(0.0, 25.0);
        // The base turns further while it brakes.
        let target_rad = f64::from(side) * std::f64::consts::FRAC_PI_2 - 0.14;
        desk.until("a turn to the left", 6000, |desk| desk.base().heading_rad > target_rad);
        desk.level();
    }
    let here = desk.base();
    println!(
        "square: x {:.2} m, y {:.2} m, heading {:.2} rad, path {:.2} m",
        here.x_m, here.y_m, here.heading_rad, here.path_m
    );
    // The limits are those of the same square with the virtual board.
    assert!(here.x_m.hypot(here.y_m) < 0.3, "back at the start");
    assert!((here.heading_rad - std::f64::consts::TAU).abs() < 0.3);
    assert!((3.6..5.2).contains(&here.path_m));
    assert_eq!(desk.gestures(), [], "driving is no gesture");
    desk.run(1000);

    // The demo's to-fro starts at 8.8 s, and its circle at 66.4 s.
    desk.draw(8.8);
    desk.run(5000);
    assert_eq!(desk.gestures(), [GestureOutcome::Started("pick-up".into())]);
    let moved_m = desk.base().path_m - here.path_m;
    println!("to-fro while the base stands: the base moves {:.1} cm", 100.0 * moved_m);
    assert_eq!(moved_m, 0.0);
    desk.until("the arm is at the pose", 20_000, |desk| desk.engine.door().picture().arm.at_rest());

    // A gesture begins while the base drives: it brakes within four hops of 80 ms, see host-bridge's tests/one_handed.rs.
    desk.tilt(25.0, 0.0);
    desk.until("forward again", 3000, |desk| !desk.rests());
    desk.run(1000);
    desk.draw(66.4);
    desk.run(300);
    let begins = desk.base();
    let braked_ms = desk.until("brakes for the gesture", 320, Desk::asks_nothing);
    desk.until("rests", 600, Desk::rests);
    let rolled_m = desk.base().path_m - begins.path_m;
    println!("circle while the base drives: it brakes after {braked_ms} ms, and rolls {rolled_m:.3} m");
    assert!(rolled_m <= 0.5 * 0.32 + 0.125, "{rolled_m} m");
    desk.run(4000);
    let [_, outcome] = &desk.gestures()[..] else { panic!("{:?}", desk.gestures()) };
    assert_eq!(*outcome, GestureOutcome::Started("random-top".into()));
    assert!(desk.rests(), "the hand was not level since");
    desk.level();

    // The cable is pulled while the base drives.
    desk.run(2000);
    desk.tilt(25.0, 0.0);
    desk.until("forward once more", 3000, |desk| !desk.rests());
    desk.cable = false;
    let halted_ms = desk.until("a halt", 400, |desk| desk.state() == State::Stale);
    println!("cable pulled: halt after {halted_ms} ms");
    assert!(halted_ms <= 250, "{halted_ms} ms");
    assert!(desk.asks_nothing());
    let silence = EventKind::Halt { reason: HaltReason::Silence(Hand::Right) };
    assert!(desk.events.contains(&silence));
    // The hand was not neutral since.
    desk.cable = true;
    desk.run(1500);
    assert!(desk.asks_nothing() && desk.rests());
    desk.level();
    desk.until("armed again", 2000, |desk| desk.state() == State::Armed);
}
