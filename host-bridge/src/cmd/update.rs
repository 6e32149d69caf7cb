//! `host-bridge update`: replaces the firmware image of a board with an nRF52840. No debug probe is needed.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Result, bail, ensure};
use ed25519_compact::{KeyPair, Noise, Seed};
use host_bridge::ending::Ending;
use host_bridge::links::is_ble;
use host_bridge::safety::Hand;
use host_bridge::talk::{Said, Talk, TalkError, Who, advice};
use host_bridge::upload::Upload;
use shared_board::update::{IMAGE_MAX, NotAnImage, SIGNATURE_BYTES, Trailer};
use shared_proto::message::{AckResult, Board, HostMessage, Mode};

use super::ports::PortOptions;
use super::send_model::transfer;

const HELLO_MS: u64 = 6000;
/// Time limit for the exchange of the images, which takes about 20 s, and for the reconnection.
const EXCHANGE_MS: u64 = 120_000;
/// The first minor version of the protocol in which boards accept images.
const SINCE_MINOR: u8 = HostMessage::ImageConfirm { request: 0, crc32: 0 }.row().since;

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// The new image (`nano33-trouble.update`, `xiao-trouble.update` or `xiao-left.update`)
    #[arg(value_name = "FILE", required_unless_present = "new_key")]
    file: Option<PathBuf>,
    #[command(flatten)]
    port: PortOptions,
    /// Sign the image with this secret key; over Bluetooth, boards accept only images that are signed with their key
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Only write a new secret key to FILE, and its public key to FILE.pub (`cargo xtask firmware nano33 trouble --key FILE.pub`)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["file", "key"])]
    new_key: Option<PathBuf>,
}

/// Sends the image, waits until it runs, and confirms it.
pub fn run(args: &Args) -> Result<ExitCode> {
    if let Some(file) = &args.new_key {
        return new_key(file);
    }
    let Some(path) = &args.file else { bail!("name the file of the new image") };
    let (mut file, trailer) = read(path)?;
    if let Some(key) = &args.key {
        sign(&mut file, &secret_key(key)?);
    }
    let (port, settings) = args.port.resolve(Board::from(trailer.board).hand().unwrap_or(Hand::Right))?;
    let is_signed = file[file.len() - SIGNATURE_BYTES..].iter().any(|&byte| byte != 0);
    ensure!(
        is_signed || !is_ble(&port),
        "{}: over Bluetooth a board accepts only a signed image; sign it with --key FILE, or use the USB cable",
        path.display()
    );
    let mut talk = Talk::open(&port, settings);
    let who = talk.hello(HELLO_MS)?;
    check(&port, &who, path, &trailer)?;
    println!(
        "{port}: {}, firmware {} → {}, {} bytes",
        who.board,
        who.firmware,
        trailer.version(),
        file.len()
    );
    let quit = Arc::new(AtomicBool::new(false));
    let _ending = Ending::watch(&quit, false).context("signals cannot be caught here")?;
    // During the transfer, the board sends no gestures and no state.
    // A bridge that uses this board therefore halts its robot.
    set_mode(&mut talk, Mode::Idle)?;
    let mut upload = Upload::image(&file, talk.next_request());
    if let Err(error) = transfer(&mut talk, &mut upload, who.boot_id, &quit) {
        // This message makes the board recognise gestures again. If it is lost, a restart has the same effect.
        let _ = set_mode(&mut talk, Mode::Classify);
        return Err(error);
    }
    println!("the board has the image and exchanges it; this takes about 20 s, and the power may fail");
    outcome(&mut talk, upload.model_id(), &who, &trailer)
}

fn set_mode(talk: &mut Talk, mode: Mode) -> Result<(), TalkError> {
    talk.request(3000, |request| HostMessage::SetMode { request, mode }).map(drop)
}

fn read(path: &Path) -> Result<(Vec<u8>, Trailer)> {
    let file =
        std::fs::read(path).with_context(|| format!("{}: the image cannot be read", path.display()))?;
    match Trailer::read(&file) {
        Ok(trailer) => Ok((file, trailer)),
        Err(NotAnImage::Length) if file.len() > IMAGE_MAX as usize => {
            bail!("{}: {} bytes are too many; an image has at most {IMAGE_MAX}", path.display(), file.len())
        }
        Err(NotAnImage::Damaged) => {
            bail!("{}: the file is damaged; build it or download it again", path.display())
        }
        Err(_) => bail!(
            "{}: this is no image for an update; `cargo xtask firmware nano33 trouble` makes one, which ends in .update",
            path.display()
        ),
    }
}

/// Refuses the update if the file is for another board, or if the board cannot be updated in this way.
fn check(port: &str, who: &Who, path: &Path, trailer: &Trailer) -> Result<()> {
    let wanted = Board::from(trailer.board);
    // Both hardware revisions of the Nano 33 run the same image.
    let same = |board| if board == Board::RightNano33Rev2 { Board::RightNano33 } else { board };
    ensure!(
        same(wanted) == same(who.board),
        "{port}: {} answers, but {} is for {wanted}; choose the file for this board",
        who.board,
        path.display()
    );
    ensure!(
        who.version.1 >= SINCE_MINOR,
        "{port}: the firmware {} of this board cannot be updated through its port; flash the image once as \
         firmware-nano33/README.md describes (press reset twice)",
        who.firmware
    );
    Ok(())
}

/// Waits for the restarted board, and asks it whether the new image is running.
fn outcome(talk: &mut Talk, crc32: u32, before: &Who, trailer: &Trailer) -> Result<ExitCode> {
    let request = talk.next_request();
    let until_ms = talk.now_ms() + EXCHANGE_MS;
    let mut asked_ms = 0;
    let mut restarted = false;
    while talk.now_ms() < until_ms {
        if talk.is_ready() && talk.now_ms() - asked_ms >= 500 {
            let message = if restarted {
                HostMessage::ImageConfirm { request, crc32 }
            } else {
                HostMessage::HelloRequest
            };
            talk.send(&message);
            asked_ms = talk.now_ms();
        }
        match talk.next(20) {
            Some((_, Said::Hello(who))) if who.boot_id != before.boot_id => restarted = true,
            Some((_, Said::Ack(ack))) if ack.request == request => match ack.result {
                AckResult::Ok => {
                    println!("firmware {} runs, has said hello, and stays", trailer.version());
                    return Ok(ExitCode::SUCCESS);
                }
                AckResult::Busy => {}
                AckResult::WrongOffset | AckResult::BadChecksum => {
                    bail!("{}: the board knows nothing of this image; send it again", talk.port())
                }
                result => bail!("{}: {}; firmware {} runs", talk.port(), advice(result), before.firmware),
            },
            _ => {}
        }
    }
    bail!(
        "{}: the board did not come back within two minutes. At its next restart, it goes back to firmware {}. \
         Press reset; if nothing answers then, press reset twice and flash it as firmware-nano33/README.md describes",
        talk.port(),
        before.firmware
    )
}

fn sign(file: &mut [u8], key: &KeyPair) {
    let (signed, place) = file.split_at_mut(file.len() - SIGNATURE_BYTES);
    place.copy_from_slice(&*key.sk.sign(&*signed, None::<Noise>));
}

fn secret_key(path: &Path) -> Result<KeyPair> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("{}: the key cannot be read", path.display()))?;
    let seed = bytes_of(text.trim()).with_context(|| {
        format!("{}: this is no key; `host-bridge update --new-key FILE` makes one", path.display())
    })?;
    Ok(KeyPair::from_seed(Seed::new(seed)))
}

fn bytes_of(text: &str) -> Option<[u8; 32]> {
    let mut bytes = [0; 32];
    if text.len() != 64 || !text.is_ascii() {
        return None;
    }
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&text[2 * i..2 * i + 2], 16).ok()?;
    }
    Some(bytes)
}

fn text_of(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).chain(["\n".to_owned()]).collect()
}

fn new_key(path: &Path) -> Result<ExitCode> {
    let seed = Seed::generate();
    let mut public = path.as_os_str().to_owned();
    public.push(".pub");
    let public = PathBuf::from(public);
    write_new(path, &text_of(&*seed), true)?;
    write_new(&public, &text_of(&*KeyPair::from_seed(seed).pk), false)?;
    println!(
        "{}: the secret key. Who has it can put any program on your boards over Bluetooth",
        path.display()
    );
    println!("{}: the public key, for `cargo xtask firmware nano33 trouble --key`", public.display());
    Ok(ExitCode::SUCCESS)
}

/// Creates a file, and fails if it already exists. Only its owner can read a secret file.
fn write_new(path: &Path, text: &str, secret: bool) -> Result<()> {
    use std::io::Write as _;
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    if secret {
        use std::os::unix::fs::OpenOptionsExt as _;
        options.mode(0o600);
    }
    #[cfg(not(unix))]
    let _ = secret;
    let about =
        || format!("{}: the key cannot be written; choose a name that does not exist yet", path.display());
    options.open(path).and_then(|mut file| file.write_all(text.as_bytes())).with_context(about)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> (Vec<u8>, Trailer) {
        let trailer = Trailer { origin: 0x16000, board: 1, version: *b"0.2.0\0\0\0\0\0\0\0\0\0\0\0" };
        let image = vec![3; 1000];
        let mut file = trailer.file(&image);
        sign(&mut file, &KeyPair::from_seed(Seed::new([5; 32])));
        (file, trailer)
    }

    fn who(board: Board, minor: u8) -> Who {
        Who {
            version: (1, minor),
            board,
            firmware: "0.1.0".to_owned(),
            boot_id: 1,
            model_id: 0,
            sample_hz: 100,
            problem: None,
        }
    }

    #[test]
    fn a_signature_covers_everything_before_it() {
        let (mut file, _) = file();
        let key = KeyPair::from_seed(Seed::new([5; 32])).pk;
        let valid = |file: &[u8]| {
            let (signed, signature) = file.split_at(file.len() - SIGNATURE_BYTES);
            let signature = ed25519_compact::Signature::from_slice(signature).unwrap();
            key.verify(signed, &signature).is_ok()
        };
        assert!(valid(&file));
        file[1010] ^= 1;
        assert!(!valid(&file), "the version is signed too");
    }

    #[test]
    fn a_file_for_another_board_and_a_board_without_a_second_stage_are_refused_with_what_to_do() {
        let (_, trailer) = file();
        let refused = |board, minor| {
            check("p", &who(board, minor), Path::new("f"), &trailer).err().map(|error| error.to_string())
        };
        assert_eq!(refused(Board::RightNano33, 5), None);
        assert_eq!(refused(Board::RightNano33Rev2, 6), None);
        for board in [Board::RightXiao, Board::LeftXiao, Board::LeftNano] {
            assert!(refused(board, 5).unwrap().contains("choose the file for this board"));
        }
        assert!(refused(Board::RightNano33, 4).unwrap().contains("press reset twice"));
    }

    #[test]
    fn keys_are_read_as_they_were_written_and_never_written_over() {
        let folder = std::env::temp_dir().join(format!("bimanual-key-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("key");
        new_key(&path).unwrap();
        let public = std::fs::read_to_string(folder.join("key.pub")).unwrap();
        assert_eq!(public, text_of(&*secret_key(&path).unwrap().pk));
        assert!(new_key(&path).unwrap_err().to_string().contains("does not exist yet"));
        assert!(secret_key(&folder.join("none")).unwrap_err().to_string().contains("cannot be read"));
        std::fs::write(&path, "hello").unwrap();
        assert!(secret_key(&path).unwrap_err().to_string().contains("--new-key"));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_is_no_image_is_refused_before_a_port_is_opened() {
        let path = std::env::temp_dir().join(format!("bimanual-image-{}", std::process::id()));
        let (good, trailer) = file();
        let says = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            read(&path).map(|(_, trailer)| trailer).map_err(|error| error.to_string())
        };
        assert_eq!(says(&good), Ok(trailer));
        assert!(says(b"MZ").unwrap_err().contains("no image"));
        assert!(says(&vec![0; 300_000]).unwrap_err().contains("too many"));
        let mut damaged = good;
        damaged[9] ^= 1;
        assert!(says(&damaged).unwrap_err().contains("damaged"));
        std::fs::remove_file(&path).unwrap();
    }
}
