//! Code common to all transports: sending frames and receiving messages.
//!
//! Each transport has an [`Outbox`].
//! While nobody listens, the outbox rejects frames.
//! A full outbox drops its oldest frame.
//! Late frames would be useless, because every state frame is complete in itself.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use shared_board::FrameOut;
use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, HOST_FRAME_MAX};

/// An encoded frame.
pub type Frame = heapless::Vec<u8, BOARD_FRAME_MAX>;

/// The transports of the board.
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

/// Frames that wait to be sent by one transport.
pub struct Outbox {
    frames: Channel<CriticalSectionRawMutex, Frame, 6>,
    open: AtomicBool,
}

impl Outbox {
    const fn new() -> Self {
        Self { frames: Channel::new(), open: AtomicBool::new(false) }
    }

    /// Sets whether a laptop listens, and discards the waiting frames.
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

    /// Returns the next frame, for callers that cannot use `await`.
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

/// Number of frames dropped because a transport was too slow.
pub static LATE_FRAMES: AtomicU32 = AtomicU32::new(0);
/// Number of damaged frames from the laptop, on all transports.
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

/// Sends frames to every link with a listener.
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

/// A decoded frame from the laptop, still in postcard encoding, and the link on which the frame arrived.
pub struct Received {
    /// The link on which the board must reply.
    pub link: WayOut,
    /// Whether the link may make permanent changes to the board. A Bluetooth link may do so only if it is bonded.
    pub trusted: bool,
    /// The message.
    pub payload: heapless::Vec<u8, HOST_FRAME_MAX>,
}

/// Messages from the laptop, in order. While the inbox is full, the transports wait.
pub static INBOX: Channel<CriticalSectionRawMutex, Received, 3> = Channel::new();

/// Decodes the bytes of one transport to messages, which it puts in the [`INBOX`].
pub struct Inlet {
    link: WayOut,
    decoder: Decoder<HOST_FRAME_MAX>,
    damaged: u32,
}

impl Inlet {
    /// Creates an inlet, which waits for the start of a frame.
    pub const fn new(link: WayOut) -> Self {
        Self { link, decoder: Decoder::new(), damaged: 0 }
    }

    /// Decodes received bytes.
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
