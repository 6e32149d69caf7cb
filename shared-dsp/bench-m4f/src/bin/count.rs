//! Prints the number of executed instructions, the stack use and the checksums.
#![no_std]
#![no_main]

#[path = "../checks.rs"]
mod checks;

use bench_m4f::{Host, bytes, calibration, count, exit, stack_of, start_timer};
use core::fmt::Write;
use core::hint::black_box;
use shared_dsp::right::features::FeatureWindow;
use shared_dsp::right::network::Model;

static mut WINDOW: FeatureWindow<9> = FeatureWindow::new();

/// Entry.
#[unsafe(no_mangle)]
pub extern "C" fn main() {
    start_timer();
    let (raw, log) = (bytes!("raw.blob"), bytes!("log.blob"));
    let (inputs, windows) = (bytes!("inputs.bin"), bytes!("windows.bin"));
    let _ = writeln!(Host, "calibration_expected_2001={}", calibration());

    let model = Model::parse(raw).unwrap();
    let input: [i8; 117] = core::array::from_fn(|i| inputs[i] as i8);
    let mut scores = [0i8; 7];
    let instructions = count(|| {
        let _ = black_box(&model).infer(black_box(&input), black_box(&mut scores));
    });
    let _ = writeln!(Host, "infer_instructions={instructions}");
    let stack = stack_of(|| {
        let _ = black_box(&model).infer(black_box(&input), black_box(&mut scores));
    });
    let _ = writeln!(Host, "infer_stack_bytes={stack}");
    let parse = count(|| {
        let _ = black_box(Model::parse(black_box(raw)));
    });
    let _ = writeln!(Host, "parse_instructions={parse}");

    // SAFETY: this is the only reference to the static.
    let window = unsafe { &mut *core::ptr::addr_of_mut!(WINDOW) };
    let (mut worst, mut best, mut total, mut hops) = (0, u32::MAX, 0u64, 0u64);
    // The window has 25 places for blocks and 24 for frames.
    // This number of hops covers every combination of a block's place and a frame's place.
    for hop in 0..25 + 24 * 25 {
        let samples: [[f32; 9]; 8] = core::array::from_fn(|i| checks::sample(windows, 8 * hop + i));
        let window = black_box(&mut *window);
        let samples = black_box(&samples);
        let instructions = count(|| {
            for sample in samples {
                window.push(sample);
            }
        });
        if hop >= 25 {
            worst = worst.max(instructions);
            best = best.min(instructions);
            total += u64::from(instructions);
            hops += 1;
        }
    }
    let _ = writeln!(Host, "features_hop_worst_instructions={worst}");
    let _ = writeln!(Host, "features_hop_best_instructions={best}");
    let _ = writeln!(Host, "features_hop_mean_instructions={}", total / hops);
    // All inputs are NaN, so all axes take the slow path, in a hop in which the window also turns.
    let samples = [[f32::NAN; 9]; 8];
    let mut worst = 0;
    for _ in 0..25 {
        let window = black_box(&mut *window);
        let samples = black_box(&samples);
        worst = worst.max(count(|| {
            for sample in samples {
                window.push(sample);
            }
        }));
    }
    let _ = writeln!(Host, "features_hop_of_nan_worst_instructions={worst}");
    let sample = checks::sample(windows, 0);
    let stack = stack_of(|| {
        for _ in 0..25 * 24 * 8 {
            black_box(&mut *window).push(black_box(&sample));
        }
    });
    let _ = writeln!(Host, "features_stack_bytes={stack}");
    let _ = writeln!(Host, "features_state_bytes={}", core::mem::size_of::<FeatureWindow<9>>());

    let features = *window.features();
    for (name, blob) in [("raw", raw), ("log", log)] {
        let model = Model::parse(blob).unwrap();
        let mut quantised = [0i8; 117];
        let quantise = count(|| {
            let _ = black_box(&model).quantise(black_box(&features), black_box(&mut quantised));
        });
        let classify = count(|| {
            let _ = black_box(&model).classify(black_box(&features), black_box(&mut scores));
        });
        let stack = stack_of(|| {
            let _ = black_box(&model).classify(black_box(&features), black_box(&mut scores));
        });
        let _ = writeln!(Host, "quantise_{name}_instructions={quantise}");
        let _ = writeln!(Host, "classify_{name}_instructions={classify}");
        let _ = writeln!(Host, "classify_{name}_stack_bytes={stack}");
        let (of_features, of_scores) = checks::of_features(blob, windows);
        let _ = writeln!(Host, "crc_{name}_features={of_features:08x}");
        let _ = writeln!(Host, "crc_{name}_scores={of_scores:08x}");
    }
    let _ = writeln!(Host, "crc_network={:08x}", checks::of_network(raw, inputs));
    let rows = bytes!("rows.blob");
    let _ = writeln!(Host, "crc_rows={:08x}", checks::of_network(rows, inputs));
    let _ = writeln!(Host, "crc_rows_unaligned={:08x}", checks::of_unaligned_network(rows, inputs));
    if let Ok(model) = Model::parse(rows) {
        let instructions = count(|| {
            let _ = black_box(&model).infer(black_box(&input), black_box(&mut scores));
        });
        let _ = writeln!(Host, "infer_rows_instructions={instructions}");
    }
    let _ = writeln!(Host, "crc_network_unaligned={:08x}", checks::of_unaligned_network(raw, inputs));
    let _ = writeln!(Host, "blob_bytes={}", raw.len());
    exit();
}
