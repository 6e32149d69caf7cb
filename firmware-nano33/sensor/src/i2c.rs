//! Accesses 8-bit registers of an I2C device.

use embedded_hal_async::i2c::I2c;

use crate::ImuError;

/// The address of a register, and the value to write.
pub(crate) type Setting = (u8, u8);

pub(crate) async fn write<I: I2c>(i2c: &mut I, address: u8, bytes: &[u8]) -> Result<(), ImuError> {
    i2c.write(address, bytes).await.map_err(|_| ImuError::Bus(address))
}

pub(crate) async fn read_into<I: I2c>(
    i2c: &mut I,
    address: u8,
    register: u8,
    bytes: &mut [u8],
) -> Result<(), ImuError> {
    i2c.write_read(address, &[register], bytes).await.map_err(|_| ImuError::Bus(address))
}

pub(crate) async fn read<const N: usize, I: I2c>(
    i2c: &mut I,
    address: u8,
    register: u8,
) -> Result<[u8; N], ImuError> {
    let mut bytes = [0; N];
    read_into(i2c, address, register, &mut bytes).await?;
    Ok(bytes)
}

/// Writes the settings one after another.
pub(crate) async fn set<I: I2c>(i2c: &mut I, address: u8, settings: &[Setting]) -> Result<(), ImuError> {
    for &(register, value) in settings {
        write(i2c, address, &[register, value]).await?;
    }
    Ok(())
}

/// Reads the settings back. A lost write could otherwise silently leave a different measuring range in effect.
pub(crate) async fn verify<I: I2c>(i2c: &mut I, address: u8, settings: &[Setting]) -> Result<(), ImuError> {
    for &(register, value) in settings {
        if read::<1, _>(i2c, address, register).await? != [value] {
            return Err(ImuError::Reset(address));
        }
    }
    Ok(())
}

/// Decodes three little-endian 16-bit numbers.
pub(crate) fn triple(bytes: &[u8]) -> [i16; 3] {
    core::array::from_fn(|axis| i16::from_le_bytes([bytes[2 * axis], bytes[2 * axis + 1]]))
}
