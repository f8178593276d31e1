//! The outbound half of a link: one frame at a time (SEC-2), written in place by the service whose turn it is.

use super::LinkId;
use crate::dialect::Heartbeat;
use crate::frame::{Address, Header, MAX_FRAME_LEN, Version, wrap};
use crate::message::{Message, MessageInfo};

/// Room for one outbound frame. Services write into it only while it is empty.
#[derive(Clone, Debug)]
pub(crate) struct Outbox {
    link: LinkId,
    source: Address,
    /// What the link sends now (V-1).
    version: Version,
    seq: u8,
    bytes: [u8; MAX_FRAME_LEN],
    /// The frame is `bytes[start..end]`, and what of it was sent ends at `sent`.
    start: usize,
    end: usize,
    sent: usize,
}

/// Where the payload stands: behind the longer header.
const PAYLOAD_AT: usize = Version::V2.header_len();

impl Outbox {
    /// Before it is [configured](Self::configure); all zero bits.
    pub(crate) const VACANT: Self = Self {
        link: LinkId(0),
        source: Address::new(0, 0),
        version: Version::V1,
        seq: 0,
        bytes: [0; MAX_FRAME_LEN],
        start: 0,
        end: 0,
        sent: 0,
    };

    pub(crate) const fn configure(&mut self, link: LinkId, source: Address, version: Version) {
        self.link = link;
        self.source = source;
        self.version = version;
    }

    /// Sends as another one from the next frame on.
    pub(crate) const fn set_source(&mut self, source: Address) {
        self.source = source;
    }

    /// Which link this is.
    pub(crate) const fn link(&self) -> LinkId {
        self.link
    }

    /// What the link sends (V-8).
    pub(crate) const fn version(&self) -> Version {
        self.version
    }

    pub(crate) const fn set_version(&mut self, version: Version) {
        self.version = version;
    }

    /// The sequence number of the next frame.
    pub(crate) const fn seq(&self) -> u8 {
        self.seq
    }

    /// Sends `message` in the link's version. A message that v1 cannot carry is not sent (S-10): false.
    pub(crate) fn send<M: Message>(&mut self, message: &M) -> bool {
        self.send_as(self.version, message)
    }

    /// Sends `message` in `version`, whatever the link's own (V-6).
    pub(crate) fn send_as<M: Message>(&mut self, version: Version, message: &M) -> bool {
        // At a constant place, whatever the version, so that the encoders need no checks.
        let payload = self.bytes.last_chunk_mut::<{ MAX_FRAME_LEN - PAYLOAD_AT }>();
        if payload.and_then(|payload| message.encode(payload)).is_none() {
            return false;
        }
        self.finish(const { &M::INFO }, version)
    }

    /// Makes the payload that stands in its place a frame. Compiled once for all messages.
    #[inline(never)]
    fn finish(&mut self, info: &MessageInfo, version: Version) -> bool {
        let Ok(frame) = wrap(info, version, self.source, self.seq, &mut self.bytes, PAYLOAD_AT) else { return false };
        self.seq = self.seq.wrapping_add(1);
        self.start = frame.start;
        self.sent = frame.start;
        self.end = frame.end;
        true
    }

    /// Whether there is room for a frame.
    pub(crate) const fn is_empty(&self) -> bool {
        self.sent >= self.end
    }

    /// What is still to be handed to the transport.
    pub(crate) fn pending(&self) -> &[u8] {
        self.bytes.get(self.sent..self.end).unwrap_or_default()
    }

    /// The transport took `len` bytes.
    pub(crate) fn advance(&mut self, len: usize) {
        self.sent = self.sent.saturating_add(len).min(self.end);
    }

    /// Sends an unfinished frame from its first byte again: who heard the front of it is gone. But not a heartbeat: it says
    /// how things are now.
    pub(crate) fn restart(&mut self) {
        if self.is_empty() {
            return;
        }
        let frame = self.bytes.get(self.start..self.end).unwrap_or_default();
        let is_heartbeat = Header::parse(frame).is_some_and(|header| header.id == Heartbeat::ID);
        self.sent = if is_heartbeat { self.end } else { self.start };
    }
}
