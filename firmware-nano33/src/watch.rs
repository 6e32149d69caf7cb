//! Sends the status every second, drives the LED, feeds the watchdog, and stores a mark when the program panics.

use core::sync::atomic::Ordering;

use embassy_nrf::gpio::{Level, Output};
use embassy_nrf::wdt::{self, Watchdog, WatchdogHandle};
use embassy_time::{Duration, Ticker, Timer};
#[cfg(feature = "trouble")]
use shared_board::passkey::{Flash, PasskeyLight};
use shared_board::right::Light;
use shared_proto::message::{FaultKind, Status};

use crate::awake::{Load, free_stack_bytes};
use crate::board;
use crate::link;
#[cfg(feature = "trouble")]
use crate::radio;
use crate::state::{self, ALIVE, ALIVE_CLASSIFY, ALIVE_SAMPLE};

/// Time between two flashes that belong together.
const BETWEEN_FLASHES: Duration = Duration::from_millis(200);

/// Pins of the board's LED for red, green and blue; a colour is on while its pin is low.
pub struct Led {
    /// Something is wrong.
    pub red: Output<'static>,
    /// The board recognises gestures; two flashes mean that a movement was nearly one.
    pub green: Output<'static>,
    /// Raw samples are recorded.
    pub blue: Output<'static>,
}

/// Starts the watchdog, which resets the board if [`feed`] does not run or a task stops.
pub fn start_watchdog(
    wdt: embassy_nrf::Peri<'static, embassy_nrf::peripherals::WDT>,
) -> Option<WatchdogHandle> {
    let mut config = wdt::Config::default();
    config.timeout_ticks = 2 * 32768;
    config.action_during_debug_halt = wdt::HaltConfig::Pause;
    match Watchdog::try_new::<_, 1>(wdt, config) {
        Ok((_, [handle])) => Some(handle),
        // A bootloader has started the watchdog with other settings, which cannot change until the next reset.
        Err(_) => None,
    }
}

/// Half of a step in which the light shows a passkey. Two steps fit into a second, between two status messages.
#[cfg(feature = "trouble")]
const HALF_STEP: Duration = Duration::from_millis(200);

/// Sends the status, feeds the watchdog and flashes the LED once per second.
#[embassy_executor::task]
pub async fn run(mut watchdog: Option<WatchdogHandle>, mut led: Led) -> ! {
    let mut second = Ticker::every(Duration::from_secs(1));
    let mut load = Load::new();
    #[cfg(feature = "trouble")]
    let mut digits = PasskeyLight::default();
    loop {
        second.next().await;
        let all = ALIVE_SAMPLE | ALIVE_CLASSIFY;
        if critical_section::with(|_| ALIVE.load(Ordering::Relaxed)) & all == all {
            critical_section::with(|_| ALIVE.store(0, Ordering::Relaxed));
            if let Some(handle) = &mut watchdog {
                handle.pet();
            }
        }
        let counted = Status {
            dropped_samples: state::DROPPED_SAMPLES.load(Ordering::Relaxed),
            sensor_errors: state::SENSOR_ERRORS.load(Ordering::Relaxed),
            bad_frames: link::BAD_FRAMES.load(Ordering::Relaxed),
            free_stack_bytes: free_stack_bytes(),
            load_permille: load.permille(),
            ..Status::default()
        };
        let light = board::status(counted);
        #[cfg(feature = "trouble")]
        if let Some(passkey) = radio::passkey() {
            radio::say_passkey(passkey);
            for _ in 0..2 {
                let flash = digits.next(passkey).map(|flash| match flash {
                    Flash::Zero => &mut led.blue,
                    Flash::One => &mut led.green,
                    Flash::Five => &mut led.red,
                });
                show(flash, HALF_STEP).await;
                Timer::after(HALF_STEP).await;
            }
            continue;
        }
        let (light, flashes) = match light {
            Light::SensorGone => (&mut led.red, 1),
            Light::Recording => (&mut led.blue, 1),
            Light::Well => (&mut led.green, 1),
            Light::Almost => (&mut led.green, 2),
        };
        for flash in 0..flashes {
            if flash > 0 {
                Timer::after(BETWEEN_FLASHES).await;
            }
            // A flash is short because the LED draws more current than the rest of the board.
            show(Some(light), Duration::from_millis(10)).await;
        }
    }
}

/// Waits for this long with a colour on, or in the dark.
async fn show(mut light: Option<&mut Output<'static>>, time: Duration) {
    if let Some(light) = &mut light {
        light.set_level(Level::Low);
    }
    Timer::after(time).await;
    if let Some(light) = &mut light {
        light.set_level(Level::High);
    }
}

unsafe extern "C" {
    /// Word in which a panic stores a mark for the next start.
    /// The memory layouts (`src/boards/*.x`) reserve the word, so neither the image nor a bootloader uses it.
    #[link_name = "_kept"]
    static mut PANICKED: u32;
}
const MARK: u32 = 0xDEAD_0A33;

/// Stores the mark of a panic and restarts the board.
#[inline(never)]
pub fn restart_after_panic() -> ! {
    // SAFETY: there is one core, interrupts are disabled, and no other code accesses the word.
    unsafe {
        (&raw mut PANICKED).write_volatile(MARK);
    }
    cortex_m::peripheral::SCB::sys_reset()
}

/// Reports how the previous run ended. `reasons` is the value of RESETREAS at start.
pub fn report_last_run(reasons: u32) {
    const WATCHDOG: u32 = 1 << 1;
    // SAFETY: as in the panic handler, the mark has no other user; no other code runs at start.
    let panicked = unsafe {
        let mark = (&raw const PANICKED).read_volatile();
        (&raw mut PANICKED).write_volatile(0);
        mark == MARK
    };
    // After a power-up, when no reason bit is set, the mark in RAM is random.
    if panicked && reasons != 0 {
        state::report(FaultKind::Panic, 0);
    }
    if reasons & WATCHDOG != 0 {
        state::report(FaultKind::Watchdog, 0);
    }
}
