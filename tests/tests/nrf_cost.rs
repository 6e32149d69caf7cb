//! Measures the cost of recognition on the board: instructions, time awake and memory.
//! Compares these results with those of the paper and of other implementations.
#![cfg(feature = "nrf")]

use shared_dsp::right::aligned::AlignedWindow;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::MAX_LABELS;
use tests::nrf::board::Kind;
use tests::nrf::build::Variant;
use tests::nrf::image::Image;
use tests::nrf::left_hand::set_flex;
use tests::nrf::lsm9ds1::{Motion, Still};
use tests::nrf::session::RightRig;
use tests::nrf::transfer::{install, random_model};

/// The motion of a hand that never rests.
struct Wild;

impl Motion for Wild {
    fn at(&self, t: f64) -> [f64; 9] {
        let wave = |hz: f64| (std::f64::consts::TAU * hz * t).sin();
        std::array::from_fn(|i| {
            [8.0, 8.0, 9.8, 300.0, 200.0, 100.0, 30.0, 20.0, 40.0][i] * wave(0.7 + 0.9 * i as f64)
        })
    }
}

/// Medians and maxima of executed instructions, each for one hop.
struct Cost {
    hop: (u64, u64),
    features: (u64, u64),
    /// Number of instructions of the layers and the softmax.
    network: u64,
    /// Number of instructions for scaling the features to int8. In recipe 2 this includes a logarithm of some features.
    to_int8: u64,
    worst_sample: u64,
    /// Stack depth of the network in bytes.
    stack: u64,
    awake_share: f64,
}

fn median_and_worst(mut values: Vec<u64>) -> (u64, u64) {
    values.sort_unstable();
    (values[values.len() / 2], values[values.len() - 1])
}

/// Measures twenty seconds of a running board.
fn measure(session: &mut RightRig, window: &str) -> Cost {
    let sample = session.board.probe("bimanual_sample");
    let names = |words: &[&str]| session.board.image().functions_with(words);
    let forward = names(&["shared_dsp", "network", "Model", "7forward"]);
    let inputs_and_forward = names(&["shared_dsp", "network", "Model", "with_scratch"]);
    let softmax = names(&["shared_dsp", "softmax", "7softmax"]);
    let features = names(&["shared_dsp", window, "finish_hop"]);
    let mut probe = |names: &[String], stack: bool| -> Vec<usize> {
        let board = &mut session.board;
        names.iter().map(|name| if stack { board.probe_stack(name) } else { board.probe(name) }).collect()
    };
    // Before the layers, the stack is filled with a pattern again.
    // As in the other measurements, the calculation of the inputs therefore does not count.
    let forward = probe(&forward, true);
    let inputs_and_forward = probe(&inputs_and_forward, true);
    let softmax = probe(&softmax, true);
    let features = probe(&features, false);
    session.run_ms(4000);
    let (now, awake) = (session.board.now(), session.board.awake());
    session.run_ms(20_000);
    let awake_share = (session.board.awake() - awake) as f64 / (session.board.now() - now) as f64;

    let calls = |probes: &[usize]| probes.iter().flat_map(|&p| session.board.calls(p)).collect::<Vec<_>>();
    // A hop is eight samples, and the first full window is available after two seconds.
    let samples: Vec<u64> = calls(&[sample]).iter().map(|c| c.instructions).collect();
    let samples = &samples[samples.len() % 8..];
    let hop = median_and_worst(samples.chunks_exact(8).skip(40).map(|c| c.iter().sum()).collect());
    let instructions =
        |probes: &[usize]| median_and_worst(calls(probes).iter().map(|c| c.instructions).collect());
    let stack = |probes: &[usize]| {
        median_and_worst(calls(probes).iter().map(|c| u64::from(c.stack_bytes)).collect()).0
    };
    let network = instructions(&forward).0 + instructions(&softmax).0;
    Cost {
        hop,
        features: median_and_worst(calls(&features).iter().skip(40).map(|c| c.instructions).collect()),
        network,
        to_int8: instructions(&inputs_and_forward).0 - instructions(&forward).0,
        worst_sample: *samples[320..].iter().max().expect("samples"),
        // The two functions run one after another, and the logits are above their frames on the stack.
        stack: stack(&inputs_and_forward).max(stack(&softmax)) + MAX_LABELS as u64,
        awake_share,
    }
}

fn say(cost: &Cost) {
    println!("per hop of 80 ms, all     {:>7} instructions median, {} worst", cost.hop.0, cost.hop.1);
    println!("  features                {:>7} median, {} worst", cost.features.0, cost.features.1);
    println!("  features to int8        {:>7}", cost.to_int8);
    println!("  network with softmax    {:>7}", cost.network);
    println!("worst single sample       {:>7}", cost.worst_sample);
    println!("stack of the network      {:>7} B", cost.stack);
}

/// Parts of the symbol names of the network's code.
const NETWORK: [&str; 3] = ["10shared_dsp5right7network", "10shared_dsp5right7softmax", "bimanual_layer"];

/// Returns the flash size, in bytes, of all symbols whose names contain one of these words.
fn flash_of(image: &Image, words: &[&str]) -> u32 {
    let is_ours = |name: &str| words.iter().any(|word| name.contains(word));
    let in_flash = |name: &str| image.symbols[name] < 0x2000_0000;
    image.sizes.iter().filter(|(name, _)| is_ours(name) && in_flash(name)).map(|(_, size)| size).sum()
}

/// Checks that the time awake meets its target and agrees with the board's own report.
fn check_time_awake(cost: &Cost, load_permille: u16) {
    println!(
        "awake                     {:>6.2} % (aim 5 %; 1.5 cycles per instruction); the board says {load_permille} per mille",
        cost.awake_share * 100.0
    );
    // According to the nRF52840 product specification, the processor draws 52 uA/MHz awake.
    // This value is for code in flash at 3 V with the DC/DC converter.
    // Asleep with RAM and RTC, the processor draws 3.16 uA.
    println!(
        "processor current implied {:>6.2} mA x share + sleep = {:.0} uA (the sensor draws 4.6 mA more)",
        0.052 * 64.0,
        cost.awake_share * 0.052 * 64.0 * 1000.0 + 3.16
    );
    assert!(cost.awake_share <= 0.05, "awake {}", cost.awake_share);
    assert!(
        (f64::from(load_permille) / 1000.0 - cost.awake_share).abs() < 0.01,
        "the board's own figure differs: {load_permille} per mille"
    );
}

#[test]
fn a_network_of_the_papers_shape_is_within_the_aims_of_its_peers() {
    let mut session = RightRig::uart(Box::new(Wild));
    session.run_ms(500);
    // The weights are random, because only the shape matters.
    let blob = random_model(FeatureKind::LogPower, &[20, 10, 5], 7);
    install(&mut session, &blob);
    let cost = measure(&mut session, "features");
    println!("received model: recipe log-power, 117 features of nine axes, 117-20-10-5-7");
    say(&cost);
    check_time_awake(&cost, session.board_load());
    let code = flash_of(session.board.image(), &NETWORK);
    let scaling = 8 * 117;
    let flash = code + blob.len() as u32;
    // The results of other implementations and of the paper are from ../shared/reference/peers.md.
    // The results apply to the network with softmax, calculated from int8 inputs.
    println!();
    println!("{:<40}{:>14}{:>10}{:>8}", "inference with softmax", "instructions", "flash B", "RAM B");
    println!("{:<40}{:>14}{:>10}{:>8}", "this board", cost.network, flash - scaling, cost.stack);
    println!("{:<40}{:>14}{:>10}{:>8}", "aim", 5500, 5900, 400);
    println!("{:<40}{:>14}{:>10}{:>8}", "CMSIS-NN -O3", 11_713, 11_132, 444);
    println!("{:<40}{:>14}{:>10}{:>8}", "CMSIS-NN -Os", 13_728, 8256, 440);
    println!("{:<40}{:>14}{:>10}{:>8}", "TFLite Micro with CMSIS-NN", 13_087, 38_892, 2596);
    println!("{:<40}{:>14}{:>10}{:>8}", "Edge Impulse EON, network alone", 15_666, 18_864, 2369);
    println!("{:<40}{:>14}{:>10}{:>8}", "microflow (Rust)", 70_491, 5900, 692);
    println!("{:<40}{:>14}{:>10}{:>8}", "the paper (1 ms, 17.9 KB, 1.7 KB)", "64000 cycles", 17_900, 1700);
    println!(
        "paper: the paper's network on the board: inference | 1 ms (64,000 cycles) | {} instructions",
        cost.network
    );
    println!(
        "paper: the paper's network on the board: flash | 17.9 KB | {:.1} KB",
        f64::from(flash) / 1000.0
    );
    println!("paper: the paper's network on the board: RAM | 1.7 KB | {:.2} KB", cost.stack as f64 / 1000.0);
    println!(
        "paper: the paper's features and network: share of time awake | not stated | {:.2} %",
        100.0 * cost.awake_share
    );
    println!("flash: without {scaling} of feature scaling, which peers do not have; with it {flash}");
    println!("{:<40}{:>14}", "features of a hop, worst", cost.features.1);
    println!("{:<40}{:>14}  (best peer: 66643 for a window)", "aim", 6000);
    assert!(cost.network <= 5_500, "inference: {} instructions", cost.network);
    assert!(cost.features.1 <= 6_000, "features of a hop");
    // The target is 400 B, and one scale per channel adds 4 B.
    assert!(cost.stack <= 408, "stack of the network: {} B", cost.stack);
}

#[test]
fn the_bundled_network_stays_within_the_papers_memory_and_40_000_instructions_per_inference() {
    let mut session = RightRig::uart(Box::new(Wild));
    let cost = measure(&mut session, "aligned");
    let [first, second] = models::ALIGNED_HIDDEN;
    println!("bundled model: recipe aligned, 89 features of nine axes, 89-{first}-{second}-8");
    say(&cost);
    check_time_awake(&cost, session.board_load());
    let image = session.board.image();
    let code = flash_of(image, &NETWORK);
    let (flash, window) = (code + flash_of(image, &["5model7BUNDLED"]), size_of::<AlignedWindow<9>>());
    let features = flash_of(image, &["10shared_dsp5right7aligned"]);
    println!("{:<40}{:>14}{:>10}{:>8}", "inference", "instructions", "flash B", "RAM B");
    println!("{:<40}{:>14}{:>10}{:>8}", "network with softmax", cost.network, flash, cost.stack);
    println!("{:<40}{:>14}{:>10}{:>8}", "features, and their window", cost.features.1, features, window);
    println!("{:<40}{:>14}", "all of a hop, worst", cost.hop.1);
    println!("{:<40}{:>14}{:>10}{:>8}", "the paper's network (1 ms)", "64000 cycles", 17_900, 1700);
    assert!(cost.hop.1 <= 40_000, "features, network and decision: {} instructions", cost.hop.1);
    assert!(cost.stack <= 1700, "stack of the network: {} B", cost.stack);
    assert!(flash <= 17_900, "network and its weights: {flash} B");
}

/// Current in mA of each sensor as the images configure it, from its data sheet.
/// The LSM9DS1 draws 4.0 mA for the gyroscope and 0.6 mA for accelerometer and magnetometer.
/// The BMI270 is in performance mode, and the LSM6DS3TR-C is in high-performance mode.
const SENSORS_MA: [(Kind, f64); 3] = [(Kind::Nano33, 4.6), (Kind::Nano33Rev2, 0.97), (Kind::Xiao, 0.9)];
/// Current of the nRF52840 awake: 52 uA/MHz, for code in flash at 3 V with the DC/DC converter.
/// The next value is the current asleep, with RAM and clock.
const AWAKE_MA: f64 = 0.052 * 64.0;
const ASLEEP_MA: f64 = 0.003_16;

/// Shares of the time: awake in total, classification (window, features, network, decision), and S140.
struct Awake {
    all: f64,
    naming: f64,
    s140: f64,
}

fn awake(kind: Kind, motion: Box<dyn Motion>) -> Awake {
    let mut session = RightRig::ble_of_kind(kind, motion);
    let sample = session.board.probe("bimanual_sample");
    session.run_ms(6000);
    let (now, awake, s140) =
        (session.board.now(), session.board.awake(), session.board.softdevice().own_cycles);
    let calls = session.board.calls(sample).len();
    session.run_ms(8000);
    assert_eq!(session.heard.states.last().expect("states").health, 0, "{kind:?}: its window is full");
    let all_cycles = (session.board.now() - now) as f64;
    let instructions: u64 = session.board.calls(sample)[calls..].iter().map(|c| c.instructions).sum();
    Awake {
        all: (session.board.awake() - awake) as f64 / all_cycles,
        naming: 1.5 * instructions as f64 / all_cycles,
        s140: (session.board.softdevice().own_cycles - s140) as f64 / all_cycles,
    }
}

/// Calculates how much current the board would save if it paused the classifier at rest.
/// The saving is the classifier's share of the processor time.
/// The sensor must keep running, because the dead-man rule requires fresh samples.
/// In addition, the window of a gesture starts before the gesture is detected.
#[test]
fn over_bluetooth_a_resting_hand_costs_as_much_as_a_moving_one_and_naming_gestures_is_the_least_of_it() {
    println!(
        "over Bluetooth, without the radio's current; charge per hour is the mean current in mA, as mAh"
    );
    println!(
        "{:<12}{:<9}{:>8}{:>8}{:>7}{:>7}{:>8}{:>9}{:>10}{:>12}",
        "", "", "awake %", "naming", "S140", "rest", "sensor", "cpu", "per hour", "saved at most"
    );
    for (kind, sensor_ma) in SENSORS_MA {
        for (what, motion) in [("at rest", Box::new(Still) as Box<dyn Motion>), ("moving", Box::new(Wild))] {
            let Awake { all, naming, s140 } = awake(kind, motion);
            let cpu_ma = all * AWAKE_MA + ASLEEP_MA;
            let (mah, saved) = (cpu_ma + sensor_ma, naming * AWAKE_MA);
            println!(
                "{:<12}{what:<9}{:>8.2}{:>8.2}{:>7.2}{:>7.2}{sensor_ma:>8.2}{cpu_ma:>9.3}{mah:>6.2} mAh{:>10.1} %",
                format!("{kind:?}"),
                100.0 * all,
                100.0 * naming,
                100.0 * s140,
                100.0 * (all - naming - s140),
                100.0 * saved / mah
            );
            assert!(all <= 0.05, "{kind:?} {what}: awake {all}");
            // The test computes the maximum saving on the board with the lowest sensor current.
            assert!(saved / mah < 0.05, "{kind:?} {what}: now it is worth the trouble");
        }
    }
}

/// Cost of an image with Bluetooth while it is connected.
struct Whole {
    flash: u32,
    /// RAM of the statics in bytes, including S140's own RAM.
    statics: u32,
    /// The most stack that was in use since the start, in bytes.
    stack: u32,
    awake: f64,
    /// Share of the radio's library. It is a model of S140, and unknown where the library is linked in.
    library: Option<f64>,
}

/// Measures eight seconds of a connected board.
fn whole(mut session: RightRig, variant: Variant) -> Whole {
    session.run_ms(12_000);
    let s140 = |session: &mut RightRig| session.board.softdevice().own_cycles;
    let has_s140 = variant == Variant::Ble;
    let before = if has_s140 { s140(&mut session) } else { 0 };
    let (now, awake) = (session.board.now(), session.board.awake());
    session.run_ms(8000);
    let all = (session.board.now() - now) as f64;
    let image = session.board.image();
    let (bottom, top) = (image.symbols["__sheap"], image.symbols["_stack_start"]);
    let free = session.heard.statuses.last().expect("a status").free_stack_bytes;
    Whole {
        flash: image.flash_bytes,
        statics: bottom - 0x2000_0000,
        stack: top - bottom - free,
        awake: (session.board.awake() - awake) as f64 / all,
        library: has_s140.then(|| (s140(&mut session) - before) as f64 / all),
    }
}

/// Compares the images that have Bluetooth linked in with the image for S140.
/// Each is connected at an interval of 15 ms. The right hands are at rest, and the left hand moves.
/// The emulator does not run Nordic's linked controller, so its share of the time awake is missing there.
#[test]
fn images_with_bluetooth_linked_in_take_at_most_256_kb_of_flash_and_64_kb_of_ram() {
    if !tests::has_linked_image() {
        return;
    }
    println!("charge per hour is the mean current in mA, as mAh, without the radio's current");
    println!(
        "{:<12}{:>9}{:>9}{:>8}{:>9}{:>9}{:>8}{:>9}{:>10}",
        "", "flash B", "RAM B", "stack B", "awake %", "library", "sensor", "cpu", "per hour"
    );
    let joined = |mut rig: RightRig| {
        set_flex(&mut rig.board, [5600.0; 2]);
        rig.run_ms(700);
        rig.join(15.0);
        rig
    };
    for (name, variant, sensor_ma) in [
        ("ble", Variant::Ble, 4.6),
        ("trouble", Variant::Trouble, 4.6),
        ("xiao-left", Variant::XiaoLeft, 0.9),
    ] {
        let session = match variant {
            Variant::Ble => RightRig::ble_of_kind(Kind::Nano33, Box::new(Still)),
            Variant::XiaoLeft => joined(RightRig::left_air(Box::new(Wild))),
            _ => joined(RightRig::air(Kind::Nano33, Box::new(Still))),
        };
        let Whole { flash, statics, stack, awake, library } = whole(session, variant);
        let cpu_ma = awake * AWAKE_MA + ASLEEP_MA;
        println!(
            "{name:<12}{flash:>9}{statics:>9}{stack:>8}{:>9.2}{:>9}{sensor_ma:>8.2}{cpu_ma:>9.3}{:>6.2} mAh",
            100.0 * awake,
            library.map_or("not run".to_owned(), |share| format!("{:.2}", 100.0 * share)),
            cpu_ma + sensor_ma
        );
        assert!(awake <= 0.05, "{name}: awake {awake}");
        if variant != Variant::Ble {
            assert!(flash <= 256 * 1024, "{name}: {flash} B of flash");
        }
        // S140 has RAM of its own.
        let most = if variant == Variant::Ble { 80 * 1024 } else { 64 * 1024 };
        assert!(statics + stack <= most, "{name}: {statics} and {stack} B of RAM");
    }
}
