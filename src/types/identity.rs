//! The identity of the vehicle's hardware and firmware, as reported to ground stations.

use crate::dialect::{FirmwareVersionType, MavProtocolCapability};

/// The content of AUTOPILOT_VERSION. All zero means "not given".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identity {
    /// Capabilities that the firmware adds. The stack announces its own, according to the declaration and the Cargo
    /// features (Q-9).
    pub capabilities: MavProtocolCapability,
    /// Version of the firmware: major, minor, patch and `FIRMWARE_VERSION_TYPE`, one byte each, the major version in
    /// the highest byte. [`firmware_version!`](crate::firmware_version) returns that of the firmware's crate.
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
    /// The board's unique number: ground stations tell vehicles apart by it. For more than 8 bytes use `uid2`.
    pub uid: u64,
    /// The board's unique number, if it has more than 8 bytes. Unless it is 0, it takes the place of `uid`.
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

/// Returns the version of the crate that calls it, as its `Cargo.toml` says, for
/// [`Identity::flight_sw_version`](crate::config::Identity::flight_sw_version). Ground stations show it.
///
/// ```
/// use mavstack::config::Identity;
/// use mavstack::{Address, Config, Pulse, firmware_version};
///
/// static PULSE: Pulse = Pulse::new();
/// const CONFIG: Config = Config {
///     identity: Identity { flight_sw_version: firmware_version!(), board_version: 3, ..Identity::NONE },
///     ..Config::new(Address::new(1, 1), &PULSE)
/// };
/// ```
///
/// Version 1.2.3 is an official one. A pre-release whose name begins with `alpha`, `beta` or `rc` has that type, any other is a
/// development version. A number above 255 does not compile.
#[macro_export]
macro_rules! firmware_version {
    () => {
        const {
            $crate::__private::version(
                [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR"), env!("CARGO_PKG_VERSION_PATCH")],
                env!("CARGO_PKG_VERSION_PRE"),
            )
        }
    };
}

/// Returns a version in the form of [`Identity::flight_sw_version`].
#[doc(hidden)]
pub const fn version([major, minor, patch]: [&str; 3], pre_release: &str) -> u32 {
    let FirmwareVersionType(kind) = match pre_release.as_bytes() {
        [] => FirmwareVersionType::OFFICIAL,
        [b'a', b'l', b'p', b'h', b'a', ..] => FirmwareVersionType::ALPHA,
        [b'b', b'e', b't', b'a', ..] => FirmwareVersionType::BETA,
        [b'r', b'c', ..] => FirmwareVersionType::RC,
        _ => FirmwareVersionType::DEV,
    };
    u32::from_be_bytes([number(major), number(minor), number(patch), kind])
}

/// Returns a part of a version.
#[allow(clippy::panic, reason = "at compile time")]
const fn number(text: &str) -> u8 {
    match u8::from_str_radix(text, 10) {
        Ok(number) => number,
        Err(_) => panic!("a number of `flight_sw_version` is at most 255: set it by hand"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn version_has_the_type_of_its_pre_release() {
        for (pre_release, kind) in [("", 255), ("alpha.1", 64), ("beta", 128), ("rc.2", 192), ("nightly", 0), ("r", 0)]
        {
            assert_eq!(version(["1", "20", "255"], pre_release).to_be_bytes(), [1, 20, 255, kind], "{pre_release}");
        }
    }
}
