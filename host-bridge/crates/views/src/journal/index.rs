//! Adds the index to recordings that were killed.
//!
//! A session's file is valid after every write ([`super::sink`]).
//! However, readers that jump within a file need the index at its end.
//! The index is written when the file is closed.
//! The next program start adds the index: it copies the messages to a new file, which then replaces the old one.
//! A file that is still being written is locked, and is not changed.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufWriter, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use mcap::records::Record;
use mcap::{McapError, WriteOptions, Writer};

use super::records::records;

use super::sink::END;

/// Adds the index to a file of ours that was not closed. Returns true if it added one.
///
/// # Errors
/// Fails if the file cannot be read or written. The file is then unchanged.
pub fn complete(file: &Path) -> Result<bool, String> {
    let about = |error: &dyn std::fmt::Display| format!("{}: {error}", file.display());
    let mut old = File::open(file).map_err(|error| about(&error))?;
    let length = old.metadata().map_err(|error| about(&error))?.len();
    let mut end = [0; END.len()];
    if length < END.len() as u64
        || old.seek(SeekFrom::End(-(END.len() as i64))).is_err()
        || old.read_exact(&mut end).is_err()
        || end != END
        // Somebody is writing it.
        || old.try_lock_shared().is_err()
    {
        return Ok(false);
    }
    let bytes = std::fs::read(file).map_err(|error| about(&error))?;
    let part = part_of(file);
    let copied = copy(&bytes, &part).map_err(|error| error.to_string());
    let renamed = copied.and_then(|()| std::fs::rename(&part, file).map_err(|error| error.to_string()));
    if let Err(error) = renamed {
        let _ = std::fs::remove_file(&part);
        return Err(about(&error));
    }
    Ok(true)
}

/// Like [`complete`], for all files in the folder of `file`. Returns the completed files and all errors.
pub fn complete_beside(file: &Path) -> Vec<Result<PathBuf, String>> {
    let folder = match file.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|file| file.extension().is_some_and(|ending| ending == "mcap") && file.is_file());
    files.sort();
    let one = |file: PathBuf| match complete(&file) {
        Ok(true) => Some(Ok(file)),
        Ok(false) => None,
        Err(error) => Some(Err(error)),
    };
    files.into_iter().filter_map(one).collect()
}

fn part_of(file: &Path) -> PathBuf {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    file.with_file_name(name)
}

/// Copies all readable contents of the file to a new one and closes it.
fn copy(bytes: &[u8], to: &Path) -> Result<(), McapError> {
    let mut out = BufWriter::new(File::create(to)?);
    {
        let mut library = String::new();
        let mut profile = String::new();
        let mut writer: Option<Writer<&mut BufWriter<File>>> = None;
        let mut target = Some(&mut out);
        let mut schemas = HashMap::from([(0, 0)]);
        let mut channels = HashMap::new();
        for record in records(bytes)? {
            // Any data after this damaged place had already been lost.
            let Ok(record) = record else { break };
            if let Record::Header(header) = &record {
                (library, profile) = (header.library.clone(), header.profile.clone());
            }
            if writer.is_none()
                && let Some(target) = target.take()
            {
                let options =
                    WriteOptions::new().profile(profile.clone()).library(library.clone()).compression(None);
                writer = Some(options.create(target)?);
            }
            let Some(writer) = &mut writer else { break };
            match record {
                Record::Metadata(metadata) => writer.write_metadata(&metadata)?,
                Record::Schema { header, data } => {
                    let id = writer.add_schema(&header.name, &header.encoding, &data)?;
                    schemas.insert(header.id, id);
                }
                Record::Channel(channel) => {
                    let schema = schemas.get(&channel.schema_id).copied().unwrap_or_default();
                    let metadata: &BTreeMap<String, String> = &channel.metadata;
                    let id =
                        writer.add_channel(schema, &channel.topic, &channel.message_encoding, metadata)?;
                    channels.insert(channel.id, id);
                }
                Record::Message { mut header, data } => {
                    if let Some(&id) = channels.get(&header.channel_id) {
                        header.channel_id = id;
                        writer.write_to_known_channel(&header, &data)?;
                    }
                }
                _ => {}
            }
        }
        match &mut writer {
            Some(writer) => writer.finish().map(drop)?,
            None => return Err(McapError::BadMagic),
        }
    }
    out.into_inner().map_err(|error| McapError::Io(error.into_error()))?.sync_all()?;
    Ok(())
}
