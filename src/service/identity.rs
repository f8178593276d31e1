//! AUTOPILOT_VERSION and PROTOCOL_VERSION: who we are, and what we can.

use crate::dialect::{AutopilotVersion, MavProtocolCapability, ProtocolVersion};
use crate::frame::Version;
use crate::link::Outbox;

/// What AUTOPILOT_VERSION says of the vehicle. All zero means "not said".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identity {
    /// Capabilities that the firmware adds. What the stack does it announces by itself, exactly as compiled.
    pub capabilities: MavProtocolCapability,
    /// Version of the firmware: major, minor, patch, `FIRMWARE_VERSION_TYPE`, a byte each, the major one on top.
    pub flight_sw_version: u32,
    /// Version of the middleware, in the same form.
    pub middleware_sw_version: u32,
    /// Version of the operating system, in the same form.
    pub os_sw_version: u32,
    /// Version of the board; the firmware's own number.
    pub board_version: u32,
    /// Front of the firmware's commit hash: its first eight bytes.
    pub flight_custom_version: [u8; 8],
    /// USB vendor id of the board.
    pub vendor_id: u16,
    /// USB product id of the board.
    pub product_id: u16,
    /// The board's unique number, first form.
    pub uid: u64,
    /// The board's unique number, second form; ground stations tell vehicles apart by it.
    pub uid2: [u8; 18],
}

impl Identity {
    /// Nothing said.
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

/// A set of messages that the stack owes on a link because somebody asked: a flag each, so a request is never refused
/// for want of room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Owed(u8);

impl Owed {
    pub(crate) const NONE: Self = Self(0);
    pub(crate) const AUTOPILOT_VERSION: Self = Self(1);
    pub(crate) const PROTOCOL_VERSION: Self = Self(2);
    /// Of the modes; also when the mode has changed.
    pub(crate) const CURRENT_MODE: Self = Self(4);
    pub(crate) const AVAILABLE_MODES: Self = Self(8);
    pub(crate) const AVAILABLE_MODES_MONITOR: Self = Self(16);
    /// Not a message: CURRENT_MODE does not go with the next HEARTBEAT.
    pub(crate) const NO_MODE_NEXT: Self = Self(128);

    pub(crate) fn add(&mut self, other: Self) {
        self.0 |= other.0;
    }

    pub(crate) const fn is_empty(self) -> bool {
        self.0 & !Self::NO_MODE_NEXT.0 == 0
    }

    pub(crate) fn take(&mut self, other: Self) -> bool {
        let had = self.0 & other.0 != 0;
        self.0 &= !other.0;
        had
    }

    /// Sends one of the messages that say who we are. False when none is owed.
    pub(crate) fn next(&mut self, identity: &Identity, own: MavProtocolCapability, tx: &mut Outbox) -> bool {
        if self.take(Self::AUTOPILOT_VERSION) {
            return tx.send(&AutopilotVersion {
                capabilities: identity.capabilities | own,
                flight_sw_version: identity.flight_sw_version,
                middleware_sw_version: identity.middleware_sw_version,
                os_sw_version: identity.os_sw_version,
                board_version: identity.board_version,
                flight_custom_version: identity.flight_custom_version,
                vendor_id: identity.vendor_id,
                product_id: identity.product_id,
                uid: identity.uid,
                uid2: identity.uid2,
                ..Default::default()
            });
        }
        if self.take(Self::PROTOCOL_VERSION) {
            // As v2 whatever the link sends: that it arrives is the answer (V-6).
            let message = ProtocolVersion { version: 200, min_version: 100, max_version: 200, ..Default::default() };
            return tx.send_as(Version::V2, &message);
        }
        false
    }
}
