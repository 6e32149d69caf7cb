//! skeleton
#![no_std]
#![no_main]

use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_time::{Duration, Timer};

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let p = embassy_nrf::init(Default::default());
    let mut led = embassy_nrf::gpio::Output::new(p.P0_24, embassy_nrf::gpio::Level::High, embassy_nrf::gpio::OutputDrive::Standard);
    #[cfg(feature = "ble")]
    let _sd = nrf_softdevice::Softdevice::enable(&Default::default());
    loop {
        Timer::after(Duration::from_millis(100)).await;
        led.toggle();
    }
}
