//! The bonds of this machine.

#[cfg(target_os = "linux")]
use super::advice::trouble;

/// Returns the boards that are bonded with this machine, according to the system.
#[cfg(target_os = "linux")]
pub(super) struct Bonds(bluez_async::BluetoothSession);

#[cfg(target_os = "linux")]
impl Bonds {
    pub(super) async fn open() -> Result<Self, String> {
        let (events, session) = bluez_async::BluetoothSession::new()
            .await
            .map_err(|error| trouble(&btleplug::Error::Other(Box::new(error))))?;
        // The task ends together with the runtime of this attempt.
        tokio::spawn(events);
        Ok(Bonds(session))
    }

    pub(super) async fn addresses(&self) -> Result<Vec<String>, String> {
        let known = self.0.get_devices().await;
        let known = known.map_err(|error| trouble(&btleplug::Error::Other(Box::new(error))))?;
        Ok(known
            .into_iter()
            .filter(|device| device.paired)
            .map(|device| device.mac_address.to_string())
            .collect())
    }
}

/// Other systems do not report bonds, so no board counts as bonded.
#[cfg(not(target_os = "linux"))]
pub(super) struct Bonds;

#[cfg(not(target_os = "linux"))]
impl Bonds {
    pub(super) async fn open() -> Result<Self, String> {
        Ok(Bonds)
    }

    pub(super) async fn addresses(&self) -> Result<Vec<String>, String> {
        Ok(Vec::new())
    }
}
