//! The second stage of images that can be updated through their port, and the two files that such an image is given as:
//! one to flash, with the second stage, and one for `host-bridge update`.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use shared_board::update::{IMAGE_MAX, SLOT_A, STAGE_BYTES, TAIL_BYTES, Trailer};
use shared_proto::message::Board;

use crate::steps::sh;
use crate::toolchain::{Target, cargo};
use crate::{firmware_nano33, root, target_dir};

/// Where the second stages of a Nano 33 and of a XIAO start.
const NANO33: u32 = 0x1_0000;
const XIAO: u32 = 0x2_7000;
const KEY_BYTES: usize = 32;

/// Returns the address at which the file to flash starts.
pub fn base(is_xiao: bool) -> u32 {
    if is_xiao { XIAO } else { NANO33 }
}

/// Builds the second stage of an image, and returns its path, which is beside the image.
///
/// # Errors
/// If it does not build.
pub fn build(image: &Path, is_xiao: bool) -> Result<PathBuf> {
    let mut command = cargo(Target::Thumb, "build")?;
    command.args(["--release", "--locked", "-p", "nano33-stage"]);
    if is_xiao {
        command.args(["--features", "nano33-stage/xiao"]);
    }
    sh(command.current_dir(root().join("firmware-nano33")).env("CARGO_TARGET_DIR", target_dir()))?;
    let mut name = image.file_name().unwrap_or_default().to_owned();
    name.push("-stage");
    let stage = image.with_file_name(name);
    std::fs::copy(image.with_file_name("nano33-stage"), &stage).context("the second stage is not there")?;
    Ok(stage)
}

/// Writes `.bin`, which is flashed and contains the second stage with this public key or none, and `.update`.
/// Returns the two paths.
///
/// # Errors
/// If a part is too large, or the key is none.
pub fn make_files(image: &Path, stage: &Path, board: Board, key: Option<&Path>) -> Result<[PathBuf; 2]> {
    let raw = |elf: &Path| -> Result<Vec<u8>> {
        let file = elf.with_extension("raw");
        sh(Command::new(firmware_nano33::tool("objcopy")).args(["-O", "binary"]).arg(elf).arg(&file))?;
        Ok(std::fs::read(&file)?)
    };
    let (stage, linked) = (raw(stage)?, raw(image)?);
    let key = key.map(public_key).transpose()?;
    ensure!(
        linked.len() + TAIL_BYTES <= IMAGE_MAX as usize,
        "{}: {} bytes are too many",
        image.display(),
        linked.len()
    );
    let text = version()?;
    let mut version = [0; 16];
    version.get_mut(..text.len()).context("the version is too long")?.copy_from_slice(text.as_bytes());
    let trailer =
        Trailer { origin: base(board != Board::RightNano33) + SLOT_A, board: board.into(), version };
    let files = [image.with_extension("bin"), image.with_extension("update")];
    std::fs::write(&files[0], whole(stage, &linked, key)?)?;
    std::fs::write(&files[1], trailer.file(&linked))?;
    Ok(files)
}

/// The second stage, its key at its end, and the image.
fn whole(mut stage: Vec<u8>, linked: &[u8], key: Option<[u8; KEY_BYTES]>) -> Result<Vec<u8>> {
    let room = STAGE_BYTES as usize - KEY_BYTES;
    ensure!(stage.len() <= room, "the second stage has {} bytes, and room for {room}", stage.len());
    stage.resize(room, 0xFF);
    stage.extend(key.unwrap_or([0xFF; KEY_BYTES]));
    stage.extend(linked);
    Ok(stage)
}

fn public_key(path: &Path) -> Result<[u8; KEY_BYTES]> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}: no key", path.display()))?;
    let digits = text.trim();
    let about = || {
        format!(
            "{}: no public key; `host-bridge update --new-key FILE` writes one to FILE.pub",
            path.display()
        )
    };
    ensure!(path.extension().is_some_and(|end| end == "pub"), "{}", about());
    ensure!(digits.len() == 2 * KEY_BYTES && digits.is_ascii(), "{}", about());
    let mut key = [0; KEY_BYTES];
    for (i, byte) in key.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&digits[2 * i..2 * i + 2], 16).with_context(about)?;
    }
    Ok(key)
}

/// The version in the firmware's Cargo.toml.
fn version() -> Result<String> {
    let manifest = std::fs::read_to_string(root().join("firmware-nano33/Cargo.toml"))?;
    let line = manifest.lines().find_map(|line| line.strip_prefix("version = \""));
    Ok(line.and_then(|rest| rest.strip_suffix('"')).context("the firmware has no version")?.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_to_flash_has_the_key_at_the_end_of_the_second_stage_and_the_image_behind() {
        let file = whole(vec![1; 100], &[2; 50], Some([9; 32])).unwrap();
        assert_eq!(file.len(), 0x6000 + 50);
        assert_eq!((file[99], file[100], file[0x5FDF]), (1, 0xFF, 0xFF));
        assert_eq!((&file[0x5FE0..0x6000], &file[0x6000..]), (&[9; 32][..], &[2; 50][..]));
        assert_eq!(whole(vec![], &[], None).unwrap()[0x5FE0..], [0xFF; 32]);
        assert!(whole(vec![0; 0x5FE1], &[], None).is_err());
    }

    #[test]
    fn a_version_is_found() {
        assert_eq!(version().unwrap().split('.').count(), 3);
    }
}
