//! The image under test is exactly the file that `cargo xtask firmware avr` builds and that users flash.

use std::path::PathBuf;
use std::sync::OnceLock;

use object::{Object, ObjectSection, ObjectSymbol};

/// Returns the path of the image and builds it if necessary. `BIMANUAL_AVR_ELF` selects another image.
///
/// # Panics
/// Panics if the image does not build. The terminal shows the reason.
pub fn path() -> PathBuf {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| {
        if let Some(path) = std::env::var_os("BIMANUAL_AVR_ELF") {
            return path.into();
        }
        crate::firmware::build(&["avr", "--no-stack"], "avr-none/release/firmware-nano-avr.elf")
    })
    .clone()
}

/// Returns the first address after the image's static memory (`__heap_start`). The stack may grow down to it.
///
/// # Panics
/// Panics if the image cannot be read.
pub fn static_end() -> usize {
    let bytes = std::fs::read(path()).expect("the image is there");
    let file = object::File::parse(&*bytes).expect("the image is an ELF file");
    let symbol = file.symbols().find(|s| s.name() == Ok("__heap_start")).expect("the linker sets it");
    (symbol.address() & 0xFFFF) as usize
}

/// Returns the address of `_exit`, where the C runtime ends with `cli` and an endless loop.
///
/// # Panics
/// Panics for the same reason as [`static_end`].
pub fn stop_program() -> u32 {
    let bytes = std::fs::read(path()).expect("the image is there");
    let file = object::File::parse(&*bytes).expect("the image is an ELF file");
    file.symbols().find(|s| s.name() == Ok("_exit")).expect("the C runtime has it").address() as u32
}

/// Size of flash and of static RAM in bytes, according to the image's sections.
///
/// # Panics
/// Panics for the same reason as [`static_end`].
pub fn size() -> (u64, u64) {
    let bytes = std::fs::read(path()).expect("the image is there");
    let file = object::File::parse(&*bytes).expect("the image is an ELF file");
    let section = |name| file.section_by_name(name).map_or(0, |s| s.size());
    let data = section(".data");
    (section(".text") + data, data + section(".bss") + section(".noinit"))
}
