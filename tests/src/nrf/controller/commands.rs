//! The commands of the controller's C interface.
//! Each command is an HCI command, and its arguments are packed in the same way.

/// The component that answers a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Who {
    /// Bumble's controller answers.
    Bumble,
    /// The emulator answers.
    /// Bumble's controller does not know the command, or would answer for another chip.
    Here,
}

/// Number of bytes of the arguments.
#[derive(Clone, Copy, Debug)]
pub(super) enum Length {
    /// Always this number of bytes.
    Fixed(usize),
    /// First come `fixed` bytes. The byte at `count` says how many elements follow, each of `each` bytes.
    Counted { fixed: usize, count: usize, each: usize },
}

/// A command.
#[derive(Clone, Copy, Debug)]
pub(super) struct Command {
    pub(super) opcode: u16,
    pub(super) arguments: Length,
    /// Number of bytes that the function stores at its last pointer.
    pub(super) returns: usize,
    pub(super) who: Who,
}

const fn bumble(opcode: u16, arguments: usize, returns: usize) -> Command {
    Command { opcode, arguments: Length::Fixed(arguments), returns, who: Who::Bumble }
}

const fn here(opcode: u16, arguments: usize, returns: usize) -> Command {
    Command { opcode, arguments: Length::Fixed(arguments), returns, who: Who::Here }
}

const fn counted(opcode: u16, fixed: usize, count: usize, each: usize) -> Command {
    Command { opcode, arguments: Length::Counted { fixed, count, each }, returns: 0, who: Who::Bumble }
}

/// Returns the command that the function `sdc_hci_cmd_…` executes.
/// The lengths are those in the Core Specification, volume 4, part E.
pub(super) fn find(function: &str) -> Option<Command> {
    Some(match function.strip_prefix("sdc_hci_cmd_")? {
        "lc_disconnect" => bumble(0x0406, 3, 0),
        "lc_read_remote_version_information" => bumble(0x041D, 2, 0),
        "cb_set_event_mask" => bumble(0x0C01, 8, 0),
        "cb_reset" => bumble(0x0C03, 0, 0),
        "cb_read_transmit_power_level" => bumble(0x0C2D, 3, 3),
        "cb_set_controller_to_host_flow_control" => here(0x0C31, 1, 0),
        "cb_host_buffer_size" => here(0x0C33, 7, 0),
        "cb_host_number_of_completed_packets" => Command {
            opcode: 0x0C35,
            arguments: Length::Counted { fixed: 1, count: 0, each: 4 },
            returns: 0,
            who: Who::Here,
        },
        "cb_set_event_mask_page_2" => bumble(0x0C63, 8, 0),
        "ip_read_local_version_information" => bumble(0x1001, 0, 8),
        "ip_read_local_supported_commands" => bumble(0x1002, 0, 64),
        "ip_read_local_supported_features" => bumble(0x1003, 0, 8),
        "ip_read_bd_addr" => bumble(0x1009, 0, 6),
        "sp_read_rssi" => here(0x1405, 2, 3),
        "le_set_event_mask" => bumble(0x2001, 8, 0),
        "le_read_buffer_size" => here(0x2002, 0, 3),
        "le_read_local_supported_features" => bumble(0x2003, 0, 8),
        "le_set_random_address" => bumble(0x2005, 6, 0),
        "le_set_adv_params" => bumble(0x2006, 15, 0),
        "le_read_adv_physical_channel_tx_power" => bumble(0x2007, 0, 1),
        "le_set_adv_data" => bumble(0x2008, 32, 0),
        "le_set_scan_response_data" => bumble(0x2009, 32, 0),
        "le_set_adv_enable" => bumble(0x200A, 1, 0),
        "le_read_filter_accept_list_size" => bumble(0x200F, 0, 1),
        "le_clear_filter_accept_list" => bumble(0x2010, 0, 0),
        "le_add_device_to_filter_accept_list" => bumble(0x2011, 7, 0),
        "le_remove_device_from_filter_accept_list" => bumble(0x2012, 7, 0),
        "le_conn_update" => bumble(0x2013, 14, 0),
        "le_read_remote_features" => bumble(0x2016, 2, 0),
        "le_rand" => bumble(0x2018, 0, 8),
        "le_long_term_key_request_reply" => bumble(0x201A, 18, 2),
        "le_long_term_key_request_negative_reply" => bumble(0x201B, 2, 2),
        "le_read_supported_states" => bumble(0x201C, 0, 8),
        "le_set_data_length" => here(0x2022, 6, 2),
        "le_read_suggested_default_data_length" => bumble(0x2023, 0, 4),
        "le_write_suggested_default_data_length" => bumble(0x2024, 4, 0),
        "le_add_device_to_resolving_list" => here(0x2027, 39, 0),
        "le_remove_device_from_resolving_list" => here(0x2028, 7, 0),
        "le_clear_resolving_list" => here(0x2029, 0, 0),
        "le_read_resolving_list_size" => bumble(0x202A, 0, 1),
        "le_set_address_resolution_enable" => bumble(0x202D, 1, 0),
        "le_set_resolvable_private_address_timeout" => bumble(0x202E, 2, 0),
        "le_read_max_data_length" => here(0x202F, 0, 8),
        "le_read_phy" => here(0x2030, 2, 4),
        "le_set_default_phy" => bumble(0x2031, 3, 0),
        "le_set_phy" => here(0x2032, 7, 0),
        "le_set_adv_set_random_address" => bumble(0x2035, 7, 0),
        "le_set_ext_adv_params" => bumble(0x2036, 25, 1),
        "le_set_ext_adv_data" => counted(0x2037, 4, 3, 1),
        "le_set_ext_scan_response_data" => counted(0x2038, 4, 3, 1),
        "le_set_ext_adv_enable" => counted(0x2039, 2, 1, 4),
        "le_read_max_adv_data_length" => bumble(0x203A, 0, 2),
        "le_read_number_of_supported_adv_sets" => bumble(0x203B, 0, 1),
        "le_remove_adv_set" => bumble(0x203C, 1, 0),
        "le_clear_adv_sets" => bumble(0x203D, 0, 0),
        "le_read_transmit_power" => bumble(0x204B, 0, 2),
        "le_set_privacy_mode" => here(0x204E, 8, 0),
        vendor if vendor.starts_with("vs_") => here(0xFC00, 0, 0),
        _ => return None,
    })
}
