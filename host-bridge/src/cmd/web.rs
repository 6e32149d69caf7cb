//! Options of the page, shared by the verbs that move a robot.

use std::net::IpAddr;

use anyhow::Result;
use host_bridge::web::{DEFAULT_PORT, Web, WebError, WebOptions};

/// Whether and where to serve the page.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct WebArgs {
    /// Show the session on a page for the browser, on 127.0.0.1 (port 8042; 0 = any free one)
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "8042")]
    web: Option<u16>,
    /// Let other machines have the page, with its stop button: listen on this address (0.0.0.0 = all);
    /// needs --web-token
    #[arg(long, value_name = "ADDR")]
    web_listen: Option<IpAddr>,
    /// What a page must know: 16 or more letters and digits. It crosses the network as it is: for more
    /// than your own network forward the port over ssh instead
    #[arg(long, value_name = "TOKEN")]
    web_token: Option<String>,
}

impl WebArgs {
    /// Starts the server if it was asked for; `unasked` also without that, where a port is to be had.
    pub fn start(&self, unasked: bool) -> Result<Option<Web>> {
        let asked = self.web.is_some() || self.web_listen.is_some() || self.web_token.is_some();
        if !asked {
            let options = [WebOptions::default(), WebOptions { port: 0, ..WebOptions::default() }];
            return Ok(options.iter().filter(|_| unasked).find_map(|options| Web::start(options).ok()));
        }
        let options = WebOptions {
            address: self.web_listen.unwrap_or(WebOptions::default().address),
            port: self.web.unwrap_or(DEFAULT_PORT),
            token: self.web_token.clone(),
        };
        let started: Result<Web, WebError> = Web::start(&options);
        Ok(Some(started?))
    }
}

/// Somebody sits before a screen that can show a browser.
pub fn has_display() -> bool {
    let set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    cfg!(any(windows, target_os = "macos")) || set("DISPLAY") || set("WAYLAND_DISPLAY")
}
