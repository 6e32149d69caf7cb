//! The vendor of a participant's DDS, and the form in which requests of its services are wrapped.
//!
//! RTPS (version 2.2 and later, 8.2.4.3 and 9.3.1.5) puts the vendor's id into every GUID prefix.
//! The id is in the first two bytes of the prefix.
//! The two bytes equal the id in the participant's announcements.

use std::fmt;

/// The vendor of a participant's middleware.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Vendor(pub [u8; 2]);

impl Vendor {
    /// eProsima Fast DDS, used by `rmw_fastrtps_cpp`: the default of Jazzy, Kilted and Lyrical.
    pub const FAST_DDS: Vendor = Vendor([0x01, 0x0F]);
    /// Eclipse Cyclone DDS, used by `rmw_cyclonedds_cpp`.
    pub const CYCLONE_DDS: Vendor = Vendor([0x01, 0x10]);
    /// RTI Connext, used by `rmw_connextdds`.
    pub const CONNEXT: Vendor = Vendor([0x01, 0x01]);
    /// A session of Zenoh instead of DDS. This id is not assigned to any vendor.
    pub const ZENOH: Vendor = Vendor([0xFF, 0x5A]);
    /// The vendor id of RustDDS, which this program uses.
    pub const RUST_DDS: Vendor = Vendor([0x01, 0x12]);

    /// Reads the bytes of a GUID or its prefix; `None` for fewer than two.
    pub fn of_prefix(prefix: &[u8]) -> Option<Self> {
        Some(Vendor([*prefix.first()?, *prefix.get(1)?]))
    }

    /// Returns the wrapping of requests for a server of this vendor.
    pub fn wrapping(self) -> Wrapping {
        if self == Vendor::CYCLONE_DDS { Wrapping::Cyclone } else { Wrapping::Rpc }
    }
}

impl fmt::Display for Vendor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Vendor::FAST_DDS => f.write_str("Fast DDS"),
            Vendor::CYCLONE_DDS => f.write_str("Cyclone DDS"),
            Vendor::CONNEXT => f.write_str("Connext"),
            Vendor::ZENOH => f.write_str("Zenoh"),
            Vendor::RUST_DDS => f.write_str("RustDDS"),
            Vendor([high, low]) => write!(f, "vendor {high:02x}.{low:02x}"),
        }
    }
}

/// The form in which requests and replies are identified.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrapping {
    /// The id is in 16 bytes before the message (`rmw_cyclonedds_cpp`).
    Cyclone,
    /// The id is in the data's inline quality of service, according to DDS-RPC's enhanced mapping.
    /// `rmw_fastrtps_cpp` and `rmw_connextdds` use this form.
    Rpc,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_is_asked_as_its_vendor_does_it_and_an_unknown_one_as_dds_rpc_has_it() {
        let of =
            |bytes: &[u8]| Vendor::of_prefix(bytes).map(|vendor| (vendor.to_string(), vendor.wrapping()));
        assert_eq!(of(&[0x01, 0x10, 7]), Some(("Cyclone DDS".to_owned(), Wrapping::Cyclone)));
        assert_eq!(of(&[0x01, 0x0F, 7]), Some(("Fast DDS".to_owned(), Wrapping::Rpc)));
        assert_eq!(of(&[0x01, 0x42]), Some(("vendor 01.42".to_owned(), Wrapping::Rpc)));
        assert_eq!(of(&[1]), None);
    }
}
