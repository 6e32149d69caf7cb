//! External stops on the graph: an e-stop (in twist_mux's convention, true = stop) and a driver's fault flag.
//!
//! Each flag is a `std_msgs/Bool` of another publisher. While the flag is true, base and arm stop.
//! Base and arm also stop if the flag has no publisher or has sent no message yet.
//! With a timeout, they also stop if the flag is silent for too long.
//! This module is sans-IO. Publishers are identified by their participant, and our own messages are never read.

use std::collections::{BTreeMap, BTreeSet};

use super::config::Ros2Config;

/// Maximum number of publishers of one flag that are distinguished.
const WRITERS_MAX: usize = 64;

/// The last message of one publisher.
#[derive(Clone, Copy, Debug)]
struct Word {
    stop: bool,
    at_ms: u64,
}

/// One flag.
#[derive(Clone, Debug)]
struct Input {
    /// For people.
    what: &'static str,
    /// The key of the flag in `[ros2]`.
    key: &'static str,
    /// The topic with its namespace.
    topic: String,
    timeout_ms: u64,
    writers: BTreeSet<String>,
    said: BTreeMap<String, Word>,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    inputs: Vec<Input>,
}

impl Inputs {
    /// Creates the configured flags, without any message.
    pub fn new(config: &Ros2Config) -> Self {
        let input = |what, key, name: &String, timeout_ms| {
            (!name.is_empty()).then(|| Input {
                what,
                key,
                topic: config.resolve(name),
                timeout_ms,
                writers: BTreeSet::new(),
                said: BTreeMap::new(),
            })
        };
        let estop = input("e-stop", "estop", &config.estop, config.estop_timeout_ms);
        let fault = input("fault flag", "fault", &config.fault, config.fault_timeout_ms);
        Inputs { inputs: estop.into_iter().chain(fault).collect() }
    }

    /// Returns the topics of the flags, in the order of the numbers below.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        self.inputs.iter().map(|input| input.topic.as_str())
    }

    /// Processes a message on topic number `n`.
    /// The publisher `writer` requires a stop, or no longer requires it.
    pub fn hear(&mut self, n: usize, writer: &str, stop: bool, now_ms: u64) {
        let Some(input) = self.inputs.get_mut(n) else { return };
        if !stop {
            // A publisher that has disappeared cannot revoke its message.
            // The next existing publisher revokes that message.
            let Input { writers, said, .. } = input;
            said.retain(|known, _| writers.contains(known));
        }
        if input.said.len() < WRITERS_MAX || input.said.contains_key(writer) {
            input.said.insert(writer.to_owned(), Word { stop, at_ms: now_ms });
        }
    }

    /// Sets the current publishers of topic number `n`.
    pub fn see_writers(&mut self, n: usize, writers: impl Iterator<Item = String>) {
        if let Some(input) = self.inputs.get_mut(n) {
            input.writers = writers.collect();
        }
    }

    /// Resets everything: no publishers and no messages are known.
    pub fn forget(&mut self) {
        for input in &mut self.inputs {
            input.writers.clear();
            input.said.clear();
        }
    }

    /// Returns the reason why the robot must not move, or `None` if no flag forbids it.
    pub fn refusal(&self, now_ms: u64) -> Option<String> {
        self.inputs.iter().find_map(|input| input.refusal(now_ms))
    }
}

impl Input {
    fn refusal(&self, now_ms: u64) -> Option<String> {
        let Input { what, key, topic, timeout_ms, writers, said } = self;
        if said.values().any(|word| word.stop) {
            return Some(match *key {
                "fault" => {
                    format!("the robot's driver reports a fault ({topic} is true): clear it there first")
                }
                _ => format!("the e-stop is pressed ({topic} is true): release it there first"),
            });
        }
        if writers.is_empty() {
            return Some(format!(
                "nobody publishes the {what} {topic}: start its publisher, or take {key} out of [ros2]"
            ));
        }
        let newest =
            said.iter().filter(|(writer, _)| writers.contains(*writer)).map(|(_, word)| word.at_ms).max();
        match newest {
            None => Some(format!(
                "the {what} {topic} has said nothing yet: its publisher should be transient local (latched), or repeat itself"
            )),
            Some(at_ms) if *timeout_ms > 0 && now_ms.saturating_sub(at_ms) > *timeout_ms => {
                Some(format!("the {what} {topic} has been silent for more than {timeout_ms} ms"))
            }
            Some(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inputs() -> Inputs {
        Inputs::new(&Ros2Config {
            estop: "/e_stop".to_owned(),
            fault: "/fault_controller/internal_fault".to_owned(),
            fault_timeout_ms: 500,
            ..Ros2Config::default()
        })
    }

    fn see(inputs: &mut Inputs, n: usize, names: &[&str]) {
        inputs.see_writers(n, names.iter().map(|name| (*name).to_owned()));
    }

    #[test]
    fn without_inputs_nothing_is_refused() {
        assert_eq!(Inputs::new(&Ros2Config::default()).refusal(0), None);
    }

    #[test]
    fn an_input_that_never_appeared_or_says_nothing_is_a_stop() {
        let mut inputs = inputs();
        assert!(inputs.refusal(0).unwrap().contains("nobody publishes the e-stop /e_stop"));
        see(&mut inputs, 0, &["a"]);
        assert!(inputs.refusal(10).unwrap().contains("said nothing yet"));
        inputs.hear(0, "a", false, 20);
        assert!(inputs.refusal(20).unwrap().contains("nobody publishes the fault flag"));
        see(&mut inputs, 1, &["driver"]);
        inputs.hear(1, "driver", false, 30);
        assert_eq!(inputs.refusal(30), None);
    }

    fn ready() -> Inputs {
        let mut inputs = inputs();
        see(&mut inputs, 0, &["a", "b"]);
        see(&mut inputs, 1, &["driver"]);
        inputs.hear(0, "a", false, 0);
        inputs.hear(1, "driver", false, 0);
        assert_eq!(inputs.refusal(100), None);
        inputs
    }

    #[test]
    fn true_stops_whoever_says_it_until_he_takes_it_back() {
        let mut inputs = ready();
        // A publisher that the graph does not show yet is also respected.
        inputs.hear(0, "c", true, 100);
        assert!(inputs.refusal(100).unwrap().contains("e-stop is pressed"));
        inputs.hear(0, "a", false, 200);
        // "c" is not on the graph. The next existing publisher therefore revokes its message.
        assert_eq!(inputs.refusal(200), None);
        inputs.hear(0, "b", true, 300);
        inputs.hear(0, "a", false, 310);
        assert!(inputs.refusal(320).unwrap().contains("e-stop is pressed"), "b is there and says stop");
        inputs.hear(0, "b", false, 400);
        assert_eq!(inputs.refusal(400), None);
    }

    #[test]
    fn a_publisher_that_vanishes_is_a_stop_and_so_is_a_flag_that_falls_silent() {
        let mut inputs = ready();
        see(&mut inputs, 0, &[]);
        assert!(inputs.refusal(100).unwrap().contains("nobody publishes the e-stop"));
        see(&mut inputs, 0, &["a"]);
        assert_eq!(inputs.refusal(100), None, "it was away for one look, and its last word holds");
        see(&mut inputs, 0, &["another"]);
        assert!(inputs.refusal(100).unwrap().contains("said nothing yet"));
        inputs.hear(0, "another", false, 100);
        assert_eq!(inputs.refusal(500), None);
        assert!(
            inputs.refusal(501).unwrap().contains("silent for more than 500 ms"),
            "the fault flag's timeout"
        );
        inputs.hear(1, "driver", true, 502);
        assert!(inputs.refusal(502).unwrap().contains("reports a fault"));
        inputs.forget();
        assert!(inputs.refusal(503).is_some());
    }
}
