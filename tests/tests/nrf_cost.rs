//! What a gesture costs on the board: instructions, time awake and memory, beside the paper and its peers.
#![cfg(feature = "nrf")]

use tests::nrf::lsm9ds1::Motion;
use tests::nrf::session::Session;

/// A hand that never rests.
struct Wild;

impl Motion for Wild {
    fn at(&self, t: f64) -> [f64; 9] {
        let wave = |hz: f64| (std::f64::consts::TAU * hz * t).sin();
        std::array::from_fn(|i| {
            [8.0, 8.0, 9.8, 300.0, 200.0, 100.0, 30.0, 20.0, 40.0][i] * wave(0.7 + 0.9 * i as f64)
        })
    }
}

fn median(mut values: Vec<u64>) -> u64 {
    values.sort_unstable();
    values[values.len() / 2]
}

#[test]
fn instructions_per_hop_and_inference_and_the_time_awake_are_within_their_aims() {
    let mut session = Session::uart(Box::new(Wild));
    let sample = session.board.probe("bimanual_sample");
    let mut probe = |words: &[&str]| -> Vec<usize> {
        let names = session.board.image().functions_with(words);
        names.iter().map(|name| session.board.probe(name)).collect()
    };
    let forward = probe(&["shared_dsp", "mlp", "Model", "7forward"]);
    let inputs_and_forward = probe(&["shared_dsp", "mlp", "Model", "with_scratch"]);
    let softmax = probe(&["shared_dsp", "softmax", "7softmax"]);
    let features = probe(&["shared_dsp", "features", "finish_hop"]);
    session.run_ms(4000);
    let (now, awake) = (session.board.now(), session.board.awake());
    session.run_ms(20_000);
    let share = (session.board.awake() - awake) as f64 / (session.board.now() - now) as f64;

    // A hop is eight samples; the first full windows come after two seconds.
    let calls: Vec<u64> = session.board.calls(sample).iter().map(|c| c.instructions).collect();
    let calls = &calls[calls.len() % 8..];
    let hops: Vec<u64> = calls.chunks_exact(8).skip(40).map(|c| c.iter().sum()).collect();
    let worst_sample = *calls[320..].iter().max().unwrap();
    // Medians: each of these does the same work at every hop.
    let typical = |probes: &[usize]| {
        median(probes.iter().flat_map(|&p| session.board.calls(p)).map(|c| c.instructions).collect())
    };
    let network = typical(&forward) + typical(&softmax);
    let classify = typical(&inputs_and_forward) + typical(&softmax);
    let features: Vec<u64> =
        features.iter().flat_map(|&p| session.board.calls(p)).skip(40).map(|c| c.instructions).collect();
    let load = session.board_load();
    println!(
        "per hop (80 ms), all       {:>7} instructions median, {} worst",
        median(hops.clone()),
        hops.iter().max().unwrap()
    );
    println!(
        "  features                 {:>7} median, {} worst (aim 6,000; best peer 66,643 per window)",
        median(features.clone()),
        features.iter().max().unwrap()
    );
    println!("  features to int8         {:>7} median", classify - network);
    println!(
        "  inference with softmax   {network:>7} median (aim 5,500; best peer 11,713; the paper 64,000 cycles)"
    );
    println!("worst single sample        {worst_sample:>7} instructions");
    println!(
        "awake                      {:>6.2} % (aim 5 %; 1.5 cycles per instruction); the board says {load} per mille",
        share * 100.0
    );
    // nRF52840 product specification: 52 uA/MHz from flash at 3 V with the converter; 3.16 uA asleep with RAM and RTC.
    println!(
        "processor current implied  {:>6.2} mA x share + sleep = {:.0} uA (the sensor draws 4.6 mA more)",
        0.052 * 64.0,
        share * 0.052 * 64.0 * 1000.0 + 3.16
    );
    assert!(network <= 5_500, "inference: {network} instructions");
    assert!(*features.iter().max().unwrap() <= 6_000, "features of a hop");
    assert!(share <= 0.05, "awake {share}");
    assert!(
        (f64::from(load) / 1000.0 - share).abs() < 0.01,
        "the board's own figure differs: {load} per mille"
    );
}
