//! Prints the checksums that the board is expected to print.

#[path = "../../src/checks.rs"]
mod checks;
#[path = "../../../tests/common/mod.rs"]
mod common;

use shared_dsp::right::network::build_blob;
use shared_dsp::right::kind::FeatureKind;

fn main() {
    let windows: Vec<u8> =
        common::rows::<f32>("windows.csv").concat().iter().flat_map(|x| x.to_le_bytes()).collect();
    let inputs: Vec<u8> = common::rows::<i8>("inputs_int8.csv").concat().iter().map(|&x| x as u8).collect();
    let mut spec = common::reference_spec();
    let raw = build_blob(&spec).expect("the reference network fits");
    spec.recipe = FeatureKind::LogPower;
    let log = build_blob(&spec).expect("the reference network fits");
    for (name, blob) in [("raw", &raw), ("log", &log)] {
        let (features, scores) = checks::of_features(blob, &windows);
        println!("crc_{name}_features={features:08x}");
        println!("crc_{name}_scores={scores:08x}");
    }
    println!("crc_network={:08x}", checks::of_network(&raw, &inputs));
    let rows = build_blob(&common::per_row_spec()).expect("the reference network fits");
    println!("crc_rows={:08x}", checks::of_network(&rows, &inputs));
    println!("crc_rows_unaligned={:08x}", checks::of_unaligned_network(&rows, &inputs));
    println!("crc_network_unaligned={:08x}", checks::of_unaligned_network(&raw, &inputs));
}
