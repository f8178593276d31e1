//! What a link accepts, and whether it signs (G-9, G-16, SEC-6).

use crate::dialect::RadioStatus;

/// Which frames are accepted on a link. A frame whose signature is wrong, or was seen before, is accepted on none (G-10).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Accept {
    /// Signed ones and unsigned ones: a wire that nobody else gets at.
    Open,
    /// Signed ones, and unsigned ones with these message ids. As long as the vehicle has no key, all.
    SignedExcept(&'static [u32]),
    /// Signed ones; as long as the vehicle has no key, none.
    Required,
}

impl Accept {
    /// Whether an unsigned message, as every MAVLink 1 frame has one, is accepted by a vehicle that has a key, or has not.
    pub(crate) fn takes_unsigned(self, id: u32, has_key: bool) -> bool {
        match self {
            Self::Open => true,
            Self::SignedExcept(ids) => !has_key || ids.contains(&id),
            Self::Required => false,
        }
    }
}

/// What a link does about signatures; it matters to a vehicle that has a memory for them
/// ([`Vehicle::signing`](crate::Vehicle::signing)). One that has none accepts nothing on a link that is not
/// [open](Accept::Open).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkSigning {
    /// Which frames are accepted.
    pub accept: Accept,
    /// Whether the key may be set, and taken away, by SETUP_SIGNING on this link (G-11). It goes over the line as it is, so set
    /// this only for a wire that cannot be eavesdropped. Such a link signs, so that the peer that has set the key can see that
    /// it is in use. As long as there is no key, SETUP_SIGNING is accepted here unsigned, even if nothing else is. On an
    /// [open](Accept::Open) link, an unsigned text tells a station that it signs with a wrong key, at most every 10 s.
    pub provisioning: bool,
    /// Whether what is sent is signed, once there is a key; then it is MAVLink 2 from the start (V-3).
    pub sign_out: bool,
}

impl LinkSigning {
    /// Signs, and accepts signed and unsigned frames: what a link does at first.
    pub const OPEN: Self = Self { accept: Accept::Open, provisioning: false, sign_out: true };

    /// Signs, and accepts signed frames and, from radios, which cannot sign, RADIO_STATUS; all as long as there is no key.
    pub const SIGNED: Self =
        Self { accept: Accept::SignedExcept(&[<RadioStatus as crate::Message>::ID]), ..Self::OPEN };

    /// Signs, and accepts signed frames only.
    pub const REQUIRED: Self = Self { accept: Accept::Required, ..Self::OPEN };

    /// The same, and SETUP_SIGNING is taken.
    #[must_use]
    pub const fn with_provisioning(self) -> Self {
        Self { provisioning: true, ..self }
    }

    pub(crate) const fn signs(&self) -> bool {
        self.sign_out || self.provisioning
    }
}
