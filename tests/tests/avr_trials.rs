//! Runs the left hand's trials on the emulated Nano: the paper's 400 tilts, tremor, and 2,000 bends.
#![cfg(feature = "avr")]

use tests::avr::trials::{BendCounts, DIRECTIONS, Job, Parts, Quiet, Tilts};
use tests::avr::workers::run;
use tests::is_full;

const WORKER: &str = env!("CARGO_BIN_EXE_avr_trials");

fn jobs(parts: Parts, seeds: std::ops::Range<u64>, count: u32) -> Vec<Job> {
    seeds.map(|seed| Job { seed, parts, count }).collect()
}

/// 20 wearers perform 400 trials (100 per direction, 5 per wearer and direction). In the short run there are 2 wearers.
#[test]
fn the_papers_400_tilts_are_right_and_none_is_reversed() {
    let wearers = if is_full() { 20 } else { 2 };
    let results: Vec<Tilts> = run(WORKER, "tilts", &jobs(Parts::Drawn, 1000..1000 + wearers, 5));
    let sum = |of: fn(&Tilts) -> u32| results.iter().map(of).sum::<u32>();
    let (trials, right, reversed) = (sum(|t| t.trials), sum(|t| t.right), sum(|t| t.reversed));
    let mut latencies: Vec<f64> =
        results.iter().flat_map(|t| &t.by_direction).flat_map(|d| d.latencies_ms.clone()).collect();
    latencies.sort_by(f64::total_cmp);
    println!("{wearers} wearers, parts from the whole data-sheet tolerance, neutral within 10° of level");
    println!(
        "paper: correct tilts, of {trials} | 93.5 % of 400 | {:.2} %",
        100.0 * f64::from(right) / f64::from(trials)
    );
    println!("paper: tilts mistaken for the opposite | not stated | {reversed}");
    if let (Some(worst), Some(median)) = (latencies.last(), latencies.get(latencies.len() / 2)) {
        println!(
            "paper: time from the start of a tilt until its command, median and maximum | not stated | {median:.0} and {worst:.0} ms"
        );
    }
    for (place, direction) in DIRECTIONS.into_iter().enumerate() {
        let of_it = || results.iter().map(|t| &t.by_direction[place]);
        let first: [u32; 5] = std::array::from_fn(|seen| of_it().map(|d| d.first[seen]).sum());
        let mut latencies: Vec<f64> = of_it().flat_map(|d| d.latencies_ms.clone()).collect();
        latencies.sort_by(f64::total_cmp);
        let name = format!("{direction:?}").to_lowercase();
        let right = format!("{} of {}", latencies.len(), first.iter().sum::<u32>());
        let median = latencies.get(latencies.len() / 2).copied().unwrap_or(f64::NAN);
        println!("paper: tilts {name}: correct, median response | not compared | {right}, {median:.0} ms");
        println!("figure: tilts | {name} | {}", first.map(|count| count.to_string()).join(" | "));
    }
    results.iter().flat_map(|t| &t.notes).for_each(|note| println!("  wrong: {note}"));
    assert_eq!(u64::from(trials), 20 * wearers);
    assert!(f64::from(right) >= 0.995 * f64::from(trials), "{right} of {trials}");
    assert_eq!(reversed, 0);
}

/// The tremor lasts 10 minutes in total, half of it with wearers whose components make each tilt appear largest.
#[test]
fn tremor_of_11_degrees_never_commands() {
    let (wearers, seconds) = if is_full() { (3, 100) } else { (1, 10) };
    let mut all = jobs(Parts::Drawn, 2000..2000 + wearers, seconds);
    all.extend(jobs(Parts::Loudest, 2100..2100 + wearers, seconds));
    let results: Vec<Quiet> = run(WORKER, "tremor", &all);
    let states: u32 = results.iter().map(|q| q.states).sum();
    let commands: u32 = results.iter().map(|q| q.commands).sum();
    println!(
        "{} s of tremor up to 11°: {states} healthy states, {commands} with a command",
        all.len() as u32 * seconds
    );
    assert!(states >= all.len() as u32 * seconds * 49, "the hand was watched all the time: {states} states");
    assert_eq!(commands, 0);
}

#[test]
fn bends_count_once_whatever_their_depth_and_speed() {
    let (wearers, each) = if is_full() { (10, 100) } else { (2, 12) };
    let results: Vec<BendCounts> = run(WORKER, "bends", &jobs(Parts::Drawn, 3000..3000 + wearers, each));
    println!("{:<8}{:>8}{:>14}{:>14}", "finger", "bends", "counted once", "paper");
    let mut total = 0;
    for (finger, name, paper) in [(0, "index", "98 %"), (1, "middle", "95 %")] {
        let bends: u32 = results.iter().map(|r| r.bends[finger]).sum();
        let once: u32 = results.iter().map(|r| r.once[finger]).sum();
        println!("{name:<8}{bends:>8}{:>13.2}%{paper:>14}", 100.0 * f64::from(once) / f64::from(bends));
        println!(
            "paper: bends of the {name} finger, of {bends}: counted once | {paper} | {:.2} %",
            100.0 * f64::from(once) / f64::from(bends)
        );
        total += bends;
        assert!(f64::from(once) >= 0.995 * f64::from(bends), "{name}: {once} of {bends}");
    }
    let excess: u32 = results.iter().map(|r| r.excess).sum();
    let stops: u32 = results.iter().map(|r| r.stops).sum();
    println!("false counts {excess} (paper: under 2 %), stop flags {stops}");
    println!("paper: bends: false counts | under 2 % | {excess} of {total}");
    assert!(f64::from(excess) <= 0.001 * f64::from(total), "{excess} of {total}");
    assert_eq!(stops, 0);
}

#[test]
fn a_hand_that_only_tilts_bends_nothing() {
    let (wearers, seconds) = if is_full() { (6, 60) } else { (2, 8) };
    let results: Vec<Quiet> = run(WORKER, "tilting", &jobs(Parts::Drawn, 4000..4000 + wearers, seconds));
    let commands: u32 = results.iter().map(|q| q.commands).sum();
    let bends: u32 = results.iter().map(|q| q.bends).sum();
    println!("{} s of tilting: {commands} states with a command, {bends} bends", wearers as u32 * seconds);
    assert!(commands > 100, "the hand did tilt");
    assert_eq!(bends, 0);
}
