//! Port options of all commands that communicate with one board.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use host_bridge::config::{Config, Ports};
use host_bridge::links::{SerialSettings, is_ble};
use host_bridge::safety::Hand;

/// Reads a configuration file, or returns the defaults.
pub fn read_config(file: Option<&Path>) -> Result<Config> {
    let Some(file) = file else { return Ok(Config::default()) };
    let about = || file.display().to_string();
    let text = std::fs::read_to_string(file)
        .with_context(|| format!("{}: the configuration cannot be read", about()))?;
    Config::parse(&text).with_context(about)
}

/// Returns the settings of a hand's port.
pub fn settings(config: &Config, hand: Hand) -> SerialSettings {
    let Ports { baud, settle_ms, allow_unbonded, .. } = config.ports;
    SerialSettings { baud, settle_ms, allow_unbonded, hand: Some(hand) }
}

/// Returns the port of a hand: the requested port, or otherwise the port in the configuration.
/// With `left_handed`, the hands of the configuration are exchanged.
pub fn port_of(hand: Hand, asked: Option<&str>, config: &Config) -> Result<String> {
    let left = (hand == Hand::Left) != config.left_handed;
    let port = asked.unwrap_or(if left { &config.ports.left } else { &config.ports.right });
    check_name(port)?;
    if port.is_empty() || port == "keyboard" {
        bail!(
            "which port is the {hand} hand's board on? Give it with --port (`host-bridge list` shows the \
             ports), or under [ports] in a --config file"
        );
    }
    Ok(port.to_owned())
}

/// Refuses a Bluetooth port if this build has no Bluetooth.
pub fn check_name(port: &str) -> Result<()> {
    if cfg!(not(feature = "ble")) && is_ble(port) {
        bail!("'{port}': {NO_BLUETOOTH}; or connect the board with its USB cable");
    }
    Ok(())
}

/// The advice for a build without Bluetooth.
pub const NO_BLUETOOTH: &str = "this build has no Bluetooth link: `cargo install --path host-bridge --features ble` makes \
                                one (Debian: it needs the packages libdbus-1-dev and pkg-config), and the packaged \
                                archive has it";

/// The port of the only board with which a command communicates.
#[derive(clap::Args, Clone, Debug)]
pub struct PortOptions {
    /// The board's port, for example /dev/ttyACM0 or `ble[:NAME]`; `host-bridge list` lists all ports
    #[arg(long, visible_aliases = ["left", "right"])]
    pub port: Option<String>,
    /// Configuration file (TOML); `host-bridge run --print-config` writes one
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

impl PortOptions {
    /// Returns the port of this hand and its settings.
    pub fn resolve(&self, hand: Hand) -> Result<(String, SerialSettings)> {
        let config = read_config(self.config.as_deref())?;
        Ok((port_of(hand, self.port.as_deref(), &config)?, settings(&config, hand)))
    }
}
