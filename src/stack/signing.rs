//! Signing, joined to the rest. Without the feature, or for a vehicle that has no memory for it, nothing of it is linked.

#[cfg(feature = "signing")]
pub(super) use crate::service::signing::{
    admits, age, believes_unsigned, cost, cost_of_sending, key_of, knows_sender, next, on_frame, prepare, sign,
    signed_at, vouches_for,
};
#[cfg(not(feature = "signing"))]
pub(super) use without::*;

/// Every frame counts as unsigned, and every link is open.
#[cfg(not(feature = "signing"))]
mod without {
    use crate::dialect::SetupSigning;
    use crate::frame::Frame;
    use crate::link::Port;
    use crate::message::Message;
    use crate::service::command::SignedAt;
    use crate::stack::count;
    use crate::time::{Duration, Instant};
    use crate::vehicle::Vehicle;

    pub(crate) fn admits(_: Instant, _: &mut Port, _: &Frame<'_>, _: &mut impl Vehicle) -> bool {
        true
    }

    pub(crate) fn knows_sender(_: &Port, _: &Frame<'_>, _: &mut impl Vehicle) -> bool {
        true
    }

    pub(crate) fn age(_: Instant, _: &Frame<'_>, _: &mut impl Vehicle) -> Option<Duration> {
        None
    }

    pub(crate) fn signed_at(_: &Frame<'_>, _: &mut impl Vehicle) -> SignedAt {
        None
    }

    pub(crate) fn believes_unsigned(_: &Port, _: u32, _: &mut impl Vehicle) -> bool {
        true
    }

    pub(crate) fn key_of(_: &mut impl Vehicle) -> Option<()> {
        None
    }

    pub(crate) fn vouches_for(_: &[u8], _: Option<()>, _: &mut u32) -> bool {
        false
    }

    pub(crate) fn cost(_: &Frame<'_>, _: &mut impl Vehicle) -> u32 {
        0
    }

    pub(crate) fn cost_of_sending(_: &[u8]) -> u32 {
        0
    }

    /// SETUP_SIGNING is dropped: nobody here has business with somebody's key (G-11).
    pub(crate) fn on_frame(_: Instant, port: &mut Port, frame: &Frame<'_>, _: bool, _: &mut impl Vehicle) -> bool {
        let has_key = frame.id() == SetupSigning::ID;
        if has_key {
            count(&mut port.counters.out_of_place);
        }
        has_key
    }

    pub(crate) fn next(_: &mut Port) -> bool {
        false
    }

    pub(crate) fn prepare(_: Instant, _: &mut Port, _: &mut impl Vehicle) {}

    pub(crate) fn sign(_: Instant, _: &mut Port, _: &mut impl Vehicle) {}
}
