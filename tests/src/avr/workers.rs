//! Runs trials in parallel processes, because simavr has globals and a process can run only one board at a time.

use std::process::{Command, Stdio};

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Runs `program verb JSON` once per job, in parallel on all processors.
/// Returns the JSON that each process printed on standard output, in the order of the jobs.
///
/// # Panics
/// Panics if a worker fails. The terminal shows its standard error.
pub fn run<J: Serialize, R: DeserializeOwned>(program: &str, verb: &str, jobs: &[J]) -> Vec<R> {
    let at_once = std::thread::available_parallelism().map_or(2, usize::from);
    let mut results = Vec::new();
    for batch in jobs.chunks(at_once) {
        let children: Vec<_> = batch
            .iter()
            .map(|job| {
                Command::new(program)
                    .arg(verb)
                    .arg(serde_json::to_string(job).expect("a job in JSON"))
                    .env("BIMANUAL_AVR_ELF", super::image::path())
                    .stdin(Stdio::null())
                    .stdout(Stdio::piped())
                    .spawn()
                    .expect("the worker starts")
            })
            .collect();
        for child in children {
            let output = child.wait_with_output().expect("the worker ends");
            assert!(output.status.success(), "{verb}: a worker failed");
            // simavr also prints to standard output, so the result is the last line.
            let text = String::from_utf8_lossy(&output.stdout);
            let text = text.lines().last().unwrap_or("");
            results.push(serde_json::from_str(text).unwrap_or_else(|e| panic!("{verb}: {e} in {text}")));
        }
    }
    results
}
