//! What a station has received.

use crate::Received;
use mavstack::dialect::{Heartbeat, MavAutopilot, MavModeFlag, MavSeverity, MavType, Statustext};
use mavstack::{Address, Instant, Message};
use std::collections::{BTreeMap, VecDeque};

/// The most texts that are kept; the oldest are dropped.
const MAX_TEXTS: usize = 10_000;

/// What a station has received: vehicles, the last message of each id, texts, and counts of lost frames.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    components: BTreeMap<Address, SeenVehicle>,
    messages: BTreeMap<(Address, u32), Heard>,
    texts: VecDeque<SeenText>,
    /// Texts that were dropped from the front.
    texts_dropped: usize,
    /// The long text that each source is sending.
    chunks: BTreeMap<Address, Chunks>,
}

/// A component that was heard: its heartbeats and its sequence numbers.
#[derive(Clone, Debug)]
pub struct SeenVehicle {
    /// Its address.
    pub address: Address,
    /// The last heartbeat, if there was one.
    pub heartbeat: Option<Heartbeat>,
    /// When each heartbeat was received.
    pub heartbeats: Vec<Instant>,
    /// When a frame was received last.
    pub last: Instant,
    /// Frames received.
    pub frames: u64,
    /// Frames lost, by gaps of the sequence numbers.
    pub lost: u64,
    seq: Option<u8>,
}

impl SeenVehicle {
    /// Whether it is an autopilot: it has sent heartbeats as one.
    pub fn is_autopilot(&self) -> bool {
        self.heartbeat
            .is_some_and(|heartbeat| heartbeat.autopilot != MavAutopilot::INVALID && heartbeat.r#type != MavType::GCS)
    }

    /// Returns when the last heartbeat was received; [`Instant::ZERO`] if there was none.
    pub fn last_heartbeat(&self) -> Instant {
        self.heartbeats.last().copied().unwrap_or(Instant::ZERO)
    }

    /// Whether its last heartbeat said that it is armed.
    pub fn is_armed(&self) -> bool {
        self.heartbeat.is_some_and(|heartbeat| heartbeat.base_mode.contains(MavModeFlag::SAFETY_ARMED))
    }
}

/// The last message of an id from a source.
#[derive(Clone, Debug)]
pub struct Heard {
    /// When it was received.
    pub at: Instant,
    /// The number received.
    pub count: u64,
    payload: Vec<u8>,
}

impl Heard {
    /// Returns the payload as received.
    pub fn payload(&self) -> &[u8] {
        &self.payload
    }
}

/// A STATUSTEXT, its chunks put together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SeenText {
    /// When its last chunk was received.
    pub at: Instant,
    /// The sender.
    pub from: Address,
    /// Its severity.
    pub severity: MavSeverity,
    /// The text. A chunk that was lost is shown as `…`.
    pub text: String,
}

/// The chunks of a long text that is not complete.
#[derive(Clone, Debug)]
struct Chunks {
    id: u16,
    at: Instant,
    severity: MavSeverity,
    texts: BTreeMap<u8, Vec<u8>>,
}

impl Chunks {
    /// Returns the text up to this chunk, with `…` for those that were lost.
    fn text(&self, last: u8) -> Vec<u8> {
        (0..=last).flat_map(|seq| self.texts.get(&seq).map_or("…".as_bytes(), Vec::as_slice).to_vec()).collect()
    }
}

impl Seen {
    /// Returns all components that were heard, in order of their addresses.
    pub fn components(&self) -> impl Iterator<Item = &SeenVehicle> {
        self.components.values()
    }

    /// Returns the autopilots that were heard.
    pub fn vehicles(&self) -> impl Iterator<Item = &SeenVehicle> {
        self.components().filter(|component| component.is_autopilot())
    }

    /// Returns a component that was heard.
    pub fn component(&self, address: Address) -> Option<&SeenVehicle> {
        self.components.get(&address)
    }

    /// Returns the last `M` of any source, the most recent one.
    pub fn last<M: Message>(&self) -> Option<M> {
        self.heard::<M>().map(|heard| M::decode(&heard.payload))
    }

    /// Returns the last `M` of `from`.
    pub fn last_from<M: Message>(&self, from: Address) -> Option<M> {
        self.messages.get(&(from, M::ID)).map(|heard| M::decode(&heard.payload))
    }

    /// Returns when and how often `M` was received, of the source that sent it last.
    pub fn heard<M: Message>(&self) -> Option<&Heard> {
        let all = self.messages.iter().filter(|((_, id), _)| *id == M::ID);
        all.map(|(_, heard)| heard).max_by_key(|heard| heard.at)
    }

    /// Returns the number of `M` received from all sources.
    pub fn count<M: Message>(&self) -> u64 {
        self.messages.iter().filter(|((_, id), _)| *id == M::ID).map(|(_, heard)| heard.count).sum()
    }

    /// Returns the ids of all messages received from `from`, each with its last one.
    pub fn messages_from(&self, from: Address) -> impl Iterator<Item = (u32, &Heard)> {
        self.messages.iter().filter(move |((source, _), _)| *source == from).map(|((_, id), heard)| (*id, heard))
    }

    /// Returns the texts received, the oldest first. The last 10,000 are kept.
    pub fn texts(&self) -> impl DoubleEndedIterator<Item = &SeenText> {
        self.texts.iter()
    }

    /// Returns whether a text with `part` was received.
    pub fn has_text(&self, part: &str) -> bool {
        self.texts().any(|text| text.text.contains(part))
    }

    /// Returns the number of texts received so far: a mark for [`texts_since`](Self::texts_since).
    pub fn text_mark(&self) -> usize {
        self.texts_dropped + self.texts.len()
    }

    /// Returns the texts received since [`text_mark`](Self::text_mark) returned `mark`.
    pub fn texts_since(&self, mark: usize) -> impl DoubleEndedIterator<Item = &SeenText> {
        self.texts.iter().skip(mark.saturating_sub(self.texts_dropped))
    }

    /// Returns the last warning or error since [`text_mark`](Self::text_mark) returned `mark`: usually the reason of a refusal.
    pub fn reason_since(&self, mark: usize) -> Option<String> {
        let mut texts = self.texts_since(mark);
        texts.rfind(|text| text.severity.0 <= MavSeverity::WARNING.0).map(|text| text.text.clone())
    }

    pub(crate) fn note(&mut self, frame: &Received) {
        let (at, source) = (frame.at, frame.header.source);
        let component = self.components.entry(source).or_insert_with(|| SeenVehicle {
            address: source,
            heartbeat: None,
            heartbeats: Vec::new(),
            last: at,
            frames: 0,
            lost: 0,
            seq: None,
        });
        component.last = at;
        component.frames += 1;
        let seq = frame.header.seq;
        let gap = component.seq.map_or(0, |last| seq.wrapping_sub(last).wrapping_sub(1));
        // A greater gap is a duplicate, a late frame or a reboot.
        if gap < 128 {
            component.lost += u64::from(gap);
        }
        component.seq = Some(seq);
        if let Some(heartbeat) = frame.decode::<Heartbeat>() {
            component.heartbeat = Some(heartbeat);
            component.heartbeats.push(at);
        }
        let payload = frame.payload.clone();
        let heard = self.messages.entry((source, frame.header.id)).or_insert_with(|| Heard {
            at,
            count: 0,
            payload: Vec::new(),
        });
        *heard = Heard { at, count: heard.count + 1, payload };
        if let Some(text) = frame.decode::<Statustext>() {
            self.note_text(at, source, &text);
        }
    }

    fn note_text(&mut self, at: Instant, from: Address, message: &Statustext) {
        let (bytes, severity) = (message.text.as_bytes(), message.severity);
        if message.id == 0 {
            self.push_text(at, from, severity, bytes);
            return;
        }
        // A new text ends one whose last chunk was lost.
        if let Some(old) = self.chunks.get(&from).filter(|old| old.id != message.id).cloned() {
            let last = old.texts.keys().last().copied().unwrap_or(0);
            self.push_text(old.at, from, old.severity, &[old.text(last).as_slice(), "…".as_bytes()].concat());
            self.chunks.remove(&from);
        }
        let new = || Chunks { id: message.id, at, severity, texts: BTreeMap::new() };
        let chunks = self.chunks.entry(from).or_insert_with(new);
        chunks.at = at;
        chunks.texts.insert(message.chunk_seq, bytes.to_vec());
        // A chunk that is not full is the last one.
        if bytes.len() < message.text.wire().len() {
            let text = chunks.text(message.chunk_seq);
            self.chunks.remove(&from);
            self.push_text(at, from, severity, &text);
        }
    }

    fn push_text(&mut self, at: Instant, from: Address, severity: MavSeverity, bytes: &[u8]) {
        if self.texts.len() == MAX_TEXTS {
            self.texts.pop_front();
            self.texts_dropped += 1;
        }
        let text = String::from_utf8_lossy(bytes).into_owned();
        self.texts.push_back(SeenText { at, from, severity, text });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Client, Station};
    use mavstack::frame::Version;
    use mavstack::message::Text;

    /// A station that hears a vehicle.
    struct Ear {
        station: Station,
        vehicle: Station,
    }

    impl Ear {
        fn new() -> Self {
            let vehicle = Station::new(Client::Pymavlink).with_address(Address::new(1, 1)).with_version(Version::V2);
            Self { station: Station::new(Client::QGroundControl), vehicle }
        }

        /// The vehicle sends a message, which may be lost.
        fn say<M: Message>(&mut self, message: &M, is_lost: bool) {
            self.vehicle.send(message);
            let bytes = self.vehicle.take_output();
            if !is_lost {
                self.station.receive(Instant::ZERO, &bytes);
            }
        }

        /// The vehicle sends a text in chunks, and some are lost.
        fn chunks(&mut self, id: u16, text: &str, lost: &[usize]) {
            let bytes = text.as_bytes();
            // A text of an exact multiple ends with an empty chunk.
            for chunk in 0..=bytes.len() / 50 {
                let part = std::str::from_utf8(&bytes[chunk * 50..bytes.len().min(chunk * 50 + 50)]).expect("ASCII");
                let (severity, chunk_seq) = (MavSeverity::NOTICE, chunk as u8);
                self.say(&Statustext { severity, text: Text::new(part), id, chunk_seq }, lost.contains(&chunk));
            }
        }

        fn texts(&self) -> Vec<&str> {
            self.station.seen().texts().map(|text| text.text.as_str()).collect()
        }
    }

    #[test]
    fn chunks_make_up_a_text() {
        let mut ear = Ear::new();
        let (long, exact) = ("a".repeat(120), "b".repeat(100));
        ear.chunks(1, &long, &[]);
        ear.chunks(2, &exact, &[]);
        ear.chunks(0, "short", &[]);
        assert_eq!(ear.texts(), [&long, &exact, "short"]);
    }

    #[test]
    fn a_lost_chunk_is_shown() {
        let mut ear = Ear::new();
        let (first, last) = ("a".repeat(50), "a".repeat(20));
        ear.chunks(1, &"a".repeat(120), &[1]);
        ear.chunks(2, &"a".repeat(120), &[2]);
        assert_eq!(ear.texts(), [format!("{first}…{last}")]);
        // The next text shows that the end of the last one will not come.
        ear.chunks(3, "end", &[]);
        assert_eq!(ear.texts(), [format!("{first}…{last}"), format!("{first}{first}…"), "end".into()]);
    }

    #[test]
    fn lost_frames_are_counted_and_a_reboot_is_not_a_loss() {
        let mut ear = Ear::new();
        for is_lost in [false, true, true, false] {
            ear.say(&Heartbeat::default(), is_lost);
        }
        let lost = |ear: &Ear| ear.station.seen().component(Address::new(1, 1)).map(|heard| (heard.frames, heard.lost));
        assert_eq!(lost(&ear), Some((2, 2)));
        // Its sequence numbers begin again at 0.
        ear.vehicle = Ear::new().vehicle;
        ear.say(&Heartbeat::default(), false);
        assert_eq!(lost(&ear), Some((3, 2)));
    }
}
