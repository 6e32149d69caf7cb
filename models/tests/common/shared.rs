//! The contents of the folder `shared` beside the repository; `BIMANUAL_SHARED` may name another folder.

use std::path::PathBuf;

/// A file or folder of it, if this machine has it.
pub fn shared(name: &str) -> Option<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let path = std::env::var_os("BIMANUAL_SHARED").map_or(beside, PathBuf::from).join(name);
    if !path.exists() {
        println!("skipped: {} is not here (BIMANUAL_SHARED names the folder)", path.display());
        return None;
    }
    Some(path)
}
