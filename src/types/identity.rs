//! The identity of the vehicle's hardware and firmware, as reported to ground stations.

use crate::dialect::MavProtocolCapability;

/// The content of AUTOPILOT_VERSION. All zero means "not given".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identity {
    /// Capabilities that the firmware adds. The stack announces its own, according to the declaration and the Cargo
    /// features.
    pub capabilities: MavProtocolCapability,
    /// Version of the firmware: major, minor, patch and `FIRMWARE_VERSION_TYPE`, one byte each, the major version in
    /// the highest byte.
    pub flight_sw_version: u32,
    /// Version of the middleware, in the same form.
    pub middleware_sw_version: u32,
    /// Version of the operating system, in the same form.
    pub os_sw_version: u32,
    /// Version of the board: a number chosen by the firmware.
    pub board_version: u32,
    /// The first eight bytes of the firmware's commit hash.
    pub flight_custom_version: [u8; 8],
    /// USB vendor id of the board.
    pub vendor_id: u16,
    /// USB product id of the board.
    pub product_id: u16,
    /// The board's unique number, in the first form.
    pub uid: u64,
    /// The board's unique number, in the second form. Ground stations use it to tell vehicles apart.
    pub uid2: [u8; 18],
}

impl Identity {
    /// Nothing given.
    pub const NONE: Self = Self {
        capabilities: MavProtocolCapability::EMPTY,
        flight_sw_version: 0,
        middleware_sw_version: 0,
        os_sw_version: 0,
        board_version: 0,
        flight_custom_version: [0; 8],
        vendor_id: 0,
        product_id: 0,
        uid: 0,
        uid2: [0; 18],
    };
}
