//! Locates files in the folder `shared` beside the repository, or in the folder named by `BIMANUAL_SHARED`.

use std::path::PathBuf;

/// Returns a file or a folder, if it exists on this machine.
pub fn shared(name: &str) -> Option<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let path = std::env::var_os("BIMANUAL_SHARED").map_or(beside, PathBuf::from).join(name);
    if !path.exists() {
        println!("skipped: {} is not here (BIMANUAL_SHARED names the folder)", path.display());
        return None;
    }
    Some(path)
}
