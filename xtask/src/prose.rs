//! Checks the spelling, and the links in documents.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::steps::sh;
use crate::{python, root};

/// Checks that `typos` finds no errors, and that every link in a document leads to a file.
///
/// # Errors
/// Names each misspelt word and each broken link.
pub fn check() -> Result<()> {
    let python = python::environment()?;
    let typos = python.parent().context("the environment's folder")?.join("typos");
    sh(Command::new(typos).current_dir(root()).args(["--format", "brief"]))?;
    let broken: Vec<String> =
        documents(&root())?.iter().flat_map(|document| broken_links(document)).collect();
    if !broken.is_empty() {
        bail!("these links lead nowhere:\n{}", broken.join("\n"));
    }
    Ok(())
}

/// Returns all documents of the repository.
fn documents(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() && name != "target" && !name.starts_with('.') {
            found.extend(documents(&path)?);
        } else if name.ends_with(".md") {
            found.push(path);
        }
    }
    Ok(found)
}

/// Returns `DOCUMENT: LINK` for each relative link to a missing file.
fn broken_links(document: &Path) -> Vec<String> {
    let text = fs::read_to_string(document).unwrap_or_default();
    let folder = document.parent().unwrap_or(Path::new("."));
    let elsewhere =
        |link: &&str| link.contains("://") || link.starts_with("mailto:") || link.starts_with('#');
    let paths = links(&text).into_iter().filter(|link| !elsewhere(link));
    let missing = paths.filter(|link| !folder.join(link.split('#').next().unwrap_or_default()).exists());
    missing.map(|link| format!("{}: {link}", document.display())).collect()
}

/// Returns the targets of `[text](link)` that are not in code.
fn links(text: &str) -> Vec<&str> {
    let mut found = Vec::new();
    let mut in_code = false;
    for line in text.lines() {
        in_code ^= line.trim_start().starts_with("```");
        // Every second part of a line is between two backticks, so it is code.
        let prose = line.split('`').step_by(2);
        let parts = prose.flat_map(|part| part.split("](").skip(1)).filter(|_| !in_code);
        found.extend(parts.filter_map(|rest| rest.split_once(')')).map(|(link, _)| link));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_found_in_prose_and_not_in_code() {
        let text =
            "[a](a.md) and [`b`](b.md#c), `[no](c.md)`\n```\n[no](d.md)\n```\n![picture](docs/e.png)\n";
        assert_eq!(links(text), ["a.md", "b.md#c", "docs/e.png"]);
    }

    #[test]
    fn a_link_to_a_missing_file_is_named() {
        let folder = std::env::temp_dir().join(format!("bimanual-links-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let document = folder.join("a.md");
        fs::write(&document, "[here](a.md#there), [away](https://example.org), [gone](b.md)").unwrap();
        assert_eq!(broken_links(&document), [format!("{}: b.md", document.display())]);
        fs::remove_dir_all(&folder).unwrap();
    }
}
