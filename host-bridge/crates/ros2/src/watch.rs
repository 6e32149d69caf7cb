//! Are the threads of the node alive? RustDDS 0.15 ends its two loops on any error of its poll, and every stop and
//! continuation of this process (a debugger, a frozen container, suspend) is such an error. What is published then goes
//! nowhere and nothing says so: so it is watched from outside.

use std::path::{Path, PathBuf};

/// How the library names its threads; the kernel keeps 15 bytes of a name.
const NAMES: [&str; 2] = ["RustDDS Partici", "RustDDS discove"];

/// The threads of one node.
#[derive(Clone, Debug, Default)]
pub struct Watch {
    threads: Vec<PathBuf>,
}

impl Watch {
    /// Threads of the library in this process, by the number of their task.
    pub fn running() -> Vec<PathBuf> {
        let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
        let is_ours = |task: &Path| {
            let name = std::fs::read_to_string(task.join("comm")).unwrap_or_default();
            NAMES.contains(&name.trim_end())
        };
        tasks.map(|task| task.path()).filter(|task| is_ours(task)).collect()
    }

    /// Watches those that came since `before` was taken with [`Watch::running`].
    pub fn since(before: &[PathBuf]) -> Self {
        Watch { threads: Watch::running().into_iter().filter(|task| !before.contains(task)).collect() }
    }

    /// Whether none has ended. Where the system does not list threads (not Linux) they count as alive.
    pub fn is_alive(&self) -> bool {
        self.threads.iter().all(|task| task.exists())
    }
}
