#!/bin/sh
# Counts executed instructions, stack and flash of the right hand's arithmetic on a Cortex-M4F (QEMU's mps2-an386,
# -icount) and compares checksums of all results with those of this machine. Fails if they differ.
#
#     shared-dsp/bench-m4f/run.sh
#
# Needs qemu-system-arm, ld.lld, and a rustc that can build `core` from source (Debian's: rustc, rust-src).
set -eu
cd "$(dirname "$0")"
# The folder of the boards' images, which need the same `core`.
target=${CARGO_TARGET_DIR:-$(cd ../.. && pwd)/target}
export CARGO_TARGET_DIR="$target"
RUSTC=${BENCH_RUSTC:-/usr/bin/rustc} RUSTC_BOOTSTRAP=1 ${BENCH_CARGO:-/usr/bin/cargo} build --quiet --release \
    -Zbuild-std=core --target thumbv7em-none-eabihf --bins
images=$target/thumbv7em-none-eabihf/release
board=$(timeout 120 qemu-system-arm -M mps2-an386 -icount shift=10 -display none -monitor none -serial none \
    -semihosting-config enable=on,target=native -kernel "$images/count" 2>&1)
echo "$board"
flash() { size "$images/$1" | awk 'NR == 2 { print $1 + $2 }'; }
empty=$(flash empty)
echo "network_flash_growth_bytes=$(($(flash network) - empty))"
echo "features_flash_growth_bytes=$(($(flash window) - empty))"

# The same checks here. The bare-metal linker of .cargo/config.toml is for the other target only.
host=$(cargo run --quiet --release --manifest-path host/Cargo.toml)
echo "$board" | grep '^crc_' | sort > "$target/board.crc"
echo "$host" | sort > "$target/host.crc"
diff "$target/board.crc" "$target/host.crc" && echo "this machine and the board agree on all bits"
