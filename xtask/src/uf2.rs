//! UF2 is a file format that bootloaders accept when a file is copied to their drive.
//! A UF2 file has blocks of 512 bytes, each with its address.
//!
//! ```text
//! 0 magic  4 magic  8 flags  12 address  16 bytes  20 number  24 blocks  28 family  32 data (476)  508 magic
//! ```

/// Id of Nordic's nRF52840 in Microsoft's list of families.
pub const NRF52840: u32 = 0xADA5_2840;

const MAGIC: [u32; 2] = [0x0A32_4655, 0x9E5D_5157];
const END_MAGIC: u32 = 0x0AB1_6F30;
const HAS_FAMILY: u32 = 0x2000;
const BLOCK: usize = 512;
/// Number of image bytes per block. All bootloaders accept this number.
const PAYLOAD: usize = 256;

/// Returns the file for an image that starts at this address of flash.
/// The last piece is padded with bits of value 1, like erased flash.
pub fn encode(image: &[u8], address: u32, family: u32) -> Vec<u8> {
    let blocks = image.len().div_ceil(PAYLOAD);
    let mut file = Vec::with_capacity(blocks * BLOCK);
    for (number, piece) in image.chunks(PAYLOAD).enumerate() {
        let place = address + (number * PAYLOAD) as u32;
        let head =
            [MAGIC[0], MAGIC[1], HAS_FAMILY, place, PAYLOAD as u32, number as u32, blocks as u32, family];
        let start = file.len();
        file.extend(head.iter().flat_map(|word| word.to_le_bytes()));
        file.extend_from_slice(piece);
        file.resize(start + 32 + PAYLOAD, 0xFF);
        file.resize(start + BLOCK - 4, 0);
        file.extend(END_MAGIC.to_le_bytes());
    }
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_block_says_where_its_bytes_go() {
        let image: Vec<u8> = (0..600u32).map(|i| i as u8).collect();
        let file = encode(&image, 0x27000, NRF52840);
        assert_eq!(file.len(), 3 * 512);
        // The expected bytes follow the description of the format.
        assert_eq!(file[..8], *b"UF2\n\x57\x51\x5D\x9E");
        assert_eq!(file[512 + 12..512 + 16], 0x27100u32.to_le_bytes());
        assert_eq!(file[512 + 20..512 + 32], [1, 0, 0, 0, 3, 0, 0, 0, 0x40, 0x28, 0xA5, 0xAD]);
        assert_eq!(file[512 + 32..512 + 288], image[256..512]);
        assert_eq!(file[1024 + 32 + 88..1024 + 32 + 256], [0xFF; 168]);
        assert_eq!(file[1532..], [0x30, 0x6F, 0xB1, 0x0A]);
    }
}
