//! Tests session files that other programs have modified or damaged. Also tests their use in other programs.
#![cfg(feature = "mcap")]

use std::collections::HashMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use host_bridge::journal::sink::Sink;
use host_bridge::journal::{index, replay};
use mcap::records::Record;
use mcap::write::NoSeek;
use mcap::{Compression, WriteOptions, Writer};

fn host_bridge(args: &[&str]) -> (bool, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_host-bridge")).args(args).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    (output.status.success(), text.into_owned())
}

/// The recorded demo, created once for all tests of this file.
fn demo() -> &'static [u8] {
    static DEMO: OnceLock<Vec<u8>> = OnceLock::new();
    DEMO.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("demo.mcap").display().to_string();
        let (ok, text) = host_bridge(&["demo", "--headless", "--speed", "0", "--record", &file]);
        assert!(ok, "{text}");
        std::fs::read(file).unwrap()
    })
}

/// Copies the demo's messages except those of one topic.
fn copy<W: std::io::Write + std::io::Seek>(writer: &mut Writer<W>, without: &str) {
    let (mut schemas, mut channels) = (HashMap::new(), HashMap::new());
    for record in mcap::read::ChunkFlattener::new(demo()).unwrap() {
        match record.unwrap() {
            Record::Metadata(metadata) => writer.write_metadata(&metadata).unwrap(),
            Record::Schema { header, data } => {
                let id = writer.add_schema(&header.name, &header.encoding, &data).unwrap();
                schemas.insert(header.id, id);
            }
            Record::Channel(channel) if channel.topic != without && !channels.contains_key(&channel.id) => {
                let schema = schemas[&channel.schema_id];
                let added =
                    writer.add_channel(schema, &channel.topic, &channel.message_encoding, &channel.metadata);
                channels.insert(channel.id, added.unwrap());
            }
            Record::Message { mut header, data } => {
                if let Some(&id) = channels.get(&header.channel_id) {
                    header.channel_id = id;
                    writer.write_to_known_channel(&header, &data).unwrap();
                }
            }
            _ => {}
        }
    }
}

fn rewritten(file: &Path, compression: Option<Compression>, without: &str) -> String {
    let options = WriteOptions::new().profile("ros2").compression(compression);
    let mut writer = options.create(File::create(file).unwrap()).unwrap();
    copy(&mut writer, without);
    writer.finish().unwrap();
    file.display().to_string()
}

#[test]
fn compressed_files_are_read() {
    let folder = tempfile::tempdir().unwrap();
    for (name, compression) in [("zstd.mcap", Compression::Zstd), ("lz4.mcap", Compression::Lz4)] {
        let file = rewritten(&folder.path().join(name), Some(compression), "");
        assert!(std::fs::metadata(&file).unwrap().len() < demo().len() as u64 / 2);
        let (ok, text) = host_bridge(&["replay", &file]);
        assert!(ok && text.contains("all the same, bit for bit"), "{name}: {text}");
    }
}

#[test]
fn what_another_program_has_taken_out_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let file = rewritten(&folder.path().join("filtered.mcap"), None, "/joint_states");
    let whole = replay(demo()).unwrap();
    assert_eq!((whole.missing, whole.absent.len()), (0, 0));
    let (_, text) = host_bridge(&["replay", &file]);
    let missing = whole.messages["/joint_states"];
    let line = format!("{missing} messages (nothing of /joint_states) are missing");
    assert!(text.contains(&line) && text.contains("what is there is the same"), "{line}: {text}");
    assert!(!text.contains("all the same"), "{text}");
}

#[test]
fn a_killed_recording_gets_its_index_on_the_next_start_unless_it_still_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("killed.mcap");
    let storage = File::create(&file).unwrap();
    let held = storage.try_clone().unwrap();
    held.lock().unwrap();
    let options = WriteOptions::new().profile("ros2").compression(None).disable_seeking(true);
    let mut writer = options.create(NoSeek::new(Sink::new(storage))).unwrap();
    copy(&mut writer, "");
    writer.flush().unwrap();
    // If the writer is leaked, the file has no end.
    std::mem::forget(writer);
    let indexed = |file: &Path| {
        let bytes = std::fs::read(file).unwrap();
        mcap::Summary::read(&bytes).unwrap().is_some_and(|summary| !summary.chunk_indexes.is_empty())
    };
    assert!(!indexed(&file));
    assert_eq!(index::complete(&file), Ok(false), "somebody writes it");
    held.unlock().unwrap();
    let next = folder.path().join("next.mcap").display().to_string();
    let (ok, text) = host_bridge(&["demo", "--headless", "--speed", "0", "--record", &next]);
    assert!(ok && text.contains("killed.mcap: its recording was cut short; it has its index now"), "{text}");
    assert!(indexed(&file));
    let (again, first) = (replay(&std::fs::read(&file).unwrap()).unwrap(), replay(demo()).unwrap());
    assert!(again.is_same() && again.missing == 0);
    assert_eq!((again.compared, again.messages), (first.compared, first.messages));
    assert_eq!(index::complete(&file), Ok(false), "once is enough");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "no temporary file stays");
}

#[test]
fn a_damaged_step_does_not_run_for_ever() {
    let mut file = demo().to_vec();
    // In a message of steps, the first time value follows the first step's type. The test makes this time huge.
    let turns =
        mcap::read::ChunkFlattener::new(demo()).unwrap().filter_map(Result::ok).find_map(
            |record| match record {
                Record::Message { data, .. }
                    if data.len() > 24 && data[4..8] == [2, 0, 0, 0] && data[8] < 2 =>
                {
                    Some(data.into_owned())
                }
                _ => None,
            },
        );
    let turns = turns.unwrap();
    let at = file.windows(turns.len()).position(|window| window == turns).unwrap();
    file[at + 12..at + 20].copy_from_slice(&u64::MAX.to_le_bytes());
    file[at + 20..at + 28].copy_from_slice(&u64::MAX.to_le_bytes());
    let error = replay(&file).unwrap_err().to_string();
    assert!(error.contains("/bridge/turns") && error.contains("damaged"), "{error}");
}

fn lines(file: PathBuf) -> Vec<String> {
    std::fs::read_to_string(file).unwrap().lines().map(str::to_owned).collect()
}

#[test]
fn a_session_becomes_rows_at_an_even_rate() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(path("demo.mcap"), demo()).unwrap();
    let (ok, text) =
        host_bridge(&["export", &path("demo.mcap"), "--csv", &path("csv"), "--episodes", "motions"]);
    assert!(ok, "{text}");
    let list = lines(folder.path().join("csv/episodes.csv"));
    let whole = replay(demo()).unwrap();
    let reached = whole.events.iter().filter(|event| format!("{event:?}").contains("reached: true")).count();
    assert!(reached > 1 && list.len() == 1 + reached, "{list:?}\n{text}");
    let rows = lines(folder.path().join("csv/episode_000000.csv"));
    assert!(rows[0].starts_with("timestamp,frame_index,state.x.pos,state.y.pos,state.theta.pos,state.x.vel"));
    assert!(rows[1].starts_with("0,0,") && rows[2].starts_with("0.02,1,"), "{:?}", &rows[..3]);
    let columns = rows[0].split(',').count();
    assert!(rows.iter().all(|row| row.split(',').count() == columns));
    // The arm's motion appears in its columns, and the wheels of the base have no columns.
    assert!(!rows[0].contains("wheel"));
    let last = |row: &str| row.split(',').map(str::to_owned).collect::<Vec<_>>();
    assert_ne!(last(&rows[1])[7..14], last(&rows[rows.len() - 1])[7..14]);
    let (ok, text) = host_bridge(&["export", &path("demo.mcap"), "--csv", &path("csv")]);
    assert!(!ok && text.contains("not empty; give a new folder"), "{text}");
}

#[cfg(feature = "lerobot")]
#[test]
fn sessions_become_a_data_set_of_their_motions() {
    use parquet::file::reader::{FileReader as _, SerializedFileReader};
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(path("demo.mcap"), demo()).unwrap();
    let session = path("demo.mcap");
    let mut args = vec!["export"];
    args.extend([session.as_str(); 4]);
    let (out, task) = (path("set"), "drive about and point");
    args.extend(["--lerobot", &out, "--task", task, "--fps", "10", "--episodes", "motions"]);
    let (ok, text) = host_bridge(&args);
    let whole = replay(demo()).unwrap();
    let reached = whole.events.iter().filter(|event| format!("{event:?}").contains("reached: true")).count();
    let count = 4 * reached as i64;
    assert!(ok && count > 19 && text.contains(&format!("{count} episodes")), "{text}");
    let json = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(folder.path().join("set/meta").join(name)).unwrap()).unwrap()
    };
    let rows = |name: &str| {
        let file = File::open(folder.path().join("set").join(name)).unwrap();
        SerializedFileReader::new(file).unwrap().metadata().file_metadata().num_rows()
    };
    let info = json("info.json");
    assert_eq!(
        (info["total_episodes"].as_i64(), info["codebase_version"].as_str()),
        (Some(count), Some("v3.0"))
    );
    assert_eq!(info["total_frames"].as_i64(), Some(rows("data/chunk-000/file-000.parquet")));
    assert_eq!(rows("meta/episodes/chunk-000/file-000.parquet"), count);
    assert_eq!(rows("meta/tasks.parquet"), 1);
    let stats = json("stats.json");
    assert_eq!(stats["timestamp"]["min"][0].as_f64(), Some(0.0));
    assert_eq!(
        stats["action"]["mean"].as_array().map(Vec::len),
        info["features"]["action"]["shape"][0].as_u64().map(|n| n as usize)
    );
}
