//! Puts a filter between controller and host: all packets from the air must pass [`shared_board::guard`].

use core::cell::Cell;

use bt_hci::cmd::le::LeLongTermKeyRequestReply;
use bt_hci::cmd::{self, AsyncCmd, Cmd, SyncCmd};
use bt_hci::controller::{Controller, ControllerCmdAsync, ControllerCmdSync};
use bt_hci::data::{AclPacket, AclPacketBoundary, IsoPacket, SyncPacket};
use bt_hci::event::EventKind;
use bt_hci::param::Error as Refused;
use bt_hci::{AsHciBytes, ControllerToHostPacket, FromHciBytes};
use embedded_io::ErrorType;
use shared_board::guard::Guard;

/// A controller with the guard between it and the host. There is only one link at a time.
pub struct Guarded<C> {
    controller: C,
    guard: Cell<Guard>,
}

impl<C> Guarded<C> {
    /// Puts the guard between this controller and the host.
    pub fn new(controller: C) -> Self {
        Self { controller, guard: Cell::new(Guard::default()) }
    }

    fn passes(&self, packet: &ControllerToHostPacket<'_>) -> bool {
        match packet {
            ControllerToHostPacket::Acl(acl) => {
                let mut guard = self.guard.get();
                let starts = acl.boundary_flag() != AclPacketBoundary::Continuing;
                let passes = guard.passes(starts, acl.data());
                self.guard.set(guard);
                passes
            }
            ControllerToHostPacket::Event(event) => {
                if event.kind == EventKind::DisconnectionComplete {
                    self.guard.set(Guard::default());
                }
                true
            }
            _ => true,
        }
    }
}

impl<C: ErrorType> ErrorType for Guarded<C> {
    type Error = C::Error;
}

impl<C> Controller for Guarded<C>
where
    C: for<'b> Controller<Buffer<'b> = [u8; nrf_sdc::raw::HCI_MSG_BUFFER_MAX_SIZE as usize]>,
{
    type Buffer<'b> = [u8; nrf_sdc::raw::HCI_MSG_BUFFER_MAX_SIZE as usize];

    fn alloc_buf(&self) -> Result<Self::Buffer<'_>, Self::Error> {
        Ok([0; nrf_sdc::raw::HCI_MSG_BUFFER_MAX_SIZE as usize])
    }

    async fn write_acl_data(&self, packet: &AclPacket<'_>) -> Result<(), Self::Error> {
        self.controller.write_acl_data(packet).await
    }

    async fn write_sync_data(&self, packet: &SyncPacket<'_>) -> Result<(), Self::Error> {
        self.controller.write_sync_data(packet).await
    }

    async fn write_iso_data(&self, packet: &IsoPacket<'_>) -> Result<(), Self::Error> {
        self.controller.write_iso_data(packet).await
    }

    async fn read<'a>(
        &self,
        buf: &'a mut Self::Buffer<'_>,
    ) -> Result<ControllerToHostPacket<'a>, Self::Error> {
        loop {
            // SAFETY: the packet that was read is dropped before the buffer is used again.
            let again = unsafe { &mut *core::ptr::from_mut(buf) };
            let packet = self.controller.read(again).await?;
            if self.passes(&packet) {
                return Ok(packet);
            }
        }
    }
}

impl<C, Q> ControllerCmdSync<Q> for Guarded<C>
where
    Self: Controller<Error = C::Error>,
    C: ControllerCmdSync<Q>,
    Q: SyncCmd + ?Sized,
{
    async fn exec(&self, cmd: &Q) -> Result<Q::Return, cmd::Error<Self::Error>> {
        match self.controller.exec(cmd).await {
            // The link has ended since the controller requested its key.
            // The host must not stop for this reason.
            Err(cmd::Error::Hci(Refused::UNKNOWN_CONN_IDENTIFIER))
                if Q::OPCODE == LeLongTermKeyRequestReply::OPCODE =>
            {
                Q::Return::from_hci_bytes_complete(cmd.param_handle().as_hci_bytes())
                    .map_err(|_| cmd::Error::Hci(Refused::UNKNOWN_CONN_IDENTIFIER))
            }
            other => other,
        }
    }
}

impl<C, Q> ControllerCmdAsync<Q> for Guarded<C>
where
    Self: Controller<Error = C::Error>,
    C: ControllerCmdAsync<Q>,
    Q: AsyncCmd + ?Sized,
{
    async fn exec(&self, cmd: &Q) -> Result<(), cmd::Error<Self::Error>> {
        self.controller.exec(cmd).await
    }
}
