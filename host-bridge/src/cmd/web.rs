//! Options for the web page and Foxglove, used by all commands that move a robot.

use std::fs::File;
use std::io::{BufRead, BufReader, Read as _, Write as _};
use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::OnceLock;

use anyhow::{Context as _, Result};
use host_bridge::foxglove::{Foxglove, FoxgloveOptions};
use host_bridge::topics::Origin;
use host_bridge::web::{DEFAULT_PORT, Web, WebError, WebOptions};

/// Whether and where to serve the page.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct WebArgs {
    /// Show the session on a page for the browser, on 127.0.0.1 (port 8042; 0 = any free one)
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "8042")]
    web: Option<u16>,
    /// Serve the live session to Foxglove on 127.0.0.1 (port 8765; 0 = any free one)
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "8765")]
    foxglove: Option<u16>,
    /// Another page that may watch like Foxglove, such as http://localhost:8080 (repeatable)
    #[arg(long, value_name = "ORIGIN", requires = "foxglove")]
    foxglove_origin: Vec<String>,
    /// Let other machines use the page with its stop button, and Foxglove's port:
    /// listen on this address (0.0.0.0 = all); needs --web-token
    #[arg(long, value_name = "ADDR")]
    web_listen: Option<IpAddr>,
    /// Token that a page must send: at least 16 letters and digits.
    /// Other users of this machine can read it in the list of processes,
    /// so prefer --web-token-file or the variable BIMANUAL_WEB_TOKEN
    #[arg(long, value_name = "TOKEN", conflicts_with = "web_token_file")]
    web_token: Option<String>,
    /// File whose first line is the token, - for standard input.
    /// The token is sent unencrypted, so outside your own network forward the port over ssh instead
    #[arg(long, value_name = "FILE")]
    web_token_file: Option<PathBuf>,
}

/// Variable with the token, which only its owner can read.
const TOKEN_VARIABLE: &str = "BIMANUAL_WEB_TOKEN";

impl WebArgs {
    /// Starts the server if it was requested. With `unasked`, it starts without a request if a port is free.
    /// With `marks`, the pages can mark episodes.
    pub fn start(&self, unasked: bool, marks: bool) -> Result<Option<Web>> {
        let rules = self.web_listen.is_some() || self.web_token.is_some() || self.web_token_file.is_some();
        if self.web_token.is_some() {
            // Nobody may be reading the output.
            let _ = writeln!(
                std::io::stderr(),
                "--web-token shows the token to everybody on this machine who lists its processes: give it with \
                 --web-token-file FILE, or in {TOKEN_VARIABLE}"
            );
        }
        // Access options also imply the page, unless they belong only to Foxglove.
        if self.web.is_none() && (!rules || self.foxglove.is_some()) {
            let options = [WebOptions::default(), WebOptions { port: 0, ..WebOptions::default() }];
            return Ok(options.iter().filter(|_| unasked).find_map(|options| Web::start(options).ok()));
        }
        let options = self.options(self.web.unwrap_or(DEFAULT_PORT))?;
        let started: Result<Web, WebError> = Web::start_with(&options, marks);
        Ok(Some(started?))
    }

    /// Starts serving Foxglove if it was requested.
    pub fn start_foxglove(&self, origin: Origin) -> Result<Option<Foxglove>> {
        let Some(port) = self.foxglove else { return Ok(None) };
        let options = FoxgloveOptions { server: self.options(port)?, origins: self.foxglove_origin.clone() };
        Ok(Some(Foxglove::start(&options, origin)?))
    }

    fn options(&self, port: u16) -> Result<WebOptions> {
        let address = self.web_listen.unwrap_or(WebOptions::default().address);
        Ok(WebOptions { address, port, token: self.token()? })
    }

    /// Reads the token once from the command line, a file, or the environment.
    fn token(&self) -> Result<Option<String>> {
        static READ: OnceLock<String> = OnceLock::new();
        let Some(file) = &self.web_token_file else {
            let set = || std::env::var(TOKEN_VARIABLE).ok().filter(|token| !token.is_empty());
            return Ok(self.web_token.clone().or_else(set));
        };
        if let Some(token) = READ.get() {
            return Ok(Some(token.clone()));
        }
        let about = || format!("--web-token-file {}: no token can be read", file.display());
        let mut line = String::new();
        let mut reader: Box<dyn BufRead> = if file.as_os_str() == "-" {
            Box::new(std::io::stdin().lock())
        } else {
            Box::new(BufReader::new(File::open(file).with_context(about)?))
        };
        reader.by_ref().take(LINE_MAX).read_line(&mut line).with_context(about)?;
        Ok(Some(READ.get_or_init(|| line.trim().to_owned()).clone()))
    }
}

/// Maximum length of a token, including its line end.
const LINE_MAX: u64 = 200;

/// Returns whether the user has a screen for a browser.
pub fn has_display() -> bool {
    let set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    cfg!(any(windows, target_os = "macos")) || set("DISPLAY") || set("WAYLAND_DISPLAY")
}
