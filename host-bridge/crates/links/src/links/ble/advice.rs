//! What a user can do if a board cannot be used over Bluetooth.

/// Returns advice if a board is in range but not bonded.
pub(super) fn unbonded(name: &str, address: &str) -> String {
    format!(
        "{name} (Bluetooth) is not paired with this machine, and anybody could advertise as it does: {}",
        how_to_pair(address)
    )
}

/// Explains how to pair a board with this system.
/// A board takes a new laptop for two minutes after its start, or at any time if it knows none.
pub(super) fn how_to_pair(address: &str) -> String {
    let how = if cfg!(target_os = "macos") {
        "macOS asks when a program first uses the board: allow it (later, System Settings > Bluetooth lists the board). macOS \
         does not tell programs which boards are paired, so allow_unbonded = true under [ports] is needed, too (the base \
         alone, at most 0.2 m/s)"
            .to_owned()
    } else if cfg!(target_os = "windows") {
        "pair it once in Settings > Bluetooth & devices > Add device > Bluetooth. Windows does not tell programs which \
         boards are paired, so allow_unbonded = true under [ports] is needed, too (the base alone, at most 0.2 m/s)"
            .to_owned()
    } else {
        format!("pair it once in the system's settings, or with `bluetoothctl pair {address}`")
    };
    format!(
        "{how}. The board takes a new laptop only in the two minutes after it is switched on, unless it knows none. If \
         the system asks for six digits, the board's light shows them, and so does `host-bridge doctor` on its USB port"
    )
}

/// Advice if Bluetooth is off.
pub(super) fn off() -> String {
    "Bluetooth is off: switch it on in the system's settings, or with `bluetoothctl power on` (`rfkill unblock \
     bluetooth` where a switch blocks it)"
        .to_owned()
}

/// Explains an error of the system with a remedy.
pub(super) fn trouble(error: &btleplug::Error) -> String {
    let text = error.to_string();
    let none =
        ["ServiceUnknown", "not provided by any", "NameHasNoOwner", "Failed to connect to socket", "activat"];
    if none.iter().any(|word| text.contains(word)) {
        return "Bluetooth: the system's service does not run: `sudo systemctl start bluetooth` (Debian: package bluez)"
            .to_owned();
    }
    format!("Bluetooth: {text}; try again, or connect the board with its USB cable")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn how_to_pair_says_when_the_board_takes_a_laptop() {
        let text = how_to_pair("C0:FF:EE:00:00:33");
        assert!(text.contains("pair") && text.contains("two minutes"), "{text}");
    }

    #[test]
    fn a_service_that_does_not_run_is_told_with_what_to_do() {
        let refused = "The name org.bluez was not provided by any .service files";
        let text = trouble(&btleplug::Error::Other(refused.into()));
        assert!(text.contains("systemctl start bluetooth"), "{text}");
        let text = trouble(&btleplug::Error::NotConnected);
        assert!(text.contains("USB cable"), "{text}");
    }
}
