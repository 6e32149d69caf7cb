//! Prints the instructions and the memory of features, network and decision of recipe `aligned`.
//! The networks have several sizes.
#![no_std]
#![no_main]

#[path = "../checks.rs"]
#[allow(dead_code)] // only the samples are needed
mod checks;

use bench_m4f::{Host, bytes, count, exit, stack_of, start_timer};
use core::fmt::Write;
use core::hint::black_box;
use shared_dsp::right::aligned::AlignedWindow;
use shared_dsp::right::movement::{MovementConfig, MovementDecision};
use shared_dsp::right::network::Model;

/// Hops until the window is full, and hops that are measured after that.
const HOPS: (usize, usize) = (25, 200);

/// What a board keeps between samples, beside the model, which is in flash.
struct State {
    window: AlignedWindow<9>,
    decision: MovementDecision,
}

impl State {
    /// Adds the samples of a hop and decides.
    fn hop(&mut self, model: &Model<'_>, samples: &[[f32; 9]; 8]) {
        for sample in samples {
            if self.window.push(sample) {
                let mut scores = [0i8; 8];
                let _ = model.classify_features(self.window.features(), &mut scores);
                black_box(self.decision.step(&scores, None, self.window.movement()));
            }
        }
    }
}

fn measure(name: &str, blob: &'static [u8], windows: &[u8]) {
    let model = Model::parse(blob).unwrap();
    let decision = MovementDecision::new(model.info().labels(), MovementConfig::for_axes(9));
    let mut state = State { window: AlignedWindow::new(), decision };
    let hop_of = |hop: usize| core::array::from_fn(|n| checks::sample(windows, 8 * hop + n));
    let (mut worst, mut total) = (0, 0u64);
    for hop in 0..HOPS.0 + HOPS.1 {
        let samples = hop_of(hop);
        let instructions = count(|| black_box(&mut state).hop(black_box(&model), black_box(&samples)));
        if hop >= HOPS.0 {
            worst = worst.max(instructions);
            total += u64::from(instructions);
        }
    }
    let mut scores = [0i8; 8];
    let network = count(|| {
        let _ =
            black_box(&model).classify_features(black_box(state.window.features()), black_box(&mut scores));
    });
    let samples = hop_of(0);
    let stack = stack_of(|| black_box(&mut state).hop(black_box(&model), black_box(&samples)));
    let _ = writeln!(
        Host,
        "{name}: blob {} B; scaling, network and softmax {network} instructions; whole hop: mean {}, worst {worst} instructions; \
         RAM: {} B of state + {stack} B of stack",
        blob.len(),
        total / HOPS.1 as u64,
        size_of::<State>()
    );
}

/// Entry.
#[unsafe(no_mangle)]
pub extern "C" fn main() {
    start_timer();
    let windows = bytes!("windows.bin");
    measure("89-20-10-8", bytes!("20-10.blob"), windows);
    measure("89-40-20-8", bytes!("40-20.blob"), windows);
    measure("89-60-30-8", bytes!("60-30.blob"), windows);
    measure("89-80-40-8", bytes!("80-40.blob"), windows);
    exit();
}
