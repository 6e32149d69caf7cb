#!/bin/sh
# Counts executed instructions, stack and flash of the right hand's arithmetic on a Cortex-M4F (QEMU's mps2-an386,
# -icount) and compares checksums of all results with those of this machine. Fails if they differ.
#
#     shared-dsp/bench-m4f/run.sh
#     shared-dsp/bench-m4f/run.sh sizes     # instead: the whole right hand with networks of four sizes
#
# Needs qemu-system-arm, ld.lld, and a rustc that can build `core` from source (Debian's: rustc, rust-src).
set -eu
cd "$(dirname "$0")"
# The folder of the boards' images, which need the same `core`.
target=${CARGO_TARGET_DIR:-$(cd ../.. && pwd)/target}
export CARGO_TARGET_DIR="$target"
features=
if [ "${1:-}" = sizes ]; then
    features="--features sizes"
fi
# shellcheck disable=SC2086 # no feature is no argument
RUSTC=${BENCH_RUSTC:-/usr/bin/rustc} RUSTC_BOOTSTRAP=1 ${BENCH_CARGO:-/usr/bin/cargo} build --quiet --release \
    -Zbuild-std=core --target thumbv7em-none-eabihf --bins $features
images=$target/thumbv7em-none-eabihf/release
emulate() {
    timeout 120 qemu-system-arm -M mps2-an386 -icount shift=10 -display none -monitor none -serial none \
        -semihosting-config enable=on,target=native -kernel "$images/$1" 2>&1
}
flash() { size "$images/$1" | awk 'NR == 2 { print $1 + $2 }'; }
empty=$(flash empty)
if [ -n "$features" ]; then
    emulate sizes
    echo "flash of features, network with the smallest blob, and decision: $(($(flash hand) - empty)) B"
    exit
fi
board=$(emulate count)
echo "$board"
echo "network_flash_growth_bytes=$(($(flash network) - empty))"
echo "features_flash_growth_bytes=$(($(flash window) - empty))"

# The same checks here. The bare-metal linker of .cargo/config.toml is for the other target only.
host=$(cargo run --quiet --release --manifest-path host/Cargo.toml)
echo "$board" | grep '^crc_' | sort > "$target/board.crc"
echo "$host" | sort > "$target/host.crc"
diff "$target/board.crc" "$target/host.crc" && echo "this machine and the board agree on all bits"
