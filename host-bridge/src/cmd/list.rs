//! `host-bridge list`: lists serial ports and Bluetooth boards with the hand that answers on each.

use std::process::ExitCode;

use anyhow::Result;
use host_bridge::links::{PortAbout, SerialSettings, hints, ports};
use host_bridge::talk::{Talk, TalkError, Who};

/// Time for two attempts, because an old Nano takes 2 s to start.
const PATIENCE_MS: u64 = 4500;
/// Environment variable that lists additional ports, separated by colons.
/// Such ports include adapters that the system does not classify as USB, pseudo-terminals, and emulated boards.
const MORE_PORTS: &str = "BIMANUAL_PORTS";

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Additional ports besides the USB ports found (also in the variable BIMANUAL_PORTS, separated by colons)
    #[arg(value_name = "PORT")]
    ports: Vec<String>,
    /// List the ports but do not open them (opening resets a Nano)
    #[arg(long)]
    no_ask: bool,
}

/// Asks all ports at once. The exit code shows whether a hand was found.
pub fn run(args: &Args) -> Result<ExitCode> {
    let (mut asked, others): (Vec<_>, Vec<_>) = ports().into_iter().partition(|port| port.is_usb);
    let more = std::env::var(MORE_PORTS).unwrap_or_default();
    let more = more.split(':').filter(|name| !name.is_empty()).map(str::to_owned);
    for name in &args.ports.iter().cloned().chain(more).collect::<Vec<_>>() {
        super::ports::check_name(name)?;
        if !asked.iter().any(|port| port.name == *name) {
            let about = "named by you".to_owned();
            asked.push(PortAbout { name: name.clone(), about, is_usb: true });
        }
    }
    if args.no_ask {
        for port in asked.iter().chain(&others) {
            println!("{}  {}", port.name, port.about);
        }
        if asked.is_empty() {
            print_hints("no USB serial port was found", others.len());
        }
        return Ok(ExitCode::SUCCESS);
    }
    let bluetooth = match bluetooth() {
        Ok(found) => {
            let none = found.is_empty();
            asked.extend(found);
            none.then(|| "no hand is in reach".to_owned())
        }
        Err(problem) => Some(problem),
    };
    let answers: Vec<Result<Who, TalkError>> = std::thread::scope(|scope| {
        let asking: Vec<_> = asked
            .iter()
            .map(|port| {
                let name = port.name.as_str();
                scope.spawn(move || Talk::open(name, SerialSettings::default()).meet(PATIENCE_MS))
            })
            .collect();
        let nobody = |name: &str| TalkError::Nobody { port: name.to_owned() };
        let answer = |(thread, port): (std::thread::ScopedJoinHandle<'_, _>, &PortAbout)| {
            thread.join().unwrap_or_else(|_| Err(nobody(&port.name)))
        };
        asking.into_iter().zip(&asked).map(answer).collect()
    });
    let mut hands = 0;
    for (port, answer) in asked.iter().zip(&answers) {
        let said = match answer {
            Ok(Who { problem: Some(problem), .. }) => problem.clone(),
            Ok(who) => {
                hands += 1;
                let model = match who.model_id {
                    0 => String::new(),
                    id => format!(", model {id:08x}"),
                };
                format!("{}, firmware {}{model}", who.board, who.firmware)
            }
            Err(TalkError::Nobody { .. }) => "no answer: no hand, or not flashed".to_owned(),
            Err(error) => error.to_string().trim_start_matches(&format!("{}: ", port.name)).to_owned(),
        };
        println!("{}  {}  → {said}", port.name, port.about);
    }
    if let Some(problem) = bluetooth {
        let named = if problem.starts_with("Bluetooth") { "" } else { "Bluetooth: " };
        println!("{named}{problem}");
    }
    if hands > 0 {
        return Ok(ExitCode::SUCCESS);
    }
    let what = if asked.is_empty() { "no USB serial port was found" } else { "no hand answered" };
    print_hints(what, others.len());
    Ok(ExitCode::FAILURE)
}

/// Returns the boards that advertise, or the reason why none can be found.
#[cfg(feature = "ble")]
fn bluetooth() -> Result<Vec<PortAbout>, String> {
    host_bridge::links::ble_devices(std::time::Duration::from_secs(3))
}

#[cfg(not(feature = "ble"))]
fn bluetooth() -> Result<Vec<PortAbout>, String> {
    Err(super::ports::NO_BLUETOOTH.to_owned())
}

fn print_hints(what: &str, others: usize) {
    println!("{what}. What to try:");
    for hint in hints() {
        println!("  - {hint}");
    }
    println!("  - no board at hand: `host-bridge run --left keyboard --right keyboard`");
    if others > 0 {
        println!("({others} other serial ports were not asked; name one to ask it: host-bridge list PORT)");
    }
}
