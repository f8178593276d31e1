//! Which frames a link accepts, and whether it signs (G-9, G-16, SEC-6).

use crate::dialect::RadioStatus;

/// Which frames are accepted on a link. A frame with a wrong signature, or with a signature that was seen before, is
/// accepted on no link (G-10).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Accept {
    /// Signed and unsigned frames: for a wire that no one else can reach.
    Open,
    /// Signed frames, and unsigned frames with these message ids; all frames as long as the vehicle has no key.
    SignedExcept(&'static [u32]),
    /// Signed frames only; none as long as the vehicle has no key.
    Required,
}

impl Accept {
    /// Whether an unsigned message is accepted. Every MAVLink 1 frame is unsigned. `has_key`: the vehicle has a key.
    pub(crate) fn accepts_unsigned(self, id: u32, has_key: bool) -> bool {
        match self {
            Self::Open => true,
            Self::SignedExcept(ids) => !has_key || ids.contains(&id),
            Self::Required => false,
        }
    }
}

/// How a link handles signatures, in a stack that declares `signing` in [`#[stack]`](macro@crate::Stack). A stack
/// without `signing` accepts nothing on a link that is not [open](Accept::Open).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkSigning {
    /// Which frames are accepted.
    pub accept: Accept,
    /// Whether SETUP_SIGNING may set and remove the key on this link (G-11). The message carries the key in plain text,
    /// so set this only for a wire that cannot be eavesdropped on. Such a link signs, so that the peer that set the key
    /// can see that it is in use.
    ///
    /// As long as there is no key, this link accepts an unsigned SETUP_SIGNING, even if it accepts nothing else
    /// unsigned. On an [open](Accept::Open) link, an unsigned text tells a station that it signs with a wrong key, at
    /// most every 10 s.
    pub provisioning: bool,
    /// Whether sent frames are signed once there is a key. They are then MAVLink 2 from the start (V-3).
    pub sign_out: bool,
}

impl LinkSigning {
    /// Signs, and accepts signed and unsigned frames. The default of a link.
    pub const OPEN: Self = Self { accept: Accept::Open, provisioning: false, sign_out: true };

    /// Signs, and accepts signed frames and unsigned RADIO_STATUS, because radios cannot sign. Accepts all frames as
    /// long as there is no key.
    pub const SIGNED: Self =
        Self { accept: Accept::SignedExcept(&[<RadioStatus as crate::Message>::ID]), ..Self::OPEN };

    /// Signs, and accepts signed frames only.
    pub const REQUIRED: Self = Self { accept: Accept::Required, ..Self::OPEN };

    /// Returns the same configuration with SETUP_SIGNING accepted.
    #[must_use]
    pub const fn with_provisioning(self) -> Self {
        Self { provisioning: true, ..self }
    }

    pub(crate) const fn signs(&self) -> bool {
        self.sign_out || self.provisioning
    }
}
