//! Virtual time, counted in cycles of the 64 MHz clock.

/// Cycles per second.
pub const HZ: u64 = 64_000_000;

/// Converts microseconds to cycles.
pub const fn us(us: u64) -> u64 {
    us * 64
}

/// Converts milliseconds to cycles.
pub const fn ms(ms: u64) -> u64 {
    us(ms * 1000)
}

/// Returns the number of 32,768 Hz ticks that have begun by this cycle.
pub const fn ticks(cycles: u64) -> u64 {
    cycles * 8 / 15_625
}

/// Returns the first cycle of a tick of the 32,768 Hz clock.
pub const fn cycle_of_tick(tick: u64) -> u64 {
    (tick * 15_625).div_ceil(8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_has_32768_ticks_and_each_begins_where_it_says() {
        assert_eq!(ticks(HZ), 32_768);
        for tick in 0..40_000 {
            let first = cycle_of_tick(tick);
            assert_eq!(ticks(first), tick);
            assert!(first == 0 || ticks(first - 1) + 1 == tick);
        }
    }
}
