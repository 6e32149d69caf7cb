//! Feeds damaged files to the readers of recordings and sessions.
//! The readers must not panic, hang for more than 2 s, or use more than 500 MB.
//!
//! `cargo test -p host-bridge --test fuzz` gives each reader a few hundred inputs.
//! The following command gives each reader a million inputs and prints statistics:
//! `BIMANUAL_FULL=1 cargo test --release -p host-bridge --features lerobot --test fuzz -- --nocapture --test-threads
//! 1`.

use std::path::Path;

use host_bridge::adc::AdcRecording;
use shared_dsp::left::AdcCounts;

#[path = "../../models/tests/common/mutate.rs"]
mod mutate;

#[cfg(feature = "mcap")]
#[path = "support/moving.rs"]
mod moving;

use mutate::{count, fuzz};

/// Returns a recording of a hand that tilts and bends, with this resolution in bits and this sample rate.
fn adc(rate_hz: f64, bits: u32, decimals: usize) -> Vec<u8> {
    let mut text = "timestamp_ms,x,y,z,index,middle\n".to_owned();
    for n in 0..120 {
        let t = f64::from(n) / rate_hz;
        let wave = 0.05 * (t * 3.0).sin();
        let full = f64::from(1u32 << bits);
        let row = [0.52 + wave, 0.485, 0.61, 0.673 - wave, 0.699].map(|part| {
            let eighths = (part * full * 8.0).round() / 8.0;
            if decimals == 0 { eighths.round().to_string() } else { eighths.to_string() }
        });
        text += &format!("{},{}\n", (t * 1000.0).round(), row.join(","));
    }
    text.into_bytes()
}

#[test]
fn damaged_recordings_of_the_left_hand_are_read_or_refused() {
    let seeds = [adc(100.0, 10, 0), adc(100.0, 10, 3), adc(50.0, 12, 0), adc(500.0, 8, 0), adc(104.0, 11, 0)];
    fuzz("ADC", &seeds, count(2000), |bytes| {
        let Ok(recording) = AdcRecording::parse(Path::new("a.csv"), bytes) else { return false };
        // Accepted recordings must have the board's order and range.
        assert!(recording.samples.windows(2).all(|pair| pair[0].0 <= pair[1].0));
        let in_range = |counts: AdcCounts| counts.as_array().iter().all(|sum| *sum <= AdcCounts::MAX);
        assert!(recording.samples.iter().all(|(_, counts)| in_range(*counts)));
        true
    });
}

#[cfg(feature = "mcap")]
mod session {
    use std::io::Cursor;
    use std::sync::{Arc, Mutex};

    use host_bridge::config::{Config, HandInput};
    use host_bridge::export::{Cut, Streams, episodes, frames};
    use host_bridge::journal::sink::Storage;
    use host_bridge::journal::{Disk, Setup, WhenFull, replay};
    use host_bridge::keyboard::HandKey;
    use host_bridge::topics::Origin;
    use mcap::records::Record;
    use mcap::{Compression, WriteOptions};

    use super::moving;
    use super::mutate::{count, fuzz};

    #[derive(Clone, Default)]
    struct Memory(Arc<Mutex<Vec<u8>>>);

    impl Storage for Memory {
        fn write_at(&mut self, at: u64, bytes: &[u8]) -> std::io::Result<()> {
            let mut disk = self.0.lock().unwrap();
            let end = (at as usize + bytes.len()).max(disk.len());
            disk.resize(end, 0);
            disk[at as usize..at as usize + bytes.len()].copy_from_slice(bytes);
            Ok(())
        }

        fn cut(&mut self, length: u64) -> std::io::Result<()> {
            self.0.lock().unwrap().resize(length as usize, 0);
            Ok(())
        }
    }

    /// Returns a short session of two keyboard hands with a marked episode and a stop.
    fn moment() -> Vec<u8> {
        let config = Config::default();
        let origin = Origin { nanoseconds: 1_700_000_000_123_456_789 };
        let setup = Setup { title: "a moment".to_owned(), origin_ns: origin.nanoseconds, ..Setup::default() };
        let memory = Memory::default();
        let (disk, recorder) = Disk::with_storage(
            memory.clone(),
            std::path::Path::new("a.mcap"),
            setup.to_metadata(),
            origin,
            WhenFull::Wait,
        )
        .unwrap();
        let mut live =
            moving::live_before(moving::bare(), &config, HandInput::Keyboard, HandInput::Keyboard, 0);
        for now_ms in (2..600).step_by(2) {
            live.advance(now_ms, [true; 2]);
        }
        live.tap_mut().add(Box::new(recorder));
        for now_ms in (600..700).step_by(4) {
            match now_ms {
                620 => live.press(HandKey::Gesture(2), now_ms),
                640 => live.mark(
                    host_bridge::episodes::Mark::Begin,
                    host_bridge::episodes::MarkedBy::Key,
                    now_ms,
                ),
                680 => live.stop_key(now_ms),
                _ => {}
            }
            live.advance(now_ms, [true; 2]);
        }
        live.tap_mut().clear();
        assert_eq!(disk.close().problem, None);
        let file = memory.0.lock().unwrap();
        file.clone()
    }

    /// Returns the same messages in a file with another program's compression.
    fn rewritten(file: &[u8], compression: Option<Compression>) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let mut writer =
            WriteOptions::new().profile("ros2").compression(compression).create(&mut bytes).unwrap();
        let mut channels = std::collections::HashMap::new();
        for record in mcap::read::ChunkFlattener::new(file).unwrap() {
            match record.unwrap() {
                Record::Metadata(metadata) => writer.write_metadata(&metadata).unwrap(),
                Record::Channel(channel) => {
                    channels.entry(channel.id).or_insert_with(|| {
                        let none = std::collections::BTreeMap::new();
                        writer.add_channel(0, &channel.topic, &channel.message_encoding, &none).unwrap()
                    });
                }
                Record::Message { mut header, data } => {
                    header.channel_id = channels[&header.channel_id];
                    writer.write_to_known_channel(&header, &data).unwrap();
                }
                _ => {}
            }
        }
        writer.finish().unwrap();
        drop(writer);
        bytes.into_inner()
    }

    #[test]
    fn damaged_sessions_are_replayed_and_exported_or_refused() {
        let plain = moment();
        let mut seeds = vec![rewritten(&plain, None), plain];
        for compression in [Compression::Zstd, Compression::Lz4] {
            seeds.push(rewritten(&seeds[0], Some(compression)));
        }
        let read = |bytes: &[u8]| {
            let replayed = replay(bytes).is_ok();
            let Ok(streams) = Streams::read(bytes) else { return replayed };
            for cut in [Cut::Whole, Cut::Motions, Cut::Marks { only_good: false }] {
                for episode in episodes::find(&streams, &cut, None).episodes {
                    let _ = frames::rows(&streams, &episode, 50);
                }
            }
            replayed
        };
        fuzz("MCAP", &seeds, count(400), read);
    }
}
