//! Programs that the tests need in addition to Rust, and their installation.

use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

/// Debian packages for one purpose.
pub struct Packages {
    /// What they are for.
    pub purpose: &'static str,
    names: &'static [&'static str],
}

/// Compilers for the boards, which are needed if rustup has none.
pub const CROSS_RUST: Packages = Packages {
    purpose: "compilers for the boards",
    names: &["rustc-web", "cargo-web", "rust-web-src", "rust-web-clippy"],
};

/// Linkers for the boards.
pub const CROSS_LINK: Packages = Packages {
    purpose: "linking the boards' images",
    names: &["lld", "gcc-avr", "avr-libc", "binutils-avr"],
};

/// An emulator of a Cortex-M4F, which counts instructions.
pub const QEMU: Packages =
    Packages { purpose: "counting instructions on a Cortex-M4F", names: &["qemu-system-arm"] };

/// A browser for testing the page, with fonts.
pub const BROWSER: Packages =
    Packages { purpose: "the page in a browser", names: &["chromium", "fonts-dejavu-core"] };

/// Libraries that the emulated boards and the simulated Bluetooth need.
pub const EMULATORS: Packages = Packages {
    purpose: "emulated boards and Bluetooth's double",
    names: &[
        "libclang-dev",
        "clang",
        "libelf-dev",
        "libzstd-dev",
        "libunicorn-dev",
        "pkg-config",
        "libdbus-1-dev",
        "dbus-daemon",
    ],
};

/// Tools other than Rust that the images with Bluetooth linked in need.
pub const C_FOR_BOARDS: Packages =
    Packages { purpose: "Bluetooth linked into the boards' images", names: &["libclang-dev", "clang"] };

/// Tools with which a test creates its own lossy networks.
pub const NETWORK: Packages =
    Packages { purpose: "networks with losses", names: &["iproute2", "iptables", "util-linux"] };

/// Libraries for Bluetooth in the packaged programs.
pub const BLUETOOTH: Packages =
    Packages { purpose: "Bluetooth on the laptop", names: &["libdbus-1-dev", "pkg-config"] };

impl Packages {
    /// Returns the command that a user must type.
    pub fn install_line(&self) -> String {
        format!("sudo apt-get install {}", self.names.join(" "))
    }

    fn missing(&self) -> Vec<&'static str> {
        self.names.iter().copied().filter(|name| !is_installed(name)).collect()
    }

    /// Whether nothing is missing.
    pub fn is_complete(&self) -> bool {
        self.missing().is_empty()
    }
}

/// Installs missing packages if no questions are necessary (as root on Debian). Otherwise, the error names them.
///
/// # Errors
/// Returns the missing packages with their purpose, and the command that installs them.
pub fn ensure(wanted: &[&Packages]) -> Result<()> {
    let missing: Vec<&str> = wanted.iter().flat_map(|packages| packages.missing()).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let can_install =
        is_root() && Command::new("apt-get").arg("--version").stdout(Stdio::null()).status().is_ok();
    if !can_install {
        let list = |p: &&&Packages| format!("  {}: {}", p.purpose, p.missing().join(" "));
        let lists: Vec<String> = wanted.iter().filter(|p| !p.is_complete()).map(|p| list(&p)).collect();
        bail!(
            "missing for\n{}\n  On Debian or Ubuntu: sudo apt-get install {}\n  Elsewhere: the packages of the same purpose.",
            lists.join("\n"),
            missing.join(" ")
        );
    }
    eprintln!("installing: {}", missing.join(" "));
    apt_get(&["update", "-qq"])?;
    let mut args = vec!["install", "-y", "-qq", "--no-install-recommends"];
    args.extend(missing);
    apt_get(&args)
}

/// Does the same as [`ensure`] on systems with Debian's packages.
/// Elsewhere, tools may have other names, and the build reports what is missing.
///
/// # Errors
/// As [`ensure`].
pub fn ensure_where_known(wanted: &Packages) -> Result<()> {
    let known = Command::new("dpkg-query").arg("--version").output().is_ok_and(|o| o.status.success());
    if known { ensure(&[wanted]) } else { Ok(()) }
}

fn apt_get(args: &[&str]) -> Result<()> {
    let status = Command::new("apt-get")
        .args(args)
        .env("DEBIAN_FRONTEND", "noninteractive")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .status()
        .context("apt-get does not start")?;
    if !status.success() {
        bail!("apt-get {} failed", args.join(" "));
    }
    Ok(())
}

fn is_installed(package: &str) -> bool {
    Command::new("dpkg-query")
        .args(["-W", "-f", "${Status}", package])
        .stderr(Stdio::null())
        .output()
        .is_ok_and(|o| o.status.success() && o.stdout.ends_with(b"ok installed"))
}

fn is_root() -> bool {
    Command::new("id").arg("-u").output().is_ok_and(|o| o.stdout.trim_ascii() == b"0")
}
