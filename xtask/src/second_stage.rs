//! Builds the second stage for images that can be updated without a debug probe.
//! Also writes the two files of such an image:
//! one for flashing, which includes the second stage, and one for `host-bridge update`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use shared_board::update::{IMAGE_MAX, KEY_AT, KEY_BYTES, SLOT_A, TAIL_BYTES, Trailer};
use shared_proto::message::Board;

use crate::{firmware_nano33, root};

/// Start address of the second stage on a Nano 33.
const NANO33_ORIGIN: u32 = 0x1_0000;

/// Keeps the second stage that was built together with an image. Returns its path, which is in the same folder as the image.
///
/// # Errors
/// Fails if the second stage is not there.
pub fn keep(image: &Path) -> Result<PathBuf> {
    let mut name = image.file_name().unwrap_or_default().to_owned();
    name.push("-stage");
    let stage = image.with_file_name(name);
    std::fs::copy(image.with_file_name("nano33-stage"), &stage).context("the second stage is not there")?;
    Ok(stage)
}

/// Writes a `.bin` file for flashing and an `.update` file, and returns the two paths.
/// The `.bin` file includes the second stage, which contains the public key if there is one.
///
/// # Errors
/// Fails if a part is too large, or if the key file does not contain a key.
pub fn make_files(image: &Path, stage: &Path, board: Board, key: Option<&Path>) -> Result<[PathBuf; 2]> {
    let raw = |elf: &Path| -> Result<Vec<u8>> {
        let file = elf.with_extension("raw");
        firmware_nano33::objcopy(elf, "binary", &file)?;
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
    let base = if board == Board::RightNano33 { NANO33_ORIGIN } else { firmware_nano33::XIAO_ORIGIN };
    let text = version()?;
    let mut version = [0; 16];
    version.get_mut(..text.len()).context("the version is too long")?.copy_from_slice(text.as_bytes());
    let trailer = Trailer { origin: base + SLOT_A, board: board.into(), version };
    let files = [image.with_extension("bin"), image.with_extension("update")];
    std::fs::write(&files[0], whole(stage, &linked, key)?)?;
    std::fs::write(&files[1], trailer.file(&linked))?;
    Ok(files)
}

/// Returns the second stage, with the key at its end, followed by the image.
fn whole(mut stage: Vec<u8>, linked: &[u8], key: Option<[u8; KEY_BYTES]>) -> Result<Vec<u8>> {
    let room = KEY_AT as usize;
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

/// Returns the version in the firmware's Cargo.toml.
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
