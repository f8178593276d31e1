//! What was received and answered during a part of the examination.

use std::collections::BTreeMap;

use mavstack::dialect::{
    Attitude, AutopilotVersion, CommandAck, GlobalPositionInt, Heartbeat, LocalPositionNed, ParamValue, SystemTime,
    Timesync,
};
use mavstack::frame::{RxCounters, Version};
use mavstack::{Address, Duration, Instant, Message};
use mavstack_station::Received;

/// A request that was sent to learn whether and when it is answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Probe {
    /// When it was sent.
    pub sent: Instant,
    /// When its answer was received, if it was.
    pub answered: Option<Instant>,
}

impl Probe {
    /// Returns the time from the request to its answer.
    pub fn round_trip(&self) -> Option<Duration> {
        self.answered.map(|answered| answered - self.sent)
    }
}

/// A part of the examination: the frames received and the probes sent from one moment to another.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// When it began.
    pub began: Instant,
    /// When it ended.
    pub ended: Instant,
    /// The vehicle's frames.
    pub frames: Vec<Received>,
    /// The bytes of other components' frames.
    pub other_bytes: usize,
    /// The probes.
    pub probes: Vec<Probe>,
    /// Candidates with a wrong checksum or length.
    pub damaged: u32,
    /// Bytes outside frames.
    pub stray: u32,
}

impl Trace {
    /// Adds what a decoder has dropped between two readings of its counters.
    pub(crate) fn add_damage(&mut self, before: RxCounters, after: RxCounters) {
        let length = after.length.wrapping_sub(before.length);
        self.damaged += after.checksum.wrapping_sub(before.checksum) + length;
        self.stray += after.skipped.wrapping_sub(before.skipped);
    }

    /// Adds the part that followed.
    pub(crate) fn extend(&mut self, next: Self) {
        self.ended = next.ended;
        self.frames.extend(next.frames);
        self.other_bytes += next.other_bytes;
        self.probes.extend(next.probes);
        self.damaged += next.damaged;
        self.stray += next.stray;
    }

    /// Returns how long it took.
    pub fn time(&self) -> Duration {
        self.ended - self.began
    }

    /// Returns the share of probes that were not answered, from 0 to 1.
    pub fn unanswered(&self) -> f64 {
        let lost = self.probes.iter().filter(|probe| probe.answered.is_none()).count();
        lost as f64 / self.probes.len().max(1) as f64
    }

    /// Returns the number of probes that did not reach the vehicle: not answered, and no frame of the vehicle is missing at the time
    /// when the answer was due.
    pub fn unheard(&self) -> usize {
        let usual = self.round_trips().last().copied().unwrap_or_default() + Duration::from_millis(150);
        let unanswered = self.probes.iter().filter(|probe| probe.answered.is_none());
        unanswered.filter(|probe| !self.has_gap(probe.sent, probe.sent + usual)).count()
    }

    /// Whether a frame is missing, by the sequence numbers, between the last one before `begin` and the first one after `end`.
    fn has_gap(&self, begin: Instant, end: Instant) -> bool {
        let first = self.frames.partition_point(|frame| frame.at <= begin).saturating_sub(1);
        let last = self.frames.partition_point(|frame| frame.at <= end) + 1;
        lost(self.frames[first..last.min(self.frames.len())].iter()) > 0
    }

    /// Returns the answer times, sorted.
    pub fn round_trips(&self) -> Vec<Duration> {
        let mut times: Vec<_> = self.probes.iter().filter_map(Probe::round_trip).collect();
        times.sort();
        times
    }

    /// Returns the number of frames lost, by gaps of the sequence numbers.
    pub fn lost(&self) -> u64 {
        lost(self.frames.iter())
    }

    /// Returns the number of frames lost from the last one at `begin` to the first one at `end`. Heartbeats, which may have numbers of their
    /// own, are left out.
    pub fn lost_within(&self, begin: Instant, end: Instant) -> u64 {
        let is_within = |frame: &&Received| frame.header.id != Heartbeat::ID && begin <= frame.at && frame.at <= end;
        lost(self.frames.iter().filter(is_within))
    }

    /// Returns how many frames the vehicle sends per second by itself: neither heartbeats nor answers to probes.
    pub fn streamed_per_second(&self) -> f64 {
        let others = [Heartbeat::ID, Timesync::ID, ParamValue::ID, CommandAck::ID, AutopilotVersion::ID];
        let streamed = self.frames.iter().filter(|frame| !others.contains(&frame.header.id)).count();
        streamed as f64 / seconds(self.time()).max(0.001)
    }

    /// Returns the time from the vehicle to the station of each frame with the vehicle's time, plus the same unknown offset (µs): those of
    /// the answers to TIMESYNC, or else of the message with the time since boot that came most often.
    pub fn ways_back(&self) -> Vec<i64> {
        let mut ways: BTreeMap<u32, Vec<i64>> = BTreeMap::new();
        for frame in &self.frames {
            let sync = frame.decode::<Timesync>().filter(|sync| sync.tc1 != 0 && sync.ts1 != 0);
            let time = sync.map(|sync| sync.tc1 / 1_000).or_else(|| Some(i64::from(boot_ms(frame)?) * 1_000));
            if let Some(time) = time {
                ways.entry(frame.header.id).or_default().push(frame.at.as_micros() as i64 - time);
            }
        }
        let syncs = ways.remove(&Timesync::ID).filter(|ways| ways.len() >= 8);
        syncs.unwrap_or_else(|| ways.into_values().max_by_key(Vec::len).unwrap_or_default())
    }

    /// Returns the number of frames lost, if the heartbeats had sequence numbers of their own and are left out.
    pub fn lost_without_heartbeats(&self) -> u64 {
        lost(self.frames.iter().filter(|frame| frame.header.id != Heartbeat::ID))
    }

    /// Returns the bytes received per second, as far as they were frames, of all components.
    pub fn bytes_per_second(&self) -> f64 {
        let bytes: usize = self.frames.iter().map(wire_len).sum();
        (bytes + self.other_bytes) as f64 / seconds(self.time()).max(0.001)
    }

    /// Returns the mean length of this message's frames (bytes), 0 if there are none.
    pub fn mean_len(&self, id: u32) -> usize {
        let lens: Vec<_> = self.frames.iter().filter(|frame| frame.header.id == id).map(wire_len).collect();
        lens.iter().sum::<usize>() / lens.len().max(1)
    }

    /// Returns when each frame of this message was received.
    pub fn arrivals(&self, id: u32) -> Vec<Instant> {
        self.frames.iter().filter(|frame| frame.header.id == id).map(|frame| frame.at).collect()
    }

    /// Returns the longest time between two heartbeats, or until the end.
    pub fn longest_heartbeat_gap(&self) -> Duration {
        longest_gap(self.began, &self.arrivals(Heartbeat::ID), self.ended)
    }

    /// Returns the longest time in which nothing but heartbeats was received: neither an answer nor a streamed message.
    pub fn longest_silence(&self) -> (Instant, Duration) {
        let frames = self.frames.iter().filter(|frame| frame.header.id != Heartbeat::ID);
        let times: Vec<_> = frames.map(|frame| frame.at).collect();
        let begins = std::iter::once(self.began).chain(times.iter().copied());
        let ends = times.iter().copied().chain(std::iter::once(self.ended));
        begins.zip(ends).map(|(begin, end)| (begin, end - begin)).max_by_key(|(_, gap)| *gap).unwrap_or_default()
    }

    /// Returns the number of heartbeats in a part of the trace.
    pub fn heartbeats_within(&self, begin: Instant, time: Duration) -> usize {
        let margin = Duration::from_millis(50);
        let is_within = |at: &Instant| *at > begin + margin && *at + margin < begin + time;
        self.arrivals(Heartbeat::ID).iter().filter(|at| is_within(at)).count()
    }

    /// Returns the ids of the messages received, each with its number of frames.
    pub fn ids(&self) -> BTreeMap<u32, usize> {
        let mut ids = BTreeMap::new();
        for frame in &self.frames {
            *ids.entry(frame.header.id).or_default() += 1;
        }
        ids
    }
}

/// Returns how fast the vehicle's clock runs, by the messages with the time since boot: 1 is right. `None` if they do not cover enough
/// time.
pub fn clock_rate(frames: &[Received], least: Duration) -> Option<f64> {
    /// The first frames may have waited in the vehicle's USB or in a bridge until the port was opened.
    const STALE: Duration = Duration::from_millis(500);
    let mut ends: BTreeMap<u32, [(Instant, u32); 2]> = BTreeMap::new();
    let begin = frames.first()?.at + STALE;
    for frame in frames.iter().filter(|frame| frame.at >= begin) {
        if let Some(boot_ms) = boot_ms(frame) {
            ends.entry(frame.header.id).or_insert([(frame.at, boot_ms); 2])[1] = (frame.at, boot_ms);
        }
    }
    let rates = ends.into_values().filter(|[first, last]| last.0 - first.0 >= least);
    let longest = rates.max_by_key(|[first, last]| last.0 - first.0)?;
    let [(begin, first), (end, last)] = longest;
    Some((f64::from(last) - f64::from(first)) / (seconds(end - begin) * 1_000.0))
}

/// Returns how many nanoseconds the answers to TIMESYNC count in a nanosecond: 1 is right. `None` if there are too few.
pub fn timesync_rate(trace: &Trace) -> Option<f64> {
    let answers = trace.frames.iter().filter_map(|frame| {
        let sync = frame.decode::<Timesync>().filter(|sync| sync.tc1 != 0 && sync.ts1 != 0)?;
        Some((frame.at, sync.tc1))
    });
    let answers: Vec<_> = answers.collect();
    let ((begin, first), (end, last)) = (answers.first()?, answers.last()?);
    let time = seconds(*end - *begin);
    (time > 2.0).then(|| (*last as f64 - *first as f64) / (time * 1e9))
}

/// Returns the time since boot in a message that has one (ms).
fn boot_ms(frame: &Received) -> Option<u32> {
    let attitude = frame.decode::<Attitude>().map(|message| message.time_boot_ms);
    let position = || frame.decode::<GlobalPositionInt>().map(|message| message.time_boot_ms);
    let local = || frame.decode::<LocalPositionNed>().map(|message| message.time_boot_ms);
    let system = || frame.decode::<SystemTime>().map(|message| message.time_boot_ms);
    attitude.or_else(position).or_else(local).or_else(system)
}

fn lost<'a>(frames: impl Iterator<Item = &'a Received>) -> u64 {
    let mut last: BTreeMap<Address, u8> = BTreeMap::new();
    let mut lost = 0;
    for frame in frames {
        let seq = frame.header.seq;
        if let Some(last) = last.insert(frame.source(), seq) {
            let gap = seq.wrapping_sub(last).wrapping_sub(1);
            // A greater gap is a duplicate, a late frame or a reboot.
            lost += if gap < 128 { u64::from(gap) } else { 0 };
        }
    }
    lost
}

/// Returns the bytes of a frame on the line.
pub(crate) fn wire_len(frame: &Received) -> usize {
    let overhead = match frame.header.version {
        Version::V1 => 8,
        _ => 12,
    };
    frame.payload.len() + overhead + if frame.is_signed { 13 } else { 0 }
}

fn longest_gap(began: Instant, times: &[Instant], ended: Instant) -> Duration {
    let begins = std::iter::once(began).chain(times.iter().copied());
    let ends = times.iter().copied().chain(std::iter::once(ended));
    begins.zip(ends).map(|(begin, end)| end - begin).max().unwrap_or_default()
}

/// Returns a time in seconds.
pub fn seconds(time: Duration) -> f64 {
    time.as_micros() as f64 / 1e6
}
