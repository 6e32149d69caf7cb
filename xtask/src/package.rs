//! `cargo xtask package`: builds an archive for users without Rust.
//! The archive contains programs, firmware images, model, scenes, documents, licences and udev rules.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::steps::{output, sh};
use crate::test::cargo;
use crate::tools::{self, BLUETOOTH};
use crate::{firmware_avr, firmware_nano33, root, target_dir};

/// Files that have the same path in the archive as in the repository, so that links in documents work.
const FILES: [&str; 39] = [
    "CHANGELOG.md",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "docs/FILES.md",
    "docs/GLOSSARY.md",
    "docs/PAPER.md",
    "docs/SAFETY.md",
    "docs/SOURCES.md",
    "docs/START.md",
    "docs/page-dark.png",
    "docs/page-light.png",
    "docs/page.gif",
    "docs/ros2.md",
    "docs/sites.md",
    "docs/wiring.svg",
    "docs/zenoh/certificates.sh",
    "docs/zenoh/router.json5",
    "docs/zenoh/session.json5",
    "firmware-nano-avr/README.md",
    "firmware-nano-avr/wiring.svg",
    "firmware-nano33/README.md",
    "firmware-nano33/docs/swd-pads.svg",
    "firmware-nano33/sensor/NOTICE-Bosch.txt",
    "host-bridge/README.md",
    "host-bridge/scenes/bins.toml",
    "host-bridge/scenes/other-arm.toml",
    "host-bridge/scenes/other-arm.urdf",
    "host-bridge/scenes/pick-and-place.toml",
    "host-bridge/scenes/posts.toml",
    "host-bridge/scenes/room.toml",
    "host-bridge/scenes/shelf.toml",
    "host-bridge/crates/arm/src/plan/README.md",
    "models/README.md",
    "models/bundled/right-aligned.card.json",
    "models/bundled/right-aligned.float.tflite",
    "models/bundled/right-aligned.memory.bin",
    "models/bundled/right-aligned.tflite",
    "shared-proto/WIRE.md",
];
/// Files that have another path in the archive.
const MOVED: [(&str, &str); 2] = [
    ("xtask/package/INSTALL.txt", "INSTALL.txt"),
    ("xtask/package/60-bimanual.rules", "udev/60-bimanual.rules"),
];
/// A program or image in the archive, with cargo's name for it and the machine that runs it.
const PARTS: [(&[&str], &str); 5] = [
    (&["-p", "host-bridge", "-p", "models", "--all-features"], "x86_64-unknown-linux-gnu"),
    (&["--manifest-path", "firmware-nano-avr/Cargo.toml"], "avr-none"),
    (
        &[
            "--manifest-path",
            "firmware-nano33/Cargo.toml",
            "--no-default-features",
            "--features",
            "bootloader",
        ],
        "thumbv7em-none-eabihf",
    ),
    // Both images for S140.
    (&["--manifest-path", "firmware-nano33/Cargo.toml", "--features", "xiao"], "thumbv7em-none-eabihf"),
    // Both images that have Bluetooth linked in.
    (
        &[
            "--manifest-path",
            "firmware-nano33/Cargo.toml",
            "--no-default-features",
            "--features",
            "trouble,xiao",
        ],
        "thumbv7em-none-eabihf",
    ),
];
/// Crates whose licence is a separate file.
/// We have read these licences: an archive that contains the file may contain the crate.
/// Nordic's five-clause licence applies to its interface of S140 and to its controller.
/// This licence permits images for Nordic's chips to include them.
const LICENCE_FILES: [(&str, &str); 3] = [
    ("nrf-softdevice-s140", "Nordic's five clauses"),
    ("nrf-sdc-sys", "Nordic's five clauses"),
    ("nrf-mpsl-sys", "Nordic's five clauses"),
];
/// Licence texts that crates store below a folder of their own.
const DEEPER_TEXTS: [&str; 6] = [
    "P256-Cortex-M4/LICENSE.txt",
    "third_party/nordic/nrfxlib/LICENSE",
    "third_party/nordic/nrfxlib/mpsl/LICENSE-ATTRIBUTION.txt",
    "third_party/nordic/nrfxlib/mpsl/license.txt",
    "third_party/nordic/nrfxlib/softdevice_controller/license.txt",
    "third_party/nordic/nrfx/LICENSE",
];
/// Notices about contents that the crate of a part does not declare.
const MORE_NOTICES: [&str; 1] = ["firmware-nano33/sensor/NOTICE-Bosch.txt"];
const PROGRAMS: [&str; 2] = ["host-bridge", "models"];

/// Builds the archive under `target/package`, unpacks it once and runs its programs.
///
/// # Errors
/// Fails if a program does not build, a file is missing, or the unpacked programs do not run.
pub fn run() -> Result<()> {
    ensure!(
        cfg!(all(target_os = "linux", target_arch = "x86_64")),
        "the archive is for Linux on x86-64: make it there; elsewhere `cargo install --path host-bridge`"
    );
    tools::ensure(&[&BLUETOOTH])?;
    // Builds with all features, including optional ones such as Bluetooth.
    sh(&mut cargo(&["build", "--release", "--locked", "-p", "host-bridge", "--all-features", "--bins"]))?;
    sh(&mut cargo(&["build", "--release", "--locked", "-p", "models", "--bins"]))?;
    let name = format!("bimanual-{}-x86_64-linux", env!("CARGO_PKG_VERSION"));
    let place = target_dir().join("package");
    let folder = place.join(&name);
    if folder.exists() {
        fs::remove_dir_all(&folder)?;
    }
    for (from, to) in FILES.into_iter().map(|file| (file, file)).chain(MOVED) {
        copy(&root().join(from), &folder.join(to))?;
    }
    images(&folder.join("firmware"))?;
    for program in PROGRAMS {
        let to = folder.join("bin").join(program);
        copy(&target_dir().join("release").join(program), &to)?;
        // Only developers need line tables. If binutils is missing, the tables remain.
        let _ = Command::new("strip").arg(&to).status();
    }
    let mut trees = String::new();
    for (options, target) in PARTS {
        let mut tree = cargo(&["tree", "--locked", "--edges", "normal", "--prefix", "none", "--no-dedupe"]);
        trees += &output(tree.args(["--format", "{p}: {l}", "--target", target]).args(options))?;
    }
    fs::write(folder.join("LICENCES-OF-PARTS.txt"), notices(&parts(&trees)?)?)?;
    let archive = place.join(format!("{name}.tar.gz"));
    // The same content must give an archive with the same bytes.
    let mut tar = Command::new("tar");
    tar.args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "--mtime=@0", "--mode=u+rw,go=rX"]);
    sh(tar.arg("-C").arg(&place).arg("-czf").arg(&archive).arg(&name))?;
    try_out(&archive, &name, &place.join("unpacked"))?;
    println!("{} ({:.1} MB)", archive.display(), fs::metadata(&archive)?.len() as f64 / 1e6);
    Ok(())
}

/// Writes the firmware images in the formats that avrdude and bossac read.
fn images(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder)?;
    firmware_avr::run(&["--no-stack"])?;
    copy(&firmware_avr::image().with_extension("hex"), &folder.join("nano.hex"))?;
    firmware_nano33::run(&[])?;
    for (variant, format, name) in
        [("bootloader", "binary", "nano33-bootloader.bin"), ("ble", "ihex", "nano33-s140.hex")]
    {
        firmware_nano33::objcopy(&firmware_nano33::image(variant), format, &folder.join(name))?;
    }
    for (variant, end, name) in [
        ("trouble", "bin", "nano33-trouble"),
        ("trouble", "update", "nano33-trouble"),
        ("xiao-trouble", "update", "xiao-trouble"),
        ("xiao-trouble", "uf2", "xiao-trouble"),
        ("xiao-left", "update", "xiao-left"),
        ("xiao-left", "uf2", "xiao-left"),
        ("xiao", "uf2", "xiao"),
    ] {
        let file = firmware_nano33::image(variant).with_extension(end);
        copy(&file, &folder.join(name).with_extension(end))?;
    }
    Ok(())
}

fn copy(from: &Path, to: &PathBuf) -> Result<()> {
    fs::create_dir_all(to.parent().context("a folder")?)?;
    fs::copy(from, to).with_context(|| format!("{} is not there", from.display()))?;
    Ok(())
}

/// A third-party crate in the programs, as `name vVERSION`, and the licence of this crate.
type Part<'a> = (&'a str, &'a str);

/// Returns the crates of other projects, each once.
fn parts(tree: &str) -> Result<Vec<Part<'_>>> {
    let ours = |line: &&str| line.contains("(/");
    let mut parts = Vec::new();
    for line in tree.lines().filter(|line| !line.trim().is_empty() && !ours(line)) {
        let (part, licence) = line.split_once(": ").unwrap_or((line.trim_end_matches(':'), ""));
        let name = part.split(' ').next().unwrap_or("");
        let by_file = LICENCE_FILES.iter().find(|(of, _)| *of == name && licence.trim().is_empty());
        let licence = by_file.map_or(licence, |(_, licence)| licence);
        // If a crate has several licences, one suffices. A slash may also separate them.
        let free = licence
            .split(" OR ")
            .flat_map(|l| l.split('/'))
            .any(|l| !l.trim().is_empty() && !l.contains("GPL"));
        ensure!(free, "{line}: a part without a licence, or with one that the archive must not carry");
        parts.push((part.trim_end_matches(" (proc-macro)"), licence));
    }
    parts.sort_unstable();
    parts.dedup();
    Ok(parts)
}

/// Returns all parts with their licences, and each licence text in their packages once.
fn notices(parts: &[Part<'_>]) -> Result<String> {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let home =
        home.or_else(|| std::env::home_dir().map(|home| home.join(".cargo"))).context("no CARGO_HOME")?;
    let mut sources = Vec::new();
    for registry in fs::read_dir(home.join("registry/src")).context("cargo keeps its sources elsewhere")? {
        sources.push(registry?.path());
    }
    let mut texts: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    let mut list = String::new();
    for (part, licence) in parts {
        let folder = part.replace(" v", "-");
        let folder = sources.iter().map(|registry| registry.join(&folder)).find(|folder| folder.is_dir());
        let folder = folder.with_context(|| format!("the sources of {part} are not there"))?;
        list += &format!("{part}: {licence}\n");
        let mut files: Vec<PathBuf> = DEEPER_TEXTS.iter().map(|file| folder.join(file)).collect();
        for file in fs::read_dir(folder)? {
            let file = file?;
            let name = file.file_name().to_string_lossy().to_uppercase();
            let tells = ["LICENSE", "LICENCE", "COPYING", "COPYRIGHT", "NOTICE", "UNLICENSE"];
            if tells.iter().any(|word| name.starts_with(word)) {
                files.push(file.path());
            }
        }
        for file in files.into_iter().filter(|file| file.is_file()) {
            let text = String::from_utf8_lossy(&fs::read(file)?).trim_end().to_owned();
            texts.entry(text).or_default().push(part);
        }
    }
    let mut all = format!("Programs and images are built from these crates:\n\n{list}");
    for (text, of) in &texts {
        all += &format!("\n{}\n{}\n\n{text}\n", "=".repeat(80), of.join(", "));
    }
    for file in MORE_NOTICES {
        all += &format!("\n{}\n{}", "=".repeat(80), fs::read_to_string(root().join(file))?);
    }
    Ok(all)
}

/// Unpacks the archive and runs its programs, as a user would.
fn try_out(archive: &Path, name: &str, into: &Path) -> Result<()> {
    if into.exists() {
        fs::remove_dir_all(into)?;
    }
    fs::create_dir_all(into)?;
    sh(Command::new("tar").arg("-C").arg(into).arg("-xzf").arg(archive))?;
    let bin = into.join(name).join("bin");
    let home = into.join("an-empty-folder");
    fs::create_dir(&home)?;
    let program = |name: &str| {
        let mut command = Command::new(bin.join(name));
        command.current_dir(&home).env("HOME", &home);
        command
    };
    for name in PROGRAMS {
        print!("{}", output(program(name).arg("--version"))?);
    }
    // The demo records a session file, so that MCAP is tested too.
    let demo = ["demo", "--headless", "--speed", "0", "--json", "--record", "demo.mcap"];
    let demo = output(program("host-bridge").args(demo))?;
    ensure!(demo.contains("\"ok\":true"), "the unpacked demo does not come out as scripted:\n{demo}");
    let urdf = into.join(name).join("host-bridge/scenes/other-arm.toml");
    output(
        program("host-bridge").args(["demo", "--headless", "--speed", "0", "--json", "--scene"]).arg(urdf),
    )?;
    // These commands only read and report, whatever devices and nodes exist.
    for (words, said) in [
        (&["list"][..], "Bluetooth"),
        (&["doctor", "--right", "ble"], "Bluetooth"),
        (&["doctor", "--ros2", "--seconds", "1"], "ROS 2: domain"),
    ] {
        let found = program("host-bridge")
            .args(words)
            .env("DBUS_SYSTEM_BUS_ADDRESS", "unix:path=/nonexistent")
            .output()?;
        let text =
            String::from_utf8_lossy(&found.stdout).into_owned() + &String::from_utf8_lossy(&found.stderr);
        ensure!(text.contains(said) && !text.contains("--features"), "{words:?}: no {said} in it: {text}");
        println!("host-bridge {}: {}", words.join(" "), text.trim());
    }
    Ok(fs::remove_dir_all(into)?)
}

#[cfg(test)]
mod tests {
    use super::{MOVED, parts};

    /// In 73-seat-late.rules, systemd gives the local user access to ports with a tag. An earlier rule must set this tag.
    #[test]
    fn the_udev_rule_is_read_in_time_and_knows_every_board() {
        let (from, to) = MOVED.into_iter().find(|(from, _)| from.ends_with(".rules")).unwrap();
        let name = to.rsplit('/').next().unwrap();
        assert!(name < "73-seat-late.rules", "{name}");
        let rules = std::fs::read_to_string(crate::root().join(from)).unwrap();
        for (vendor, product) in [
            ("2341", ""),
            ("2a03", ""),
            ("239a", ""),
            ("2886", "0045"),
            ("2886", "8045"),
            ("0403", "6001"),
            ("1a86", "7523"),
            ("1a86", "7522"),
            ("1a86", "5523"),
            ("1a86", "55d4"),
            ("10c4", "ea60"),
        ] {
            let line = rules.lines().find(|line| {
                line.contains(&format!("idVendor}}==\"{vendor}\""))
                    && (product.is_empty() || line.contains(&format!("idProduct}}==\"{product}\"")))
            });
            assert!(line.is_some_and(|line| line.contains("TAG+=\"uaccess\"")), "{vendor}:{product}");
        }
    }

    #[test]
    fn one_free_licence_is_enough_and_none_is_not() {
        let tree = "b v2.0.0: MIT OR GPL-3.0-only\n\na v1.0.0 (proc-macro): MIT/Apache-2.0\nb v2.0.0: MIT OR GPL-3.0-only\nours v0.1.0 (/here): \n";
        assert_eq!(
            parts(tree).unwrap(),
            [("a v1.0.0", "MIT/Apache-2.0"), ("b v2.0.0", "MIT OR GPL-3.0-only")]
        );
        assert_eq!(
            parts("nrf-softdevice-s140 v0.1.2: \nnrf-sdc-sys v0.3.0: \nnrf-mpsl-sys v0.3.0: \n")
                .unwrap()
                .len(),
            3
        );
        for tree in
            ["c v1.0.0: GPL-2.0-only\n", "c v1.0.0: LGPL-2.1 OR GPL-3.0\n", "c v1.0.0:\n", "c v1.0.0: \n"]
        {
            assert!(parts(tree).is_err(), "{tree}");
        }
    }
}
