//! Firmware of the right hand, and (feature `left`) of a left hand. This file only starts and connects the tasks.
//! Samples flow through `sample -> classify -> board -> link`, and requests through `link -> control -> board`.
//! In a left hand, `left::hand` replaces `classify`.
//! The crate `shared_board` defines the board's messages and replies.
#![no_std]
#![no_main]
#![allow(async_fn_in_trait, reason = "one executor, one core")]

#[cfg(not(feature = "left"))]
mod about;
mod awake;
#[cfg(all(feature = "xiao", not(feature = "left")))]
mod battery;
#[cfg(not(feature = "left"))]
mod board;
mod boards;
mod bus;
#[cfg(not(feature = "left"))]
mod classify;
#[cfg(not(feature = "left"))]
mod control;
#[cfg(not(feature = "radio"))]
mod critical;
#[cfg(not(feature = "radio"))]
mod flash;
#[cfg(feature = "left")]
mod left;
mod link;
#[cfg(not(feature = "left"))]
mod model;
#[cfg(feature = "radio")]
mod radio;
mod sample;
mod state;
mod storage;
mod uart;
#[cfg(feature = "trouble")]
mod update;
mod usb;
#[cfg(not(feature = "left"))]
mod vibrate;
mod watch;

#[cfg(feature = "left")]
use left::{board, control};

#[cfg(any(
    all(feature = "ble", feature = "bootloader"),
    all(feature = "ble", feature = "trouble"),
    all(feature = "trouble", feature = "bootloader"),
))]
compile_error!(
    "choose one: `--features bootloader` and `--features trouble` go with `--no-default-features`"
);
#[cfg(all(feature = "left", not(all(feature = "trouble", feature = "xiao"))))]
compile_error!("`left` goes with `trouble,xiao`");
#[cfg(all(feature = "xiao", feature = "bootloader"))]
compile_error!("`xiao` goes with `ble` or `trouble`");
#[cfg(not(any(feature = "ble", feature = "trouble", feature = "bootloader")))]
compile_error!(
    "choose one: `ble` (default), or `--no-default-features` and `--features trouble` or `bootloader`"
);

use defmt_rtt as _;
use embassy_nrf::interrupt::{self, InterruptExt, Priority};
#[cfg(feature = "trouble")]
use shared_board::images::ImageStore;

/// Logs go to the probe, and the laptop receives a report at the next start.
/// Boards with Bluetooth linked in have no probe, and the log texts would be a tenth of their image.
#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    if cfg!(not(feature = "trouble")) {
        defmt::error!("{}", defmt::Display2Format(info));
    }
    watch::restart_after_panic()
}

#[cortex_m_rt::entry]
fn main() -> ! {
    awake::paint_stack();
    boards::begin();
    let mut config = embassy_nrf::config::Config::default();
    config.lfclk_source = embassy_nrf::config::LfclkSource::ExternalXtal;
    // The radio's stack owns the fast crystal. In images without a radio, USB needs the crystal to be on.
    #[cfg(not(feature = "radio"))]
    {
        config.hfclk_source = embassy_nrf::config::HfclkSource::ExternalXtal;
    }
    // The DC/DC converter halves the current compared to the linear regulator. All supported boards have its coil.
    config.dcdc.reg1 = true;
    // The SoftDevice reserves the priorities 0, 1 and 4, and the linked-in controller reserves 0 and 4.
    config.time_interrupt_priority = Priority::P2;
    config.gpiote_interrupt_priority = Priority::P7;
    let p = embassy_nrf::init(config);
    let reasons = embassy_nrf::pac::POWER.resetreas().read();
    // A bit of RESETREAS is cleared by writing 1 to it.
    embassy_nrf::pac::POWER.resetreas().write_value(reasons);
    let reasons = reasons.0;
    #[cfg(not(feature = "left"))]
    about::started(reasons);
    // The flash cache reduces the number of flash reads and therefore the current.
    embassy_nrf::pac::NVMC.icachecnf().write(|w| w.set_cacheen(true));
    for (irq, priority) in [
        (interrupt::TWISPI0, Priority::P3),
        (interrupt::UARTE0, Priority::P3),
        (interrupt::USBD, Priority::P5),
        (interrupt::SAADC, Priority::P7),
    ] {
        irq.set_priority(priority);
    }

    let parts = boards::parts(p);
    let (bus, uart, led) = (parts.bus, parts.uart, parts.led);
    let watchdog = watch::start_watchdog(parts.watchdog);
    let spawn_common = move |spawner: embassy_executor::Spawner| {
        spawner.spawn(watch::run(watchdog, led).expect("spawned once"));
        spawner.spawn(sample::run(bus).expect("spawned once"));
        spawner.spawn(uart::run(uart).expect("spawned once"));
        #[cfg(feature = "left")]
        spawner.spawn(left::hand::run(parts.flex).expect("spawned once"));
        #[cfg(not(feature = "left"))]
        spawner.spawn(classify::run().expect("spawned once"));
        #[cfg(not(feature = "left"))]
        spawner.spawn(vibrate::run(parts.vibration).expect("spawned once"));
        #[cfg(all(feature = "xiao", not(feature = "left")))]
        spawner.spawn(battery::run(parts.battery).expect("spawned once"));
    };
    // SAFETY: taken once, here.
    let core = unsafe { cortex_m::Peripherals::steal() };

    #[cfg(feature = "radio")]
    {
        #[cfg(feature = "ble")]
        let mut radio = radio::Radio::start();
        #[cfg(feature = "trouble")]
        let mut radio = radio::Radio::start(parts.radio);
        state::BOOT_ID.store(radio.random(), core::sync::atomic::Ordering::Relaxed);
        let flash = radio.flash();
        awake::run(core.DCB, core.DWT, |spawner| {
            let kept = install(flash);
            watch::report_last_run(reasons);
            spawn_common(spawner);
            #[cfg(feature = "ble")]
            spawner.spawn(run_control(kept).expect("spawned once"));
            #[cfg(feature = "trouble")]
            spawner.spawn(run_control(kept, ImageStore::new(storage::Region(flash))).expect("spawned once"));
            radio.spawn(spawner, parts.usbd);
        })
    }
    #[cfg(not(feature = "radio"))]
    {
        use embassy_nrf::usb::vbus_detect::{self, HardwareVbusDetect};
        embassy_nrf::bind_interrupts!(struct Irqs {
            CLOCK_POWER => vbus_detect::InterruptHandler;
        });

        #[embassy_executor::task]
        async fn run_usb(
            usbd: embassy_nrf::Peri<'static, embassy_nrf::peripherals::USBD>,
            vbus: HardwareVbusDetect,
        ) {
            usb::run(usbd, vbus).await
        }

        let mut rng = embassy_nrf::rng::Rng::new_blocking(parts.random);
        state::BOOT_ID.store(rng.blocking_next_u32(), core::sync::atomic::Ordering::Relaxed);
        let flash = flash::Controller::new(parts.flash);
        awake::run(core.DCB, core.DWT, |spawner| {
            let kept = install(flash);
            watch::report_last_run(reasons);
            spawn_common(spawner);
            spawner.spawn(run_control(kept).expect("spawned once"));
            spawner.spawn(run_usb(parts.usbd, HardwareVbusDetect::new(Irqs)).expect("spawned once"));
        })
    }
}

#[cfg(feature = "radio")]
type BoardFlash = radio::RadioFlash;
#[cfg(not(feature = "radio"))]
type BoardFlash = flash::Controller;

#[cfg(feature = "left")]
use left::board::{Kept, install};
#[cfg(not(feature = "left"))]
use model::{Kept, install};

/// Answers the laptop's requests.
#[cfg(feature = "trouble")]
#[embassy_executor::task]
async fn run_control(kept: Kept<BoardFlash>, images: ImageStore<storage::Images<BoardFlash>>) {
    control::run(kept, images).await
}

/// Answers the laptop's requests.
#[cfg(not(feature = "trouble"))]
#[embassy_executor::task]
async fn run_control(kept: Kept<BoardFlash>) {
    control::run(kept).await
}
