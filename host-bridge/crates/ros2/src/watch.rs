//! Monitors the node's threads. RustDDS 0.15 ends its two loops on any poll error.
//! Stopping and continuing this process (a debugger, a frozen container, suspend) causes such an error.
//! Published data is then lost without any report, so the threads are monitored from outside.

use std::path::{Path, PathBuf};

/// The library's thread names, of which the kernel stores 15 bytes.
const NAMES: [&str; 2] = ["RustDDS Partici", "RustDDS discove"];

/// The threads of one node.
#[derive(Clone, Debug, Default)]
pub struct Watch {
    threads: Vec<PathBuf>,
}

impl Watch {
    /// Returns the library's threads in this process, by task number.
    pub fn running() -> Vec<PathBuf> {
        let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
        let is_ours = |task: &Path| {
            let name = std::fs::read_to_string(task.join("comm")).unwrap_or_default();
            NAMES.contains(&name.trim_end())
        };
        tasks.map(|task| task.path()).filter(|task| is_ours(task)).collect()
    }

    /// Monitors the threads that started after `before` was recorded with [`Watch::running`].
    pub fn since(before: &[PathBuf]) -> Self {
        Watch { threads: Watch::running().into_iter().filter(|task| !before.contains(task)).collect() }
    }

    /// Returns whether no thread has ended.
    /// If the system (not Linux) does not list threads, they count as alive.
    pub fn is_alive(&self) -> bool {
        self.threads.iter().all(|task| task.exists())
    }
}
