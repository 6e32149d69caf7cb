//! What all transports share: frames out, messages in.
//!
//! Each transport has an [`Outbox`]. While nobody listens it takes nothing, and when it is full its
//! oldest frame goes: late is dropped, never queued, since every state frame is whole.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use shared_board::FrameOut;
use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, HOST_FRAME_MAX};

/// A frame ready for the wire.
pub type Frame = heapless::Vec<u8, BOARD_FRAME_MAX>;

/// The outputs of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
#[repr(u8)]
pub enum WayOut {
    /// D0/D1.
    Uart,
    /// The USB cable.
    Usb,
    /// Bluetooth.
    #[cfg(feature = "radio")]
    Ble,
}

/// Frames that wait for one transport.
pub struct Outbox {
    frames: Channel<CriticalSectionRawMutex, Frame, 6>,
    open: AtomicBool,
}

impl Outbox {
    const fn new() -> Self {
        Self { frames: Channel::new(), open: AtomicBool::new(false) }
    }

    /// Somebody listens now, or no longer does; what waited is forgotten.
    pub fn set_open(&self, open: bool) {
        if self.open.swap(open, Ordering::Relaxed) != open {
            self.frames.clear();
        }
    }

    /// Forgets what waits.
    pub fn forget(&self) {
        self.frames.clear();
    }

    /// Whether somebody listens.
    pub fn is_open(&self) -> bool {
        self.open.load(Ordering::Relaxed)
    }

    /// The next frame.
    pub async fn next(&self) -> Frame {
        self.frames.receive().await
    }

    /// The next frame, for whoever has no `await`.
    #[cfg(feature = "trouble")]
    pub fn poll_next(&self, context: &mut core::task::Context<'_>) -> core::task::Poll<Frame> {
        self.frames.poll_receive(context)
    }

    fn put(&self, frame: &[u8]) {
        if !self.is_open() {
            return;
        }
        if self.frames.is_full() {
            let _ = self.frames.try_receive();
            LATE_FRAMES.fetch_add(1, Ordering::Relaxed);
        }
        if let Ok(frame) = Frame::from_slice(frame) {
            let _ = self.frames.try_send(frame);
        }
    }
}

static UART: Outbox = Outbox::new();
static USB: Outbox = Outbox::new();
#[cfg(feature = "radio")]
static BLE: Outbox = Outbox::new();

/// Frames that went because a transport was too slow.
pub static LATE_FRAMES: AtomicU32 = AtomicU32::new(0);
/// Damaged frames from the laptop, on all transports.
pub static BAD_FRAMES: AtomicU32 = AtomicU32::new(0);

impl WayOut {
    /// The link's outbox.
    pub fn outbox(self) -> &'static Outbox {
        match self {
            WayOut::Uart => &UART,
            WayOut::Usb => &USB,
            #[cfg(feature = "radio")]
            WayOut::Ble => &BLE,
        }
    }
}

impl FrameOut for WayOut {
    fn send(&mut self, frame: &[u8]) -> bool {
        self.outbox().put(frame);
        true
    }
}

/// Every link where somebody listens.
pub struct Everywhere;

impl FrameOut for Everywhere {
    fn send(&mut self, frame: &[u8]) -> bool {
        UART.put(frame);
        USB.put(frame);
        #[cfg(feature = "radio")]
        BLE.put(frame);
        true
    }
}

/// A decoded frame from the laptop, still in postcard, with the link it came from.
pub struct Received {
    /// Where the answer goes.
    pub link: WayOut,
    /// Whether the link may change what the board keeps (Bluetooth: bonded).
    pub trusted: bool,
    /// The message.
    pub payload: heapless::Vec<u8, HOST_FRAME_MAX>,
}

/// Messages from the laptop, in order. A full inbox holds the transports back.
pub static INBOX: Channel<CriticalSectionRawMutex, Received, 3> = Channel::new();

/// Bytes of one transport to messages in the [`INBOX`].
pub struct Inlet {
    link: WayOut,
    decoder: Decoder<HOST_FRAME_MAX>,
    damaged: u32,
}

impl Inlet {
    /// An inlet that waits for the start of a frame.
    pub const fn new(link: WayOut) -> Self {
        Self { link, decoder: Decoder::new(), damaged: 0 }
    }

    /// Takes bytes as they come.
    pub async fn take(&mut self, bytes: &[u8], trusted: bool) {
        for &byte in bytes {
            if let Some(payload) = self.decoder.push(byte)
                && let Ok(payload) = heapless::Vec::from_slice(payload)
            {
                INBOX.send(Received { link: self.link, trusted, payload }).await;
            }
            let damaged = self.decoder.counters().damaged();
            if damaged != self.damaged {
                BAD_FRAMES.fetch_add(damaged.wrapping_sub(self.damaged), Ordering::Relaxed);
                self.damaged = damaged;
            }
        }
    }
}
