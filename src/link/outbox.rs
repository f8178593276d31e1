//! The outbound half of a link: one frame at a time (SEC-2), written in place by the service that sends it.

use crate::dialect::Heartbeat;
use crate::frame::{Header, MAX_FRAME_LEN, Version, wrap};
#[cfg(feature = "signing")]
use crate::frame::{INCOMPAT_SIGNED, SIGNATURE_LEN, SigningKey};
use crate::message::{Address, ComponentId, Message, MessageInfo};
use crate::time::Duration;
use crate::types::{Component, Firmware, LinkClass, LinkId, MAX_COMPONENTS};

/// Two checksum bits of each of the last 256 frames, by sequence number. An echo always matches them; of another
/// vehicle's frames, three of four do not (H-14).
#[derive(Clone, Copy, Debug)]
struct Fingerprints([u8; 64]);

impl Fingerprints {
    const NONE: Self = Self([0; 64]);

    fn note(&mut self, seq: u8, checksum: u8) {
        let shift = Self::shift(seq);
        if let Some(cell) = self.0.get_mut(usize::from(seq >> 2)) {
            *cell = (*cell & !3_u8.wrapping_shl(shift)) | (checksum & 3).wrapping_shl(shift);
        }
    }

    fn agree(&self, seq: u8, checksum: u8) -> bool {
        (self.cell(seq).wrapping_shr(Self::shift(seq)) ^ checksum) & 3 == 0
    }

    /// Returns the byte that has the bits of a sequence number.
    fn cell(&self, seq: u8) -> u8 {
        self.0.get(usize::from(seq >> 2)).copied().unwrap_or(0)
    }

    fn set_cell(&mut self, seq: u8, bits: u8) {
        if let Some(cell) = self.0.get_mut(usize::from(seq >> 2)) {
            *cell = bits;
        }
    }

    /// Returns the position of a sequence number's bits in their byte.
    fn shift(seq: u8) -> u32 {
        u32::from((seq & 3) << 1)
    }
}

/// The state of the autopilot that a frame of another component must not change.
struct Source {
    component: ComponentId,
    seq: u8,
    has_wrapped: bool,
    fingerprint: u8,
}

/// Room for one outbound frame. Services write into it only while it is empty.
#[derive(Clone, Debug)]
pub(crate) struct Outbox {
    link: LinkId,
    source: Address,
    class: LinkClass,
    /// How far the stack's clock is ahead of the firmware's.
    lead: Duration,
    /// The version that the link sends now (V-1).
    version: Version,
    /// The next sequence number: one sequence for each component on each link (S-16).
    seq: u8,
    /// Those of the firmware's other components: each has its own.
    other_seqs: [u8; MAX_COMPONENTS],
    /// Whether every sequence number has been used.
    has_wrapped: bool,
    fingerprints: Fingerprints,
    bytes: [u8; MAX_FRAME_LEN],
    /// Whether the next frame will be signed.
    #[cfg(feature = "signing")]
    signs: bool,
    #[cfg(feature = "signing")]
    signature: Signature,
    /// The frame is `bytes[start..end]`; everything before `sent` was sent.
    start: u16,
    end: u16,
    sent: u16,
    /// The start of a frame that was cut off, which is sent again behind the HEARTBEAT of a link that opens; 0 if there is none.
    later: u16,
    /// The sequence number of that HEARTBEAT: the one before the next frame's, which the new peer would otherwise count as lost.
    first_seq: u8,
    #[cfg(feature = "signing")]
    later_signature: Signature,
}

/// The state of the frame's signature.
#[cfg(feature = "signing")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Signature {
    /// The frame needs no signature of ours.
    None,
    /// The header announces a signature that is not made yet.
    Due,
    Made,
}

/// The end of a frame that is set aside, without its signature: at the end of the buffer.
const LATER_END: u16 = if cfg!(feature = "signing") { 267 } else { 280 };

/// The least start of a frame that is set aside: behind a HEARTBEAT and its signature.
const LEAST_LATER: u16 = 34;

/// The position of the payload: after the longer header.
const PAYLOAD_AT: usize = Version::V2.header_len();

impl Outbox {
    /// An outbox before it is [configured](Self::configure): all zero bits.
    pub(crate) const VACANT: Self = Self {
        link: LinkId(0),
        source: Address::new(0, 0),
        class: LinkClass::Normal,
        lead: Duration::ZERO,
        version: Version::V1,
        seq: 0,
        other_seqs: [0; MAX_COMPONENTS],
        has_wrapped: false,
        fingerprints: Fingerprints::NONE,
        bytes: [0; MAX_FRAME_LEN],
        #[cfg(feature = "signing")]
        signs: false,
        #[cfg(feature = "signing")]
        signature: Signature::None,
        start: 0,
        end: 0,
        sent: 0,
        later: 0,
        first_seq: 0,
        #[cfg(feature = "signing")]
        later_signature: Signature::None,
    };

    pub(crate) const fn configure(&mut self, link: LinkId, source: Address, version: Version) {
        self.link = link;
        self.source = source;
        self.version = version;
    }

    /// Sets the class of the link, which determines the messages that may be sent from the next frame on.
    pub(crate) const fn set_class(&mut self, class: LinkClass) {
        self.class = class;
    }

    /// Sets the source address from the next frame on.
    pub(crate) const fn set_source(&mut self, source: Address) {
        self.source = source;
    }

    /// Sets how far the stack's clock is ahead of the firmware's.
    pub(crate) const fn set_lead(&mut self, lead: Duration) {
        self.lead = lead;
    }

    /// Returns how far the stack's clock is ahead of the firmware's.
    pub(crate) const fn lead(&self) -> Duration {
        self.lead
    }

    /// Returns the link.
    pub(crate) const fn link(&self) -> LinkId {
        self.link
    }

    /// Returns the version that the link sends (V-8).
    pub(crate) const fn version(&self) -> Version {
        self.version
    }

    pub(crate) const fn set_version(&mut self, version: Version) {
        self.version = version;
    }

    /// Whether message `id` can be sent: the link's class [allows](LinkClass::may_send) it, and MAVLink 1 has room for
    /// its id (S-10).
    pub(crate) fn takes(&self, id: u32) -> bool {
        self.class.may_send(id) && (id <= 255 || self.version == Version::V2)
    }

    /// Sets whether frames are signed from now on. Each then [needs a signature](Self::needs_signature).
    #[cfg(feature = "signing")]
    pub(crate) const fn set_signs(&mut self, signs: bool) {
        self.signs = signs;
    }

    /// Whether the frame must be [signed](Self::sign) before it is sent.
    #[cfg(feature = "signing")]
    pub(crate) fn needs_signature(&self) -> bool {
        self.signature == Signature::Due && !self.is_empty()
    }

    /// Signs the frame with the link's id. Without a key or a timestamp, the frame is dropped.
    #[cfg(feature = "signing")]
    pub(crate) fn sign(&mut self, with: Option<(&SigningKey, u64)>) {
        let frame = usize::from(self.start)..usize::from(self.end);
        let end = with.and_then(|(key, timestamp)| key.sign(&mut self.bytes, frame, self.link.0, timestamp));
        self.signature = Signature::Made;
        match end {
            Some(end) => self.end = short(end),
            None => self.sent = self.end,
        }
    }

    /// Whether a frame with this sequence number and low checksum byte can be one of the last 256 frames sent on this link.
    pub(crate) fn may_have_sent(&self, seq: u8, checksum: u8) -> bool {
        (self.has_wrapped || seq < self.seq) && self.fingerprints.agree(seq, checksum)
    }

    /// Sends `message` in the link's version. Returns false, and sends nothing, if MAVLink 1 cannot carry it (S-10), or
    /// if the link's class [forbids](LinkClass::may_send) it.
    pub(crate) fn send<M: Message>(&mut self, message: &M) -> bool {
        self.send_like(message, const { &M::INFO })
    }

    /// Sends `message` as the one with this `info`, which has the same fields.
    pub(crate) fn send_like<M: Message>(&mut self, message: &M, info: &MessageInfo) -> bool {
        // The payload has the same position in both versions, so the encoders need no checks.
        let payload = self.bytes.last_chunk_mut::<{ MAX_FRAME_LEN - PAYLOAD_AT }>();
        if payload.and_then(|payload| message.encode(payload)).is_none() {
            return false;
        }
        self.finish(info)
    }

    /// Sends the message with this `info`, whose untrimmed payload `write` writes in place: all of it. Returns false, and sends
    /// nothing, if `write` does, or as [`send`](Self::send).
    pub(crate) fn compose<const N: usize>(
        &mut self,
        info: &MessageInfo,
        write: impl FnOnce(&mut [u8; N]) -> bool,
    ) -> bool {
        let payload = self.bytes.get_mut(PAYLOAD_AT..).and_then(<[u8]>::first_chunk_mut);
        payload.is_some_and(write) && self.finish(info)
    }

    /// Has `send` send as another component of the firmware, with its own sequence number; as the autopilot if there is no such
    /// component.
    pub(crate) fn as_component<F: Firmware>(
        &mut self,
        component: Option<ComponentId>,
        send: impl FnOnce(&mut Self) -> bool,
    ) -> bool {
        let is_it = |other: &Component| Some(other.id) == component;
        let found = F::COMPONENTS.iter().position(is_it).zip(component);
        let autopilot = found.map(|(number, component)| (number, self.swap_source(number, component)));
        let sent = send(self);
        if let Some((number, autopilot)) = autopilot {
            self.restore_source(number, autopilot);
        }
        sent
    }

    /// Sends `message` as another component of the firmware (K-10): see [`as_component`](Self::as_component).
    pub(crate) fn send_from<F: Firmware, M: Message>(&mut self, component: Option<ComponentId>, message: &M) -> bool {
        self.as_component::<F>(component, |outbox| outbox.send(message))
    }

    /// Returns the component that sends.
    pub(crate) const fn component(&self) -> ComponentId {
        self.source.component
    }

    /// Makes another component the source. Returns the autopilot's part.
    fn swap_source(&mut self, number: usize, component: ComponentId) -> Source {
        let seq = self.other_seqs.get(number).copied().unwrap_or(0);
        let autopilot = Source {
            component: core::mem::replace(&mut self.source.component, component),
            seq: core::mem::replace(&mut self.seq, seq),
            has_wrapped: self.has_wrapped,
            fingerprint: self.fingerprints.cell(seq),
        };
        self.has_wrapped = false;
        autopilot
    }

    /// Makes the autopilot the source again.
    fn restore_source(&mut self, number: usize, autopilot: Source) {
        let Source { component, seq, has_wrapped, fingerprint } = autopilot;
        if let Some(other) = self.other_seqs.get_mut(number) {
            // Only the autopilot's frames are recognised as echoes.
            self.fingerprints.set_cell(*other, fingerprint);
            *other = self.seq;
        }
        self.source.component = component;
        (self.seq, self.has_wrapped) = (seq, has_wrapped);
    }

    /// Sends `message` in `version`, whatever the link's own (V-6).
    pub(crate) fn send_as<M: Message>(&mut self, version: Version, message: &M) -> bool {
        let own = core::mem::replace(&mut self.version, version);
        let sent = self.send(message);
        self.version = own;
        sent
    }

    /// Completes the frame around the payload. Compiled once for all messages, and with one argument because it has
    /// many callers.
    fn finish(&mut self, info: &MessageInfo) -> bool {
        let version = self.version;
        // Heartbeats, plans and other normal traffic stay off high-latency links (H-7, L-2, L-4, M-13).
        if !self.class.may_send(info.id()) {
            event!("tx: message {=u32} is not for link {=u8}", info.id(), self.link.0);
            return false;
        }
        #[cfg(feature = "signing")]
        let flags = if self.signs && version == Version::V2 { INCOMPAT_SIGNED } else { 0 };
        #[cfg(not(feature = "signing"))]
        let flags = 0;
        // Only a HEARTBEAT is sent while a frame is set aside.
        let is_first = self.later != 0;
        let seq = if is_first { self.first_seq } else { self.seq };
        let Ok(frame) = wrap(info, version, flags, self.source, seq, &mut self.bytes, PAYLOAD_AT) else {
            return false;
        };
        #[cfg(feature = "signing")]
        {
            self.signature = if flags == 0 { Signature::None } else { Signature::Due };
        }
        let checksum = self.bytes.get(frame.end.wrapping_sub(2)).copied().unwrap_or(0);
        self.fingerprints.note(seq, checksum);
        if !is_first {
            self.seq = self.seq.wrapping_add(1);
            self.has_wrapped |= self.seq == 0;
        }
        self.start = short(frame.start);
        self.sent = self.start;
        self.end = short(frame.end);
        true
    }

    /// Sends another component's frame unchanged, with its own sequence number and signature. Returns false, and
    /// sends nothing, if a high-latency link must not send it.
    pub(crate) fn forward(&mut self, frame: [&[u8]; 2]) -> bool {
        let mut len = 0usize;
        for part in frame {
            for (cell, byte) in self.bytes.get_mut(len..).unwrap_or_default().iter_mut().zip(part) {
                *cell = *byte;
            }
            len = len.saturating_add(part.len()).min(MAX_FRAME_LEN);
        }
        let id = Header::parse(&self.bytes).map(|header| header.id);
        if self.class == LinkClass::HighLatency && !id.is_some_and(|id| self.class.may_send(id)) {
            return false;
        }
        (self.start, self.sent, self.end) = (0, 0, short(len));
        #[cfg(feature = "signing")]
        {
            self.signature = Signature::None;
        }
        true
    }

    /// Returns the length of the frame, with the signature that it still needs.
    pub(crate) fn len(&self) -> usize {
        let len = self.pending().len();
        #[cfg(feature = "signing")]
        if self.needs_signature() {
            return len.saturating_add(SIGNATURE_LEN);
        }
        len
    }

    /// Whether there is room for a frame.
    pub(crate) const fn is_empty(&self) -> bool {
        self.sent >= self.end
    }

    /// Returns the bytes that are still to be handed to the transport.
    pub(crate) fn pending(&self) -> &[u8] {
        self.bytes.get(usize::from(self.sent)..usize::from(self.end)).unwrap_or_default()
    }

    /// Records that the transport took `len` bytes.
    pub(crate) fn advance(&mut self, len: usize) {
        self.sent = self.sent.saturating_add(short(len)).min(self.end);
    }

    /// Whether a frame is pending, in whole or in part.
    pub(crate) const fn has_frame(&self) -> bool {
        !self.is_empty() || self.later != 0
    }

    /// Makes the frame that was set aside the next one, if there is one.
    pub(crate) fn resume(&mut self) -> bool {
        let has_one = self.later != 0;
        if has_one {
            (self.start, self.sent, self.end) = (self.later, self.later, LATER_END);
            self.later = 0;
            #[cfg(feature = "signing")]
            {
                self.signature = self.later_signature;
            }
        }
        has_one
    }

    /// Sets the frame aside: a HEARTBEAT precedes it (H-17). One that leaves no room for it, over 230 bytes of bulk data,
    /// is dropped.
    fn set_aside(&mut self) {
        let (start, end) = (usize::from(self.start), usize::from(self.end));
        let later = LATER_END.saturating_sub(self.end.saturating_sub(self.start));
        self.sent = self.end;
        if later < LEAST_LATER {
            return;
        }
        // A plain loop, from the end on, because the places may overlap: see `Decoder::compact`.
        let cells = core::cell::Cell::from_mut(&mut self.bytes[..]).as_slice_of_cells();
        let (from, to) =
            (cells.get(start..end).unwrap_or_default(), cells.get(usize::from(later)..).unwrap_or_default());
        for (to, from) in to.iter().take(from.len()).zip(from).rev() {
            to.set(from.get());
        }
        self.later = later;
        #[cfg(feature = "signing")]
        {
            self.later_signature = self.signature;
        }
    }

    /// Sends an unfinished frame from its first byte again: the peer that received its start is gone. A heartbeat is
    /// dropped instead, because it reports the current state. `is_held`: a heartbeat comes first.
    pub(crate) fn restart(&mut self, is_held: bool) {
        if self.is_empty() {
            return;
        }
        #[cfg(feature = "signing")]
        if self.signature == Signature::Made {
            self.end = self.end.saturating_sub(short(SIGNATURE_LEN));
            self.signature = Signature::Due;
        }
        let frame = self.bytes.get(usize::from(self.start)..usize::from(self.end)).unwrap_or_default();
        let Some(Header { id, source, seq, .. }) = Header::parse(frame) else { return };
        let is_heartbeat = id == Heartbeat::ID;
        self.sent = if is_heartbeat { self.end } else { self.start };
        if is_held && !is_heartbeat {
            let next = if source == self.source { seq } else { self.seq };
            self.first_seq = next.wrapping_sub(1);
            self.set_aside();
        }
    }
}

/// Converts a position in a frame.
fn short(place: usize) -> u16 {
    u16::try_from(place).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::{Attitude, CommandAck, Common, HighLatency2, Statustext};
    use crate::message::Dialect;

    #[test]
    fn only_allowed_messages_are_sent_by_satellite() {
        // L-2, L-4: this includes messages that a service sends by mistake.
        let mut outbox = Outbox::VACANT;
        outbox.configure(LinkId(3), Address::new(1, 1), Version::V2);
        outbox.set_class(LinkClass::HighLatency);
        assert!(!outbox.send(&Heartbeat::default()));
        assert!(!outbox.send(&Attitude::default()));
        assert!(!outbox.send_as(Version::V1, &Statustext::default()));
        assert_eq!((outbox.seq, outbox.pending()), (0, &[][..]), "no sequence number is used up");
        assert!(outbox.send(&HighLatency2::default()));
        assert!(outbox.send(&CommandAck::default()));
        outbox.set_class(LinkClass::Normal);
        assert!(!outbox.send(&HighLatency2::default()));
        assert!(outbox.send(&Heartbeat::default()));
    }

    #[test]
    fn allowed_messages_are_these() {
        let ids =
            |class: LinkClass| Common::MESSAGES.rows().iter().map(|row| row.id()).filter(move |id| class.may_send(*id));
        assert!(ids(LinkClass::HighLatency).eq([75, 76, 77, 80, 235]));
        assert_eq!(ids(LinkClass::Normal).count(), Common::MESSAGES.rows().len() - 1);
    }
}
