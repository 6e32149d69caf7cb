//! The board computes what a laptop computes, bit for bit, on a grid of exactly 100 Hz.
#![cfg(feature = "nrf")]

use nano33_sensor::lsm9ds1::Config;
use shared_dsp::decision::DecisionConfig;
use shared_dsp::mlp::Model;
use shared_dsp::right::RightHand;
use tests::nrf::lsm9ds1::Motion;
use tests::nrf::recordings;
use tests::nrf::session::Session;
use tests::nrf::time::HZ;

fn full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}

/// The blob that is compiled into the image.
fn blob() -> Vec<u8> {
    models::bundled::blob().expect("the bundled model is intact")
}

struct Window {
    counts: Vec<[i16; 9]>,
    times_ms: Vec<u32>,
    at: Vec<u64>,
}

/// Runs for some seconds; what the board put into its window, and the session.
fn run(motion: Box<dyn Motion>, clock_ratio: f64, seconds: u64) -> (Session, Window) {
    let mut session = Session::uart(motion);
    session.board.soc().bus.sensor.clock_ratio = clock_ratio;
    let tap = session.board.tap("bimanual_sample", 18);
    session.run_ms(seconds * 1000);
    let mut window = Window { counts: Vec::new(), times_ms: Vec::new(), at: Vec::new() };
    for call in session.board.tapped(tap) {
        let mut counts = [0; 9];
        for (place, bytes) in counts.iter_mut().zip(call.bytes.chunks_exact(2)) {
            *place = i16::from_le_bytes([bytes[0], bytes[1]]);
        }
        window.counts.push(counts);
        window.times_ms.push(call.registers[2]);
        window.at.push(call.at);
    }
    (session, window)
}

/// Compares every state that the board sent with the laptop's on the board's own samples; hops compared.
fn compare(session: &Session, window: &Window) -> usize {
    let blob = blob();
    let mut hand = RightHand::<9>::new(Model::parse(&blob).unwrap(), DecisionConfig::default()).unwrap();
    let scale = Config::default().scale();
    let mut states = session.heard.states.iter();
    let mut hops = 0;
    for (counts, &time) in window.counts.iter().zip(&window.times_ms) {
        let values = std::array::from_fn(|axis| f32::from(counts[axis]) * scale[axis / 3]);
        let Some(output) = hand.push(&values, time) else { continue };
        // The last frame may still be on the wire.
        let Some(state) = states.next() else { break };
        assert_eq!(state.board_time_ms, output.window_end_ms);
        assert_eq!(state.scores, output.score_bytes()[..output.scores().len()], "at {time} ms");
        assert_eq!(
            (state.events, state.label, state.confidence, state.event_window_end_ms),
            (output.events, output.label, output.confidence, output.event_window_end_ms),
            "at {time} ms"
        );
        hops += 1;
    }
    hops
}

#[test]
fn on_real_recordings_scores_and_events_are_the_laptops_bit_for_bit() {
    let most = if full() { 146 } else { 26 };
    let (mut recordings, mut hops, mut events) = (0, 0, 0);
    for class in ["circle", "peak", "wave", "other"] {
        let Some((replay, files)) = recordings::joined("nano33-lsm9ds1-9axis", class, most) else {
            println!("skipped: {} is absent", recordings::data().display());
            return;
        };
        let seconds = (replay.rows.len() as u64).div_ceil(100) + 1;
        let (session, window) = run(Box::new(replay), 1.013, seconds);
        assert_eq!(session.damaged(), 0);
        hops += compare(&session, &window);
        recordings += files;
        events += session.heard.states.last().map_or(0, |s| usize::from(s.events));
    }
    println!("{recordings} recordings, {hops} hops, {events} events: board equals laptop");
    assert!(recordings >= 100 && hops > 2000);
}

struct Swing;

impl Motion for Swing {
    fn at(&self, t: f64) -> [f64; 9] {
        let wave = |hz: f64, phase: f64| (std::f64::consts::TAU * hz * t + phase).sin();
        [
            6.0 * wave(1.3, 0.0),
            4.0 * wave(2.6, 1.0),
            9.80665 + 3.0 * wave(0.7, 2.0),
            150.0 * wave(1.3, 0.5),
            90.0 * wave(1.9, 0.1),
            60.0 * wave(0.4, 0.9),
            20.0 + 5.0 * wave(0.2, 0.0),
            -3.0,
            -40.0,
        ]
    }
}

#[test]
fn a_minute_has_6000_samples_on_the_crystals_grid_whatever_the_sensors_clock() {
    for ratio in [0.96, 1.0, 1.04] {
        let (session, window) = run(Box::new(Swing), ratio, 63);
        let from = window.at.iter().position(|&at| at >= 2 * HZ).unwrap();
        let minute = window.at[from..].iter().filter(|&&at| at < 62 * HZ).count();
        let status = session.heard.statuses.last().unwrap();
        // Distance to the truth at the grid time less the stated delay (1.1 periods of 238 Hz).
        let scale = Config::default().scale();
        let mut worst = [0.0f64; 2];
        let first = (f64::from(window.times_ms[from]) / 10.0).round() as u64;
        for (k, counts) in (first..).zip(&window.counts[from..]) {
            let grid = (k * 32768 / 100) as f64 / 32768.0;
            // The board's clock starts some milliseconds after power-up: find it from the first sample.
            let truth = Swing.at(grid + offset(&session) - 1.1 / 238.0);
            for axis in 0..6 {
                let unit = f64::from(scale[axis / 3]);
                let error = (f64::from(counts[axis]) * unit - truth[axis]).abs() / unit;
                worst[axis / 3] = worst[axis / 3].max(error);
            }
        }
        println!(
            "sensor clock x{ratio}: {minute} samples in 60 s, {} dropped after start; worst error {:.1} counts of \
             the accelerometer, {:.1} of the gyroscope",
            status.dropped_samples - session.heard.statuses[1].dropped_samples,
            worst[0],
            worst[1]
        );
        assert!((5999..=6001).contains(&minute));
        assert!(window.times_ms.windows(2).all(|w| (9..=11).contains(&(w[1] - w[0]))));
        // Slopes here are up to 61 m/s^3 and 2,100 deg/s^2: 0.5 ms of timing error is 25 and 15 counts.
        assert!(worst[0] <= 26.0 && worst[1] <= 16.0, "{worst:?}");
    }
}

/// Seconds from power-up to the start of the board's clock.
fn offset(session: &Session) -> f64 {
    session.board.clock_start() as f64 / HZ as f64
}
