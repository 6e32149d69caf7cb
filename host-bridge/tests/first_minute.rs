//! Tests the first minute. An unknown wearer shows each gesture three times.
//! The board then gets a model of this hand.
//! The tests run in virtual time, with the boards' own code and simulated wearers.

use std::path::Path;

use host_bridge::bridge::{EventKind, GestureOutcome, Prompt};
use host_bridge::config::{Config, HandInput};
use host_bridge::engine::Engine;
use host_bridge::hands::ModelFile;
use host_bridge::hands::virtual_board::{VirtualRight, onto};
use host_bridge::links::SystemClock;
use host_bridge::observe::SessionEvent;
use host_bridge::robot::Door as _;
use host_bridge::safety::Hand;
use host_bridge::wearer::{Settings, Wearer};
use models::dataset::Dataset;
use models::synth::{Motion, Segment, Wearer as Simulated, session};
use shared_board::Identity;
use shared_board::hand::CountHand;
use shared_board::memory::{RamFlash, at_once};
use shared_board::models::{MappedFlash as _, ModelStore, Runs};
use shared_dsp::right::RightHand;
use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::network::Model;
use shared_proto::message::Board as Kind;

#[path = "support/moving.rs"]
mod moving;
#[path = "support/renamed.rs"]
mod renamed;

use moving::{Robot, live};

/// Scale of the LSM9DS1 in the right board's settings.
const SCALE: [f32; 3] = [0.000_732 * 9.806_65, 0.07, 0.014];
const RUNS: Runs = Runs { axes: 9, sample_hz: 100 };

/// A right board with its flash.
struct Board {
    board: VirtualRight<CountHand<'static, 9>>,
    store: ModelStore<RamFlash>,
    /// The model that the board is delivered with.
    built_in: Vec<u8>,
    boot_id: u32,
    started_ms: u64,
}

impl Board {
    fn new(built_in: Vec<u8>) -> Self {
        let (board, store) = Self::start(1, RamFlash::blank(), &built_in);
        Board { board, store, built_in, boot_id: 1, started_ms: 0 }
    }

    fn start(
        boot_id: u32,
        flash: RamFlash,
        built_in: &[u8],
    ) -> (VirtualRight<CountHand<'static, 9>>, ModelStore<RamFlash>) {
        let (store, found) = ModelStore::open(flash, RUNS);
        let blob = match found.model {
            Some(place) => store.flash().mapped()[place.offset()..][..place.len].to_vec(),
            None => built_in.to_vec(),
        };
        let model = Model::parse(blob.leak()).unwrap();
        let hand = RightHand::new(model, DecisionConfig::default()).expect("9 axes");
        let identity = Identity { board: Kind::RightNano33, firmware: "virtual", boot_id, sample_hz: 100 };
        (VirtualRight::start(identity, CountHand::new(hand, SCALE)), store)
    }

    fn restart(&mut self, now_ms: u64) {
        self.boot_id += 1;
        (self.board, self.store) = Self::start(self.boot_id, self.store.flash().clone(), &self.built_in);
        self.started_ms = now_ms;
    }
}

/// The test desk: board, wearer and laptop with a common time.
struct Desk {
    board: Board,
    engine: Engine<'static, Robot>,
    wearer: Wearer,
    hand: Simulated,
    /// The next samples of the hand. The hand is at rest if there are none.
    next: std::collections::VecDeque<[f32; 9]>,
    /// Performs the gesture that the program asks for.
    obeys: bool,
    drawn: String,
    takes: u64,
    now_ms: u64,
    events: Vec<SessionEvent>,
}

impl Desk {
    fn new(built_in: Vec<u8>, settings: Settings) -> Self {
        Desk {
            board: Board::new(built_in),
            engine: live(&Config::default(), HandInput::Nobody, HandInput::Board),
            wearer: Wearer::start(settings, &SystemClock::start()).unwrap(),
            hand: Simulated::evaluation(41, 3),
            next: Default::default(),
            obeys: true,
            drawn: String::new(),
            takes: 0,
            now_ms: 0,
            events: Vec::new(),
        }
    }

    fn draws(&mut self, motion: Motion, seconds: f64) {
        self.takes += 1;
        let script = [Segment::new(Motion::IDLE, 0.3), Segment::new(motion, seconds)];
        let recording = session(&self.hand, self.takes, &script);
        self.next = recording.samples().map(|sample| sample.try_into().unwrap()).collect();
    }

    fn prompt(&self) -> Prompt {
        let empty = Prompt { text: String::new(), button: None };
        self.engine.bridge().prompt().cloned().unwrap_or(empty)
    }

    /// Advances by one millisecond.
    fn step(&mut self) {
        self.now_ms += 1;
        let mut wire = Vec::new();
        let board_ms = self.now_ms - self.board.started_ms;
        if self.now_ms.is_multiple_of(10) {
            let asked = self.prompt().text;
            if asked != self.drawn && asked.starts_with("NOW draw ") && self.obeys {
                let wanted = |motion: &Motion| asked.contains(&format!("draw {},", motion.label()));
                let motion =
                    Motion::GESTURES.into_iter().find(wanted).expect("a gesture that the model knows");
                self.draws(motion, 3.0);
            }
            self.drawn = asked;
            if self.next.is_empty() {
                self.draws(Motion::IDLE, 60.0);
            }
            let sample = self.next.pop_front().unwrap();
            let counts = std::array::from_fn(|i| (sample[i] / SCALE[i / 3]).round() as i16);
            self.board.board.sample(&counts, board_ms, &mut wire);
        }
        self.heard(&wire);
        self.wearer.settle(self.now_ms);
        self.wearer.turn(&mut self.engine, true, self.now_ms);
        self.events.extend(self.engine.advance(self.now_ms, [false, true]));
        for frame in self.engine.take_outgoing(Hand::Right) {
            let mut wire = Vec::new();
            let store = &mut self.board.store;
            self.board.board.receive(&frame, board_ms, &mut wire, |request, wire| {
                at_once(store.answer(request, async || (), &mut onto(wire)));
            });
            self.heard(&wire);
        }
    }

    fn heard(&mut self, wire: &[u8]) {
        self.engine.receive(Hand::Right, wire, self.now_ms);
        self.wearer.receive(wire, self.now_ms);
    }

    fn pass(&mut self, ms: u64) {
        (0..ms).for_each(|_| self.step());
    }

    /// Runs until the wearer sees this text.
    fn until(&mut self, words: &str) -> Prompt {
        for _ in 0..240_000 {
            self.step();
            if self.prompt().text.contains(words) {
                return self.prompt();
            }
        }
        panic!("never told {words:?}, but {:#?}", self.told());
    }

    fn told(&self) -> Vec<&str> {
        self.events
            .iter()
            .filter_map(|event| match event {
                SessionEvent::Wearer { text, .. } => Some(text.as_str()),
                _ => None,
            })
            .collect()
    }

    /// Returns the effects of the gestures since this event.
    fn gestures(&self, since: usize) -> Vec<(&str, &GestureOutcome)> {
        self.events[since..]
            .iter()
            .filter_map(|event| match event {
                SessionEvent::Bridge(event) => match &event.kind {
                    EventKind::Gesture { label, outcome, .. } => Some((label.as_str(), outcome)),
                    _ => None,
                },
                _ => None,
            })
            .collect()
    }
}

fn bundled() -> Vec<u8> {
    ModelFile::bundled().unwrap().blob().to_vec()
}

fn settings(folder: &Path, name: Option<&str>) -> Settings {
    Settings { name: name.map(str::to_owned), folder: folder.join("wearers"), model: None }
}

#[test]
fn who_shows_three_of_each_gets_a_model_that_is_kept_and_moves_nothing_meanwhile() {
    let folder = tempfile::tempdir().unwrap();
    let mut desk = Desk::new(bundled(), settings(folder.path(), Some("ada")));
    let offer = desk.until("ada has shown nothing yet");
    assert_eq!(offer.button, Some("show three of each"));
    assert!(offer.text.contains("up-down") && offer.text.contains("does not move the robot"), "{offer:?}");
    assert!(!offer.text.contains("idle") && !offer.text.contains("other"), "{offer:?}");

    let arm = desk.engine.door().picture().arm.joints_rad;
    let since = desk.events.len();
    desk.wearer.press();
    let now = desk.until("NOW draw");
    assert!(now.text.contains("stands still") && now.button == Some("give up"), "{now:?}");
    let kept = desk.until("press its reset button");
    assert_eq!(desk.gestures(since), [], "what is shown is no gesture");
    assert_eq!(desk.engine.door().picture().arm.joints_rad, arm);
    assert!(!desk.events[since..].iter().any(|event| matches!(event, SessionEvent::Marked { .. })));

    // The wearer shows six gestures, each three times, and gets a model under her name.
    let home = folder.path().join("wearers/ada");
    let recordings = Dataset::read(&home.join("recordings"), None).unwrap();
    assert_eq!((recordings.items.len(), recordings.labels.len()), (18, 6));
    let own = ModelFile::read(&home.join("ada.tflite")).unwrap();
    let id = format!("{:08x}", Model::parse(own.blob()).unwrap().info().model_id);
    assert!(kept.text.contains(&id), "{id} {kept:?}");

    desk.board.restart(desk.now_ms);
    let knows = desk.until("the board knows ada");
    assert!(knows.text.contains(&id) && knows.button == Some("show three of each"), "{knows:?}");
    desk.pass(5000);
    let mut right = 0;
    for motion in Motion::GESTURES {
        let since = desk.events.len();
        desk.draws(motion, 4.0);
        desk.pass(7000);
        let gestures = desk.gestures(since);
        println!("{}: {gestures:?}", motion.label());
        right += usize::from(matches!(gestures.as_slice(), [(label, _)] if *label == motion.label()));
    }
    assert!(right >= 5, "{right} of 6 gestures of hers make exactly one right event");

    // On another day, another board is used. The stored model is offered, and nothing needs to be shown.
    let mut desk = Desk::new(bundled(), settings(folder.path(), Some("ada")));
    let offer = desk.until("not that of ada");
    assert_eq!(offer.button, Some("send the kept model"));
    desk.wearer.press();
    desk.until("press its reset button");
    desk.board.restart(desk.now_ms);
    desk.until("the board knows ada");
}

#[test]
fn whoever_gives_up_or_does_not_move_leaves_the_board_and_the_disk_as_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let mut desk = Desk::new(bundled(), settings(folder.path(), None));
    let offer = desk.until("who wears the right hand is not known (--wearer NAME)");
    assert_eq!(offer.button, Some("show three of each"));
    desk.wearer.press();
    desk.until("NOW draw");
    desk.pass(500);
    desk.wearer.press();
    desk.until("given up: as you wished. who wears");
    // The board recognises gestures again, and they have an effect.
    desk.pass(6000);
    let since = desk.events.len();
    desk.draws(Motion::UpDown, 4.0);
    desk.pass(7000);
    assert!(
        matches!(desk.gestures(since).as_slice(), [("up-down", GestureOutcome::Started(_))]),
        "{:?}",
        desk.gestures(since)
    );

    // The recording of a resting hand repeats every minute, and the hand jumps at that moment.
    desk.obeys = false;
    desk.next.clear();
    desk.wearer.press();
    desk.until("the hand hardly moved: once more");
    desk.until("given up: the hand hardly moved, 3 times. who wears");
    assert!(!folder.path().join("wearers").exists());

    // A board that restarts during a recording is no longer in record mode.
    desk.obeys = true;
    desk.wearer.press();
    desk.until("NOW draw");
    desk.board.restart(desk.now_ms);
    desk.until("given up: the board restarted");
    assert!(!folder.path().join("wearers").exists());
}

#[test]
fn where_board_or_model_cannot_the_wearer_is_told_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    // The model on the board knows other gestures.
    let (file, id) = renamed::renamed_model(folder.path());
    let other = ModelFile::read(&file).unwrap().blob().to_vec();
    let mut desk = Desk::new(other, settings(folder.path(), Some("ada")));
    let told = desk.until("no gestures can be shown");
    assert!(told.text.contains(&id) && told.text.contains("--model FILE.tflite"), "{told:?}");
    assert_eq!(told.button, None);
    let said = desk.told().len();
    desk.wearer.press();
    desk.pass(3000);
    assert_eq!(desk.told().len(), said, "nothing begins");

    // The base model is there, but the file with its training data is missing.
    let settings = Settings { model: Some(file), ..settings(folder.path(), Some("ada")) };
    let mut desk = Desk::new(bundled(), settings);
    let told = desk.until("no gestures can be shown");
    assert!(told.text.contains("needed beside the model"), "{told:?}");

    // Nothing can be stored, because a file is in the folder's place.
    let blocked =
        Settings { name: Some("ada".to_owned()), folder: folder.path().join("a-file"), model: None };
    std::fs::write(&blocked.folder, "").unwrap();
    let mut desk = Desk::new(bundled(), blocked);
    desk.until("ada has shown nothing yet");
    desk.wearer.press();
    let told = desk.until("is there room, and may you?");
    assert_eq!(told.button, Some("show three of each"));
    assert_eq!(at_boot(&desk), format!("{:08x}", Model::parse(&bundled()).unwrap().info().model_id));
}

/// Returns the model that the board runs.
fn at_boot(desk: &Desk) -> String {
    let model = desk.engine.bridge().link(Hand::Right).model().unwrap();
    format!("{:08x}", model.model_id)
}
