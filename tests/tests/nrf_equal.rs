//! Tests that the board's results equal the laptop's bit for bit, on a grid of exactly 100 Hz.
#![cfg(feature = "nrf")]

use models::synth::{self, Segment};
use nano33_sensor::SCALE;
use shared_dsp::right::RightHand;
use shared_dsp::right::aligned::AlignedWindow;
use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::features::FeatureWindow;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::Model;
use tests::is_full;
use tests::nrf::board::{Kind, Tapped};
use tests::nrf::lsm9ds1::{Motion, Replay, Still};
use tests::nrf::recordings;
use tests::nrf::session::{Right, RightRig};
use tests::nrf::time::HZ;
use tests::nrf::transfer::{install, random_model};

/// Returns the blob that is compiled into the image.
fn blob() -> Vec<u8> {
    models::bundled::blob().expect("the bundled model is intact")
}

struct Window {
    counts: Vec<[i16; 9]>,
    times_ms: Vec<u32>,
    at: Vec<u64>,
    /// Data that the board stores about the hand, read once a second, with the number of samples before that moment.
    memory: Vec<(usize, Vec<u8>)>,
}

/// Number of sets per second of the board's sensor, from its data sheet.
fn sensor_hz(kind: Kind) -> f64 {
    match kind {
        Kind::Nano33 => 238.0,
        Kind::Nano33Rev2 => 200.0,
        Kind::Xiao => 208.0,
    }
}

/// Number of axes of the board's sensor.
fn axes(kind: Kind) -> usize {
    if kind == Kind::Nano33 { 9 } else { 6 }
}

/// Runs for some seconds, and returns the samples in the board's window and the session.
fn run(kind: Kind, motion: Box<dyn Motion>, clock_ratio: f64, seconds: u64) -> (RightRig, Window) {
    let mut session = RightRig::of_kind(kind, motion);
    session.board.soc().bus.sensor.set_clock_ratio(clock_ratio);
    let tap = session.board.tap("bimanual_sample", 18);
    let memory = watch(&mut session, tap, seconds);
    let window = Window { memory, ..window_of(session.board.tapped(tap)) };
    (session, window)
}

/// Runs for some seconds. From the fourth second on, records the number of tapped samples and the board's hand data.
fn watch(session: &mut RightRig, tap: usize, seconds: u64) -> Vec<(usize, Vec<u8>)> {
    let mut memory = Vec::new();
    for second in 1..=seconds {
        session.run_ms(1000 - session.board.now() / tests::nrf::time::ms(1) % 1000);
        // The state is read only between two hops.
        while !session.board.is_asleep() {
            session.run_ms(1);
        }
        let taken = session.board.tapped(tap);
        if let (Some(last), true) = (taken.last(), second > 3) {
            let hand = last.registers[1];
            let count = taken.len();
            memory.push((count, session.board.soc().ram.get(hand, 28 << 10).expect("in RAM").to_vec()));
        }
    }
    memory
}

/// Takes a sample, and returns no features until the window is full.
type Features = Box<dyn FnMut(&[f32; 9]) -> Option<Vec<f32>>>;

/// Calculates the laptop's features for a recipe.
fn features(recipe: FeatureKind) -> Features {
    match recipe {
        FeatureKind::Raw | FeatureKind::LogPower => {
            let mut window = FeatureWindow::<9>::new();
            Box::new(move |sample| {
                window.push(sample);
                window.is_full().then(|| window.features().as_flattened().to_vec())
            })
        }
        FeatureKind::Aligned => {
            let mut window = AlignedWindow::<9>::new();
            Box::new(move |sample| {
                window.push(sample);
                window.is_full().then(|| window.features().to_vec())
            })
        }
    }
}

/// Returns the samples recorded by a tap on `bimanual_sample`.
fn window_of(calls: &[Tapped]) -> Window {
    let counts = |call: &Tapped| {
        std::array::from_fn(|axis| i16::from_le_bytes([call.bytes[2 * axis], call.bytes[2 * axis + 1]]))
    };
    Window {
        counts: calls.iter().map(counts).collect(),
        times_ms: calls.iter().map(|call| call.registers[2]).collect(),
        at: calls.iter().map(|call| call.at).collect(),
        memory: Vec::new(),
    }
}

/// Compares every state of the board with this model, and once a second also the features.
/// The expected values are the laptop's, computed from the board's own samples. Returns the number of compared hops.
fn compare(blob: &[u8], session: &RightRig, window: &Window) -> usize {
    let model = Model::parse(blob).unwrap();
    compare_features(model.info().recipe, window);
    let mut hand = RightHand::<9>::new(model, DecisionConfig::default()).unwrap();
    let scale = SCALE;
    // A board without a sample sends a state with time 0.
    let mut states = session.heard.states.iter().skip_while(|state| state.board_time_ms == 0);
    let mut hops = 0;
    for (counts, &time) in window.counts.iter().zip(&window.times_ms) {
        let values = std::array::from_fn(|axis| f32::from(counts[axis]) * scale[axis / 3]);
        let Some(output) = hand.push(&values, time) else { continue };
        // The last frame may still be in transit.
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

/// Checks that the board's memory contains the laptop's features bit for bit.
fn compare_features(recipe: FeatureKind, window: &Window) {
    let scale = SCALE;
    let mut features = features(recipe);
    let mut memory = window.memory.iter();
    let mut due = memory.next();
    let mut compared = 0;
    for (n, counts) in window.counts.iter().enumerate() {
        let now = features(&std::array::from_fn(|axis| f32::from(counts[axis]) * scale[axis / 3]));
        let Some((_, bytes)) = due.filter(|(count, _)| *count == n + 1) else { continue };
        due = memory.next();
        let Some(wanted) = now else { continue };
        let wanted: Vec<u8> = wanted.iter().flat_map(|f| f.to_le_bytes()).collect();
        let found = (0..=bytes.len() - wanted.len()).step_by(4).any(|at| bytes[at..].starts_with(&wanted));
        assert!(found, "features after {} samples differ", n + 1);
        compared += 1;
    }
    assert!(compared + 1 >= window.memory.len(), "{compared} of {} compared", window.memory.len());
}

/// Duration in s for which the first row is repeated before the recording, so that the sensor's rate is known.
const LEAD_S: u64 = 3;
/// Delay of a grid sample relative to its grid time, in periods of the sensor (`sensor/src/grid.rs`).
const DELAY_PERIODS: f64 = 1.1;
/// Maximum error of the time of a set on the grid, in ms, as specified for the resampler.
const TIMING_MS: f64 = 0.5;

/// Ratio of the sensor's clock to the board's clock in the comparisons below.
const CLOCK_RATIO: f64 = 1.013;

/// A recording after resampling by the board.
struct Resampled {
    session: RightRig,
    window: Window,
    /// Differences between sample and row in counts, each with its tolerance, for the first six axes only.
    errors: Vec<(f64, f64)>,
}

/// Replays rows at 100 Hz and compares each sample with its row.
/// Row n reaches the sensor at the time of the board's sample `100 · LEAD_S + n`.
///
/// Between two rows the hand moves along a straight line.
/// Let m and m' be the slopes before and after a row, in counts per ms.
/// The sensor measures every p ms and rounds the values. This rounding adds an error of up to half a count.
/// The grid interpolates linearly between measurements and rounds again, which adds up to half a count more.
/// An interpolation across the corner at a row has an error of at most |m' − m| · p / 4.
/// A time error of [`TIMING_MS`] adds its product with the steeper slope.
/// The magnetometer (80 Hz) is not interpolated: its newest value was taken between the previous and the next row.
fn resample(kind: Kind, rows: Vec<[f64; 9]>) -> Resampled {
    let clock_start_s = {
        let mut session = RightRig::of_kind(kind, Box::new(Still));
        session.run_ms(50);
        offset(&session)
    };
    let start = clock_start_s + LEAD_S as f64 - DELAY_PERIODS / sensor_hz(kind);
    let seconds = LEAD_S + (rows.len() as u64).div_ceil(100) + 1;
    let replay = Replay { rows: rows.clone(), interval: 0.01, start };
    let (session, window) = run(kind, Box::new(replay), CLOCK_RATIO, seconds);
    assert_eq!(offset(&session), clock_start_s, "the board starts as it did before");
    assert_eq!(session.damaged(), 0);

    let scale = SCALE;
    let period_ms = CLOCK_RATIO * 1000.0 / sensor_hz(kind);
    // The BMI270's counts are converted, which adds another rounding error.
    let rounding = if kind == Kind::Nano33Rev2 { 1.5 } else { 1.0 };
    let mut errors = Vec::new();
    let mut next = 0;
    for (counts, &time_ms) in window.counts.iter().zip(&window.times_ms) {
        let number = (f64::from(time_ms) / 10.0).round() as usize;
        let Some(n) = number.checked_sub(100 * LEAD_S as usize).filter(|&n| n < rows.len()) else { continue };
        assert_eq!(n, next, "no sample is missing and none comes twice");
        next += 1;
        let (before, here, after) = (rows[n.saturating_sub(1)], rows[n], rows[(n + 1).min(rows.len() - 1)]);
        for axis in 0..9 {
            let unit = f64::from(scale[axis / 3]);
            let [before, here, after] = [before, here, after].map(|row| row[axis] / unit);
            let got = f64::from(counts[axis]);
            if axis < 6 {
                let (m, m_next) = ((here - before) / 10.0, (after - here) / 10.0);
                let corner = (m_next - m).abs() * period_ms / 4.0;
                let allowed = rounding + corner + TIMING_MS * m.abs().max(m_next.abs());
                let error = (got - here.clamp(-32_768.0, 32_767.0)).abs();
                assert!(error <= allowed, "row {n}, axis {axis}: {error:.1} counts, {allowed:.1} allowed");
                errors.push((error, allowed));
            } else if axes(kind) == 9 {
                let (low, high) = (before.min(here).min(after), before.max(here).max(after));
                assert!((low - 1.0..=high + 1.0).contains(&got), "row {n}, axis {axis}: {got} counts");
            } else {
                assert_eq!(got, 0.0, "no magnetometer");
            }
        }
    }
    assert_eq!(next, rows.len(), "every row has its sample");
    Resampled { session, window, errors }
}

/// Prints the differences between samples and the rows of their recordings.
fn say(what: &str, errors: &mut [(f64, f64)]) {
    let used = errors.iter().map(|(error, allowed)| error / allowed).fold(0.0, f64::max);
    let within_one = errors.iter().filter(|(error, _)| *error <= 1.0).count() as f64 / errors.len() as f64;
    errors.sort_by(|a, b| a.0.total_cmp(&b.0));
    let at = |share: f64| errors[((errors.len() - 1) as f64 * share) as usize].0;
    println!(
        "{what}: {} values differ from the CSV by {:.2} counts (median), {:.1} (99 %), {:.0} (worst); {:.0} % by at \
         most one; never by more than {:.0} % of the bound",
        errors.len(),
        at(0.5),
        at(0.99),
        at(1.0),
        within_one * 100.0,
        used * 100.0
    );
}

#[test]
fn on_real_recordings_scores_and_events_are_the_laptops_bit_for_bit() {
    equals_on_real_recordings(Kind::Nano33);
}

#[test]
fn on_real_recordings_a_rev2_board_computes_what_the_laptop_does() {
    equals_on_real_recordings(Kind::Nano33Rev2);
}

#[test]
fn on_real_recordings_a_xiao_computes_what_the_laptop_does() {
    equals_on_real_recordings(Kind::Xiao);
}

fn equals_on_real_recordings(kind: Kind) {
    // Maximum number of recordings per class, and required numbers of recordings and hops in total.
    let (most, least_recordings, least_hops) = match (is_full(), kind) {
        (true, _) => (146, 100, 2000),
        (false, Kind::Nano33) => (13, 52, 1000),
        (false, _) => (4, 16, 300),
    };
    let (mut recordings, mut hops, mut events, mut errors) = (0, 0, 0, Vec::new());
    for class in ["circle", "peak", "wave", "other"] {
        let Some((replay, files)) = recordings::joined("nano33-lsm9ds1-9axis", class, most) else {
            println!("skipped: {} is absent", recordings::data().display());
            return;
        };
        let Resampled { session, window, errors: these } = resample(kind, replay.rows);
        hops += compare(&blob(), &session, &window);
        recordings += files;
        events += session.heard.states.last().map_or(0, |s| usize::from(s.events));
        errors.extend(these);
    }
    println!("{recordings} recordings, {hops} hops, {events} events: {kind:?} equals laptop");
    say("real recordings", &mut errors);
    assert!(recordings >= least_recordings && hops > least_hops);
}

#[test]
fn on_simulated_wearers_scores_and_events_are_the_laptops_bit_for_bit() {
    let wearers = if is_full() { 20 } else { 2 };
    let (mut hops, mut events, mut errors) = (0, 0, Vec::new());
    for index in 1..=wearers {
        let mut script = vec![Segment::new(synth::Motion::IDLE, 2.0)];
        for gesture in synth::Motion::GESTURES {
            script.push(Segment::new(gesture, 2.5));
            script.push(Segment::new(synth::Motion::IDLE, 1.5));
        }
        let recording = synth::session(&synth::Wearer::evaluation(21, index), 0, &script);
        let Resampled { session, window, errors: these } =
            resample(Kind::Nano33, recordings::rows(&recording));
        hops += compare(&blob(), &session, &window);
        events += session.heard.states.last().map_or(0, |s| usize::from(s.events));
        errors.extend(these);
    }
    println!("{wearers} simulated wearers, {hops} hops, {events} events: board equals laptop");
    say("simulated wearers", &mut errors);
    assert!(events >= 5 * wearers as usize, "{events} events of {} gestures", 6 * wearers);
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
        a_minute(Kind::Nano33, ratio);
    }
}

#[test]
fn a_rev2_board_takes_6000_samples_a_minute_whatever_its_sensors_clock() {
    for ratio in [0.96, 1.04] {
        a_minute(Kind::Nano33Rev2, ratio);
    }
}

#[test]
fn a_xiao_takes_6000_samples_a_minute_whatever_its_sensors_clock() {
    for ratio in [0.96, 1.04] {
        a_minute(Kind::Xiao, ratio);
    }
}

fn a_minute(kind: Kind, ratio: f64) {
    let (session, window) = run(kind, Box::new(Swing), ratio, 63);
    let from = window.at.iter().position(|&at| at >= 2 * HZ).unwrap();
    let minute = window.at[from..].iter().filter(|&&at| at < 62 * HZ).count();
    let status = session.heard.statuses.last().unwrap();
    // The true motion is the motion at the grid time minus the specified delay.
    let scale = SCALE;
    let mut worst = [0.0f64; 2];
    let first = (f64::from(window.times_ms[from]) / 10.0).round() as u64;
    for (k, counts) in (first..).zip(&window.counts[from..]) {
        let grid = (k * 32768 / 100) as f64 / 32768.0;
        // The board's clock starts some milliseconds after power-up; the first sample determines the offset.
        let truth = Swing.at(grid + offset(&session) - DELAY_PERIODS / sensor_hz(kind));
        for axis in 0..6 {
            let unit = f64::from(scale[axis / 3]);
            let error = (f64::from(counts[axis]) * unit - truth[axis]).abs() / unit;
            worst[axis / 3] = worst[axis / 3].max(error);
        }
    }
    println!(
        "{kind:?}, sensor clock x{ratio}: {minute} samples in 60 s, {} dropped after start; worst error {:.1} counts of \
         the accelerometer, {:.1} of the gyroscope",
        status.dropped_samples - session.heard.statuses[1].dropped_samples,
        worst[0],
        worst[1]
    );
    assert!((5999..=6001).contains(&minute));
    assert!(window.times_ms.windows(2).all(|w| (9..=11).contains(&(w[1] - w[0]))));
    // The maximum error of the time of a set on the grid.
    // At these ratios, 200 and 208 Hz are 25/12, 13/6 and exactly 2 times 100 Hz.
    // Polls then occur at only a few phases of the sensor's period, or even at a single phase.
    // Within that interval, the age of a set remains uncertain, equally for all samples, until the clocks drift.
    let period_ms = if kind == Kind::Nano33 { 0.0 } else { ratio * 1000.0 / sensor_hz(kind) };
    let timing_ms = TIMING_MS + period_ms;
    // Slopes are up to 61 m/s^3 and 2,100 deg/s^2, converted to counts per ms. Rounding adds one count.
    let allowed = [51.0, 30.0].map(|slope| 1.0 + slope * timing_ms);
    assert!(worst[0] <= allowed[0] && worst[1] <= allowed[1], "{worst:?} of {allowed:?}");
}

/// Seconds from power-up to the start of the board's clock.
fn offset(session: &RightRig) -> f64 {
    session.board.clock_start() as f64 / HZ as f64
}

/// Tests models that replace the bundled model over the wire.
#[test]
fn received_models_of_every_recipe_compute_what_the_laptop_computes() {
    let mut script = Vec::new();
    for gesture in synth::Motion::GESTURES {
        script.push(Segment::new(gesture, 2.0));
        script.push(Segment::new(synth::Motion::IDLE, 1.0));
    }
    let rows = recordings::rows(&synth::session(&synth::Wearer::evaluation(22, 1), 0, &script));
    // Searches for random weights with which the model recognises a gesture.
    let names_something = |blob: &Vec<u8>| {
        let model = Model::parse(blob).unwrap();
        let mut hand = RightHand::<9>::new(model, DecisionConfig::default()).unwrap();
        rows.iter().enumerate().for_each(|(n, row)| {
            hand.push(&row.map(|v| v as f32), 10 * n as u32);
        });
        hand.output().events >= 3
    };
    let paper: &[usize] = &[20, 10, 5];
    for (recipe, hidden) in [
        (FeatureKind::Aligned, &models::ALIGNED_HIDDEN[..]),
        (FeatureKind::LogPower, paper),
        (FeatureKind::Raw, paper),
    ] {
        let blob = (1..)
            .map(|seed| random_model(recipe, hidden, seed))
            .find(names_something)
            .expect("such weights are not rare");
        let mut session = RightRig::uart(Box::new(Still));
        session.run_ms(500);
        session.board.soc().bus.sensor.set_clock_ratio(CLOCK_RATIO);
        let tap = session.board.tap("bimanual_sample", 18);
        install(&mut session, &blob);
        let start = session.board.seconds();
        let seconds = rows.len() as u64 / 100;
        let replay = Replay { rows: rows.clone(), interval: 0.01, start };
        session.board.soc().bus.sensor.set_motion(Box::new(replay));
        // The first of these hops started before the replay.
        let memory = watch(&mut session, tap, seconds + 1);

        let mut window = window_of(session.board.tapped(tap));
        // The comparison starts at the restart, because the board's clock was reset there.
        let first = window.times_ms.windows(2).rposition(|w| w[1] < w[0]).map_or(0, |n| n + 1);
        window.times_ms.drain(..first);
        window.counts.drain(..first);
        window.memory = memory.into_iter().map(|(count, bytes)| (count - first, bytes)).collect();
        let states = &mut session.heard.states;
        let began = |w: &[Right]| w[1].board_time_ms < w[0].board_time_ms;
        let first = states.windows(2).rposition(began).map_or(0, |n| n + 1);
        states.drain(..first);
        let hops = compare(&blob, &session, &window);
        let events = session.heard.states.last().map_or(0, |s| s.events);
        let mut scores: Vec<_> = session.heard.states.iter().map(|s| &s.scores).collect();
        scores.sort();
        scores.dedup();
        println!("{recipe:?}: {hops} hops, {} different scores, {events} events: equal", scores.len());
        assert!(hops as u64 >= seconds * 12 && scores.len() > 50 && events > 0);
    }
}
