#!/bin/sh
# Flashes the image that cargo hands over: `cargo run --release`.
#   BIMANUAL_PORT  the Nano's serial port, such as /dev/ttyUSB0 (needed)
#   BIMANUAL_BAUD  115200 for the new bootloader (default), 57600 for the old one
set -eu
elf=$1
if [ -z "${BIMANUAL_PORT:-}" ]; then
    echo "error: which port? Set BIMANUAL_PORT, such as: BIMANUAL_PORT=/dev/ttyUSB0 cargo run --release" >&2
    found=$(ls /dev/ttyUSB* /dev/ttyACM* /dev/cu.usb* /dev/cu.wch* 2>/dev/null | tr '\n' ' ')
    if [ -n "$found" ]; then
        echo "  ports here now: $found" >&2
    else
        echo "  no serial port is here now: plug the Nano in (some cables carry power only)" >&2
    fi
    exit 2
fi
if ! command -v avrdude >/dev/null; then
    echo "error: avrdude is missing. Debian: apt install avrdude; macOS: brew install avrdude" >&2
    exit 2
fi
baud=${BIMANUAL_BAUD:-115200}
hex="$elf.hex"
avr-objcopy -O ihex -R .eeprom "$elf" "$hex"
echo "avrdude -p atmega328p -c arduino -P $BIMANUAL_PORT -b $baud -D -U flash:w:$hex:i"
if ! avrdude -p atmega328p -c arduino -P "$BIMANUAL_PORT" -b "$baud" -D -U "flash:w:$hex:i"; then
    if [ "$baud" = 115200 ]; then
        echo "hint: many clones carry the old bootloader; try BIMANUAL_BAUD=57600" >&2
    fi
    echo "hint: is the port open elsewhere, and may you use it (Linux: group dialout)?" >&2
    exit 1
fi
