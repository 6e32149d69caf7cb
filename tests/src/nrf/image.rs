//! A linked firmware image: its flash content and the addresses of its functions.

use std::collections::BTreeMap;
use std::path::Path;

use object::read::elf::ElfFile32;
use object::{Object, ObjectSection, ObjectSegment, ObjectSymbol, SectionKind};
use shared_board::update;

/// A firmware image.
#[derive(Clone, Debug, Default)]
pub struct Image {
    /// Pieces of the image with their addresses in flash.
    pub pieces: Vec<(u32, Vec<u8>)>,
    /// Addresses of functions and objects by name.
    pub symbols: BTreeMap<String, u32>,
    /// Sizes in bytes of functions and objects, by name.
    pub sizes: BTreeMap<String, u32>,
    /// Address of the vector table.
    pub vector_table: u32,
    /// Size of the contents of flash in bytes.
    pub flash_bytes: u32,
    /// Size in bytes of the statics in RAM.
    pub ram_bytes: u32,
    /// Address of the second stage, if the image has one.
    pub second_stage: Option<u32>,
}

impl Image {
    /// Reads an ELF file.
    ///
    /// # Panics
    /// Panics if the file is not an image for this chip. An image from our own linker never causes this.
    pub fn load(path: &Path) -> Self {
        let data = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let file: ElfFile32<'_> = ElfFile32::parse(&*data).expect("an ELF file");
        let mut image = Self::default();
        for header in file.elf_program_headers() {
            use object::read::elf::ProgramHeader;
            let endian = file.endian();
            if header.p_type(endian) == object::elf::PT_LOAD && header.p_filesz(endian) > 0 {
                let bytes = header.data(endian, &*data).expect("inside the file").to_vec();
                image.flash_bytes += bytes.len() as u32;
                image.pieces.push((header.p_paddr(endian), bytes));
            }
        }
        let _ = file.segments().map(|s| s.address());
        for section in file.sections() {
            if section.name() == Ok(".vector_table") {
                image.vector_table = section.address() as u32;
            }
            let in_ram = (0x2000_0000..0x2004_0000).contains(&section.address());
            if in_ram && matches!(section.kind(), SectionKind::Data | SectionKind::UninitializedData) {
                image.ram_bytes += section.size() as u32;
            }
        }
        for symbol in file.symbols() {
            if let Ok(name) = symbol.name()
                && !name.is_empty()
                && !name.starts_with('$')
            {
                image.symbols.insert(name.to_string(), symbol.address() as u32);
                image.sizes.insert(name.to_string(), symbol.size() as u32);
            }
        }
        image
    }

    /// Combines the image with its second stage, which contains `key` if there is one.
    /// The bootloader then starts the second stage.
    ///
    /// # Panics
    /// Panics if the image is not linked for the address after the second stage.
    #[must_use]
    pub fn behind(mut self, stage: Self, key: Option<[u8; update::KEY_BYTES]>) -> Self {
        let base = stage.vector_table;
        assert_eq!(self.vector_table, base + update::SLOT_A, "the image is linked for slot A");
        self.pieces.extend(stage.pieces);
        self.pieces.extend(key.map(|key| (base + update::KEY_AT, key.to_vec())));
        (self.vector_table, self.second_stage) = (base, Some(base));
        self
    }

    /// Returns all bytes from the vector table to the end, as in a file for flashing.
    pub fn binary(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for (address, piece) in &self.pieces {
            let start = (address - self.vector_table) as usize;
            bytes.resize(bytes.len().max(start + piece.len()), 0);
            bytes[start..start + piece.len()].copy_from_slice(piece);
        }
        bytes
    }

    /// Returns the address of a function without the Thumb bit.
    ///
    /// # Panics
    /// Panics if the image has no such function.
    pub fn function(&self, name: &str) -> u32 {
        self.symbols.get(name).unwrap_or_else(|| panic!("the image has no `{name}`")) & !1
    }

    /// Returns the full names of the functions that contain all of these words.
    pub fn functions_with(&self, words: &[&str]) -> Vec<String> {
        self.symbols.keys().filter(|name| words.iter().all(|w| name.contains(w))).cloned().collect()
    }

    /// Returns a word of the image.
    pub fn word(&self, address: u32) -> Option<u32> {
        self.pieces.iter().find_map(|(start, bytes)| {
            let at = address.checked_sub(*start)? as usize;
            let b = bytes.get(at..at + 4)?;
            Some(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        })
    }
}
