//! Bluetooth that is linked into the image, so that the board keeps its original bootloader.
//! Nordic's controller is a library (`nrf-sdc`, `nrf-mpsl`), and the host stack `trouble` runs above it.
//!
//! The two libraries use RADIO, TIMER0, RTC0, TEMP, RNG, NVMC, EGU0, ECB, CCM, AAR and the clocks.
//! They also use the PPI channels 17 to 31.

mod bonds;
mod flash;
mod guard;
mod link;
mod pairing;
mod power;

use core::task::{Context, Poll};

use embassy_executor::Spawner;
use embassy_nrf::mode::Blocking;
use embassy_nrf::peripherals::{NVMC, RNG};
use embassy_nrf::rng::Rng;
use embassy_nrf::usb::vbus_detect::SoftwareVbusDetect;
use embassy_nrf::{Peri, bind_interrupts, pac};
use nrf_mpsl::{MultiprotocolServiceLayer, SessionMem, raw};
use nrf_sdc::SoftdeviceController;
use shared_board::bonds::{Laptops, REMEMBERED};
use shared_proto::frame::BOARD_FRAME_MAX;
use static_cell::StaticCell;
use trouble_host::prelude::{DefaultPacketPool, HostResources};
use trouble_host::{Address, IoCapabilities};

pub use nrf_mpsl::Peripherals as Timing;
pub use nrf_sdc::Peripherals as Wiring;

use self::bonds::Bonds;
pub use self::bonds::bonded;
pub use self::flash::{NoSlot, SlotFlash};
pub use self::link::{Payload, written};
pub use self::pairing::{Pairing, paired, passkey};
use self::power::PowerHandler;
pub use self::power::cable;
use crate::{NAME, PAYLOAD};

/// A frame that is ready to be sent.
pub type Frame = heapless::Vec<u8, BOARD_FRAME_MAX>;

/// The queue of frames for the laptop.
pub trait Outbox: Sync {
    /// Sets whether a trusted laptop listens. Waiting frames are discarded.
    fn set_open(&self, open: bool);
    /// Returns the next frame.
    fn poll_next(&self, context: &mut Context<'_>) -> Poll<Frame>;
}

bind_interrupts!(struct Irqs {
    EGU0_SWI0 => nrf_mpsl::LowPrioInterruptHandler;
    CLOCK_POWER => nrf_mpsl::ClockInterruptHandler, PowerHandler;
    RADIO => nrf_mpsl::HighPrioInterruptHandler;
    TIMER0 => nrf_mpsl::HighPrioInterruptHandler;
    RTC0 => nrf_mpsl::HighPrioInterruptHandler;
});

type Controller = guard::Guarded<SoftdeviceController<'static>>;
type Stack = trouble_host::Stack<'static, Controller, DefaultPacketPool>;

/// The stack has room for one laptop, no channels of our own, and one advertisement.
/// A new laptop pairs before an old laptop is forgotten.
/// The stack therefore has room for one more key than the board stores.
type Resources = HostResources<DefaultPacketPool, 1, 1, 1, { REMEMBERED + 1 }>;

/// Number of packets that the controller buffers for a link: packets to the laptop, and packets from it.
const PACKETS: (u8, u8) = (4, 3);
/// Size of the largest packet on the air, without its header.
/// The size is four bytes more than the largest MTU.
const PACKET: u16 = PAYLOAD as u16 + 7;
/// Memory that the controller needs according to the formulas of its `sdc.h`, rounded up to 100 bytes.
/// This memory contains a link with those buffers and the part that all links share.
/// It also contains an advertiser with 31 bytes, and a list of eight addresses.
const CONTROLLER_BYTES: usize =
    (923 + 7 * (PACKET as usize + 15) - 2 * 42 + 17 + 574 + 68).next_multiple_of(100);

/// The peripherals that the radio uses on this chip.
pub struct Parts {
    /// Timers and clocks.
    pub timing: Timing<'static>,
    /// Wiring of the controller.
    pub controller: Wiring<'static>,
    /// The flash controller.
    pub flash: Peri<'static, NVMC>,
    /// Random numbers.
    pub random: Peri<'static, RNG>,
}

/// The radio, which has been started.
pub struct Radio {
    mpsl: &'static MultiprotocolServiceLayer<'static>,
    random: Rng<'static, Blocking>,
    controller: Wiring<'static>,
    flash: SlotFlash,
}

impl Radio {
    /// Starts the clocks and time slots. `embassy_nrf::init` has already run and started the slow crystal.
    pub fn start(parts: Parts) -> Self {
        static MPSL: StaticCell<MultiprotocolServiceLayer<'static>> = StaticCell::new();
        static SESSION: StaticCell<SessionMem<1>> = StaticCell::new();
        let clock = raw::mpsl_clock_lfclk_cfg_t {
            source: raw::MPSL_CLOCK_LF_SRC_XTAL as u8,
            rc_ctiv: 0,
            rc_temp_ctiv: 0,
            accuracy_ppm: 50,
            skip_wait_lfclk_started: false,
        };
        let session = SESSION.init(SessionMem::new());
        let mpsl = match MultiprotocolServiceLayer::with_timeslots(parts.timing, Irqs, clock, session) {
            Ok(mpsl) => &*MPSL.init(mpsl),
            Err(_) => defmt::panic!("mpsl does not take the clock"),
        };
        let flash = SlotFlash::take(mpsl, parts.flash);
        Self { mpsl, random: Rng::new_blocking(parts.random), controller: parts.controller, flash }
    }

    /// Returns a random number.
    pub fn random(&mut self) -> u32 {
        self.random.blocking_next_u32()
    }

    /// Returns access to the flash that shares time with the radio.
    pub fn flash(&mut self) -> SlotFlash {
        self.flash
    }

    /// Starts everything else. Returns the object that tells the USB driver about its cable.
    pub fn spawn(
        self,
        spawner: Spawner,
        laptops: Laptops,
        outbox: &'static dyn Outbox,
    ) -> &'static SoftwareVbusDetect {
        static RANDOM: StaticCell<Rng<'static, Blocking>> = StaticCell::new();
        static MEMORY: StaticCell<nrf_sdc::Mem<CONTROLLER_BYTES>> = StaticCell::new();
        static RESOURCES: StaticCell<Resources> = StaticCell::new();
        static STACK: StaticCell<Stack> = StaticCell::new();
        static SERVER: StaticCell<link::Server<'static>> = StaticCell::new();
        static BONDS: StaticCell<Bonds> = StaticCell::new();
        static VBUS: StaticCell<SoftwareVbusDetect> = StaticCell::new();
        let memory = MEMORY.init(nrf_sdc::Mem::new());
        let controller = match build(self.mpsl, self.controller, RANDOM.init(self.random), memory) {
            Ok(controller) => controller,
            Err(_) => defmt::panic!("the controller wants other memory"),
        };
        let stack = &*STACK.init(
            trouble_host::new(guard::Guarded::new(controller), RESOURCES.init(Resources::new()))
                .set_random_address(address())
                // A laptop on which digits can be typed pairs with a passkey, and others by "just works".
                .set_io_capabilities(IoCapabilities::DisplayOnly)
                .build(),
        );
        let server = match link::Server::new_default(NAME) {
            Ok(server) => &*SERVER.init(server),
            Err(_) => defmt::panic!("the name is too long"),
        };
        let bonds = &*BONDS.init(Bonds::new(laptops));
        let vbus = &*VBUS.init(power::unplugged());
        spawner.spawn(run_mpsl(self.mpsl).expect("spawned once"));
        spawner.spawn(run_host(stack).expect("spawned once"));
        spawner.spawn(link::run(stack, server, bonds, outbox).expect("spawned once"));
        spawner.spawn(power::run(self.mpsl, vbus).expect("spawned once"));
        vbus
    }
}

fn build(
    mpsl: &'static MultiprotocolServiceLayer<'static>,
    parts: Wiring<'static>,
    random: &'static mut Rng<'static, Blocking>,
    memory: &'static mut nrf_sdc::Mem<CONTROLLER_BYTES>,
) -> Result<SoftdeviceController<'static>, nrf_sdc::Error> {
    nrf_sdc::Builder::new()?
        .support_adv()
        .support_peripheral()
        .support_dle_peripheral()
        .support_le_2m_phy()
        .support_phy_update_peripheral()
        .support_le_privacy()
        .adv_count(1)?
        .peripheral_count(1)?
        .buffer_cfg(PACKET, PACKET, PACKETS.0, PACKETS.1)?
        .build(parts, random, mpsl, memory)
}

/// Returns the static random address that the chip received in production.
fn address() -> Address {
    let [low, high] = [0, 1].map(|word| pac::FICR.deviceaddr(word).read().to_le_bytes());
    // The two highest bits mark the address as static.
    Address::random([low[0], low[1], low[2], low[3], high[0], high[1] | 0xC0])
}

#[embassy_executor::task]
async fn run_mpsl(mpsl: &'static MultiprotocolServiceLayer<'static>) -> ! {
    mpsl.run().await
}

/// Runs the host. It ends only if the controller refuses a command that it must accept.
/// After that, only a restart helps.
#[embassy_executor::task]
async fn run_host(stack: &'static Stack) -> ! {
    let _ = stack.runner().run().await;
    defmt::panic!("the radio's host has ended")
}
