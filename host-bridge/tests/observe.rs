//! Tests that the observers' interface is complete: a bridge that receives only its data behaves identically.

use std::sync::{Arc, Mutex};

use host_bridge::bridge::{Bridge, BridgeEvent};
use host_bridge::demo::Demo;
use host_bridge::hands::ModelFile;
use host_bridge::intent::MotionMap;
use host_bridge::observe::SessionEvent;
use host_bridge::observe::{
    Now, Observer, OperatorKey, Sample, Setting, Snapshot, Turn, link_poses_in_world,
};
use host_bridge::safety::{Hand, State};

#[path = "support/moving.rs"]
mod moving;

use moving::{Virtual as _, bare};

#[derive(Clone, Debug, PartialEq)]
enum Seen {
    Bytes(u64, Hand, Vec<u8>),
    Sent(u64, Hand),
    Stop(u64),
    Moved(u64),
    Decided(u64),
}

#[derive(Default)]
struct Record {
    seen: Vec<Seen>,
    events: Vec<BridgeEvent>,
    samples: [usize; 2],
    sent: usize,
    last: Option<Snapshot>,
}

struct Recorder(Arc<Mutex<Record>>);

impl Observer for Recorder {
    fn received(&mut self, time_ms: u64, hand: Hand, bytes: &[u8]) {
        self.0.lock().unwrap().seen.push(Seen::Bytes(time_ms, hand, bytes.to_vec()));
    }
    fn sent(&mut self, time_ms: u64, hand: Hand, _frame: &[u8]) {
        self.0.lock().unwrap().seen.push(Seen::Sent(time_ms, hand));
        self.0.lock().unwrap().sent += 1;
    }
    fn sampled(&mut self, _time_ms: u64, sample: &Sample<'_>) {
        self.0.lock().unwrap().samples[usize::from(matches!(sample, Sample::Right { .. }))] += 1;
    }
    fn operated(&mut self, time_ms: u64, key: OperatorKey) {
        assert_eq!(key, OperatorKey::Stop);
        self.0.lock().unwrap().seen.push(Seen::Stop(time_ms));
    }
    fn turned(&mut self, turn: Turn) {
        self.0.lock().unwrap().seen.push(match turn {
            Turn::Moved(passed_ms) => Seen::Moved(passed_ms),
            Turn::Decided(time_ms) => Seen::Decided(time_ms),
            Turn::Planned => panic!("in virtual time motions are planned at once"),
        });
    }
    fn happened(&mut self, event: &SessionEvent) {
        if let SessionEvent::Bridge(event) = event {
            self.0.lock().unwrap().events.push(event.clone());
        }
    }
    fn state(&mut self, now: &Now<'_>) {
        let mut record = self.0.lock().unwrap();
        if now.time_ms.is_multiple_of(1000) {
            record.last = Some(Snapshot::of(now));
        }
    }
}

#[test]
fn a_bridge_fed_with_what_an_observer_saw_does_the_same() {
    let model = ModelFile::bundled().unwrap();
    let robot = bare();
    let mut session = Demo::bundled().session(&model, MotionMap::default(), robot).unwrap();
    let record = Arc::new(Mutex::new(Record::default()));
    session.tap_mut().add(Box::new(Recorder(record.clone())));
    for ms in 0..=20_000 {
        if ms == 15_000 {
            session.stop_key();
        }
        session.step();
    }
    let record = record.lock().unwrap();

    let mut bridge = Bridge::new(MotionMap::default());
    let mut robot = bare();
    let mut events = Vec::new();
    for seen in &record.seen {
        match seen {
            Seen::Bytes(time_ms, hand, bytes) => bridge.receive(*hand, bytes, *time_ms, &mut robot),
            // One of two messages was due at this time, and the bridge knows which one it sent.
            Seen::Sent(time_ms, hand) => {
                let _ = bridge.poll(*hand, *time_ms).or_else(|| bridge.ping(*hand, *time_ms));
            }
            Seen::Stop(time_ms) => bridge.stop_key(*time_ms, &mut robot),
            Seen::Moved(passed_ms) => robot.pass(*passed_ms),
            Seen::Decided(time_ms) => {
                bridge.step(*time_ms, &mut robot);
                events.extend(bridge.take_events());
            }
        }
    }
    assert_eq!(events, record.events);
    assert!(events.len() > 10, "{events:?}");
    assert_eq!(robot.odometry(), session.door().odometry());
    assert_eq!(robot.arm(), session.door().arm());
    // Both hands are sampled at 100 Hz from time 0.
    assert_eq!(record.samples, [2001, 2001]);
    assert!(record.sent >= 2, "both boards were asked who they are");

    let last = record.last.as_ref().unwrap();
    assert_eq!((last.time_ms, last.safety), (20_000, State::Stopped));
    assert_eq!(last.right.scores.len(), last.right.labels.len());
    assert!(last.left.link.connected && last.right.link.live);
    let setting = Setting::of(&session.now());
    assert_eq!(setting.robot.joints.len(), 7);
    // The flange pose from the transforms must equal the flange pose from the arm, shifted by the base pose.
    let now = session.now();
    let flange = link_poses_in_world(&now, &now.robot.picture().arm.joints_rad)[7].position_m;
    let odometry = now.robot.picture().odometry;
    let (s, c) = odometry.heading_rad.sin_cos();
    let [x, y, z] = last.flange.position_m.to_array();
    let (x, y) = (x + setting.robot.mount_m[0], y + setting.robot.mount_m[1]);
    let expected = [odometry.x_m + c * x - s * y, odometry.y_m + s * x + c * y, z + setting.robot.mount_m[2]];
    for (got, expected) in flange.to_array().into_iter().zip(expected) {
        assert!((got - expected).abs() < 1e-12, "{flange:?} {expected:?}");
    }
}
