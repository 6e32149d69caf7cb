//! `host-bridge send-model`: sends your own model to the right hand's board.

use std::io::{IsTerminal as _, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Result, bail, ensure};
use host_bridge::hands::ModelFile;
use host_bridge::intent::MotionMap;
use host_bridge::safety::Hand;
use host_bridge::talk::{Said, Talk};
use host_bridge::upload::{Stage, Upload, misfit};
use shared_dsp::right::network::Model;
use shared_proto::message::{HostMessage, LABELS_MAX, SCORES_MAX};

use super::ports::PortOptions;
use crate::play::Interrupted;

const HELLO_MS: u64 = 6000;
/// Maximum time without progress, which is long enough for reconnecting a cable.
const PATIENCE_MS: u64 = 60_000;

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// The int8 model, with its card in the same folder
    #[arg(value_name = "FILE.tflite")]
    model: PathBuf,
    #[command(flatten)]
    port: PortOptions,
    /// Send the model even if the board already runs this model
    #[arg(long)]
    force: bool,
}

/// Sends the model, and resumes after an interruption.
pub fn run(args: &Args) -> Result<ExitCode> {
    let file = ModelFile::read(&args.model)?;
    let model = Model::parse(file.blob())?;
    let info = *model.info();
    ensure!(
        info.label_text.len() <= LABELS_MAX && info.label_count <= SCORES_MAX,
        "{}: its labels take {} bytes with their commas, the wire takes {LABELS_MAX}; shorten them",
        file.name(),
        info.label_text.len()
    );
    let (port, settings) = args.port.resolve(Hand::Right)?;
    let mut talk = Talk::open(&port, settings);
    let who = talk.hello(HELLO_MS)?;
    if who.board.hand() == Some(Hand::Left) {
        bail!("{port}: {} answers; only the right hand's board runs a model", who.board);
    }
    let Some(board) = talk.model(4000) else {
        bail!("{port}: the board does not say what its model needs; update its firmware");
    };
    if let Some(problem) = misfit(&model, &board) {
        bail!("{}: {problem}", args.model.display());
    }
    let (old, new) = (who.model_id, info.model_id);
    println!("{port}: {}, runs model {old:08x} ({})", who.board, board.labels.join(", "));
    println!("sending {new:08x} ({}), {} bytes", file.labels().join(", "), file.blob().len());
    for label in MotionMap::default().without_motion(file.labels()) {
        println!(
            "note: '{label}' has no motion yet; `run --map {label}=MOTION` gives it one, or [motions] in its --config"
        );
    }
    if old == new && !args.force {
        println!("the board runs this model already; nothing to do");
        return Ok(ExitCode::SUCCESS);
    }
    let mut upload = Upload::new(file.blob(), talk.next_request())?;
    transfer(&mut talk, &mut upload, who.boot_id, &AtomicBool::new(false))?;
    println!("model {old:08x} → {new:08x}: verified and kept by the board");
    println!("it is used after the next restart: press reset, then `host-bridge doctor` shows {new:08x}");
    Ok(ExitCode::SUCCESS)
}

/// Sends all pieces, and resumes after an interruption. The transfer ends early when `quit` is set.
pub(super) fn transfer(
    talk: &mut Talk,
    upload: &mut Upload,
    mut boot_id: u32,
    quit: &AtomicBool,
) -> Result<()> {
    let mut progress_ms = talk.now_ms();
    let mut open = true;
    let mut reached = upload.progress().0;
    loop {
        match upload.stage() {
            Stage::Done => {
                if std::io::stdout().is_terminal() {
                    println!();
                }
                return Ok(());
            }
            Stage::Failed(why) => bail!("{why}"),
            _ => {}
        }
        if quit.load(Ordering::SeqCst) {
            return Err(Interrupted.into());
        }
        if open
            && talk.is_ready()
            && let Some(message) = upload.poll(talk.now_ms())
            && !talk.send(&message)
        {
            upload.unsent();
        }
        match talk.next(10) {
            Some((_, Said::Ack(ack))) => upload.ack(&ack),
            Some((_, Said::Hello(who))) if who.boot_id != boot_id => {
                boot_id = who.boot_id;
                upload.restarted();
                if *upload.stage() == Stage::Begin {
                    println!("the board restarted: from the start");
                }
            }
            Some((_, Said::Closed(why))) => {
                open = false;
                println!("{why}");
            }
            Some((_, Said::Opened)) => {
                open = true;
                // The board's answer shows whether it has restarted.
                talk.send(&HostMessage::HelloRequest);
            }
            _ => {}
        }
        let (done, all) = upload.progress();
        if done != reached {
            reached = done;
            progress_ms = talk.now_ms();
            if std::io::stdout().is_terminal() {
                print!("\r   {done} of {all} bytes ");
                let _ = std::io::stdout().flush();
            }
        }
        if talk.now_ms() - progress_ms > PATIENCE_MS {
            bail!(
                "{}: no progress for a minute; the board keeps what it has. Check the cable and send again",
                talk.port()
            );
        }
    }
}
