//! Firmware of the right hand. This file only starts and connects the tasks.
//! Samples flow through `sample -> classify -> board -> link`, and requests through `link -> control -> board`.
//! The crate `shared_board` defines the board's messages and replies.
#![no_std]
#![no_main]
#![allow(async_fn_in_trait, reason = "one executor, one core")]

mod about;
mod awake;
#[cfg(feature = "xiao")]
mod battery;
#[cfg(feature = "ble")]
mod ble;
mod board;
mod boards;
#[cfg(feature = "ble")]
mod bonds;
mod bus;
mod classify;
mod control;
mod flash;
mod link;
mod model;
mod sample;
mod state;
mod storage;
mod uart;
mod usb;
mod vibrate;
mod watch;

#[cfg(all(feature = "ble", feature = "bootloader"))]
compile_error!("choose one: `--features bootloader` goes with `--no-default-features`");
#[cfg(all(feature = "xiao", feature = "bootloader"))]
compile_error!("`xiao` goes with `ble`: S140 is on that board already");
#[cfg(not(any(feature = "ble", feature = "bootloader")))]
compile_error!("choose one: `ble` (default) or `--no-default-features --features bootloader`");

use defmt_rtt as _;
use embassy_nrf::interrupt::{self, InterruptExt, Priority};

/// The log is visible only to a debug probe. The board reports the panic to the laptop after the restart.
#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    defmt::error!("{}", defmt::Display2Format(info));
    watch::restart_after_panic()
}

#[cortex_m_rt::entry]
fn main() -> ! {
    awake::paint_stack();
    boards::begin();
    let mut config = embassy_nrf::config::Config::default();
    config.lfclk_source = embassy_nrf::config::LfclkSource::ExternalXtal;
    // The SoftDevice owns the fast crystal. Without the SoftDevice, USB requires the crystal to be enabled here.
    #[cfg(not(feature = "ble"))]
    {
        config.hfclk_source = embassy_nrf::config::HfclkSource::ExternalXtal;
    }
    // The DC/DC converter halves the current compared to the linear regulator.
    // All supported boards have the required coil.
    config.dcdc.reg1 = true;
    // Interrupt priorities 0, 1 and 4 belong to the SoftDevice.
    config.time_interrupt_priority = Priority::P2;
    config.gpiote_interrupt_priority = Priority::P7;
    let p = embassy_nrf::init(config);
    let reasons = embassy_nrf::pac::POWER.resetreas().read();
    // Writing ones clears the bits.
    embassy_nrf::pac::POWER.resetreas().write_value(reasons);
    let reasons = reasons.0;
    about::started(reasons);
    // The flash cache reduces the number of flash reads and thus the current.
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
        spawner.spawn(classify::run().expect("spawned once"));
        spawner.spawn(uart::run(uart).expect("spawned once"));
        spawner.spawn(vibrate::run(parts.vibration).expect("spawned once"));
        #[cfg(feature = "xiao")]
        spawner.spawn(battery::run(parts.battery).expect("spawned once"));
    };
    // SAFETY: taken once, here.
    let core = unsafe { cortex_m::Peripherals::steal() };

    #[cfg(feature = "ble")]
    {
        let softdevice = ble::enable();
        state::BOOT_ID.store(ble::random(softdevice), core::sync::atomic::Ordering::Relaxed);
        let flash = flash::SoftDeviceFlash::new(softdevice);
        awake::run(core.DCB, core.DWT, |spawner| {
            let store = model::install(flash);
            watch::report_last_run(reasons);
            spawn_common(spawner);
            spawner.spawn(ble::run_control(store).expect("spawned once"));
            ble::spawn(spawner, softdevice, parts.usbd);
        })
    }
    #[cfg(not(feature = "ble"))]
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
        #[embassy_executor::task]
        async fn run_control(store: shared_board::models::ModelStore<storage::Slots<flash::Controller>>) {
            control::run(store).await
        }

        let mut rng = embassy_nrf::rng::Rng::new_blocking(parts.random);
        state::BOOT_ID.store(rng.blocking_next_u32(), core::sync::atomic::Ordering::Relaxed);
        let flash = flash::Controller::new(parts.flash);
        awake::run(core.DCB, core.DWT, |spawner| {
            let store = model::install(flash);
            watch::report_last_run(reasons);
            spawn_common(spawner);
            spawner.spawn(run_control(store).expect("spawned once"));
            spawner.spawn(run_usb(parts.usbd, HardwareVbusDetect::new(Irqs)).expect("spawned once"));
        })
    }
}
