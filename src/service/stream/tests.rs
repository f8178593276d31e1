//! Tests of the schedule alone: rates, bounds, backpressure, fairness.

use super::{Slot, Stream, StreamLink};
use crate::dialect::{Attitude, GlobalPositionInt, SysStatus};
use crate::time::{Duration, Instant};
use crate::types::StreamProfile;
use proptest::prelude::*;
use std::vec::Vec;

const TABLE: &[Stream] = &[
    Stream::of::<Attitude>().every(Duration::from_millis(20)),
    Stream::of::<GlobalPositionInt>().every(Duration::from_millis(100)).onboard(Duration::from_millis(50)),
    Stream::of::<SysStatus>(),
];

/// The streams of one link, with their slots.
struct Line(StreamLink<[Slot; TABLE.len()]>);

impl Line {
    fn new() -> Self {
        Self(StreamLink::NEW)
    }

    fn link(&mut self) -> &mut StreamLink {
        &mut self.0
    }

    fn next_due(&mut self, now: Instant, profile: StreamProfile) -> Option<usize> {
        self.link().next_due(now, TABLE, profile, 1, false)
    }

    fn set_interval(&mut self, profile: StreamProfile, number: usize, micros: u32) {
        self.0.slots[number].set_interval(Some(micros));
        self.link().refresh(TABLE, profile);
    }
}

/// A link that was stalled until the lower half of the time wrapped streams at once when it accepts bytes again:
/// whether it stalled within a sweep or between two, and whatever was requested meanwhile.
#[test]
fn a_link_streams_at_once_after_a_long_stall() {
    let ways = [(false, false), (true, false), (false, true), (true, true)];
    let holes = [60, 65, 4_200, 4_231, 4_250, 4_290, 4_294, 4_295, 8_580];
    for (hole, (is_swept, is_asked)) in holes.into_iter().flat_map(|hole| ways.map(|way| (hole, way))) {
        let mut line = Line::new();
        counts(&mut line, 7_000_000, 3, StreamProfile::Onboard, &[1_000]);
        let stop = Instant::from_micros(10_500_000);
        assert!(line.next_due(stop, StreamProfile::Onboard).is_some());
        while is_swept && line.next_due(stop, StreamProfile::Onboard).is_some() {}
        let start = stop.as_micros() + hole * 1_000_000;
        if is_asked {
            line.set_interval(StreamProfile::Onboard, 1, 50_000);
        }
        let [fast, slow, _] = counts(&mut line, start, 1, StreamProfile::Onboard, &[1_000]);
        assert!((50..=56).contains(&fast) && (20..=23).contains(&slow), "{hole} s: {fast} {slow}");
    }
}

/// Returns how often each stream is sent in `seconds` if it is polled at these gaps (µs), repeatedly.
fn counts(streams: &mut Line, start: u64, seconds: u64, profile: StreamProfile, gaps: &[u64]) -> [u32; 3] {
    let mut counts = [0; 3];
    let mut at = start;
    let mut gaps = gaps.iter().cycle();
    while at < start + seconds * 1_000_000 {
        while let Some(number) = streams.next_due(Instant::from_micros(at), profile) {
            counts[number] += 1;
        }
        at += gaps.next().unwrap();
    }
    counts
}

/// common intervals are stored exactly; others are reported as they are stored.
#[test]
fn common_intervals_are_exact() {
    let kept = |interval| {
        let mut line = Line::new();
        line.set_interval(StreamProfile::Off, 2, interval);
        line.0.slots[2].interval(&TABLE[2], StreamProfile::Off).unwrap()
    };
    for rate in 1..=1_000 {
        assert_eq!(kept(1_000_000 / rate), 1_000_000 / rate, "{rate} Hz");
    }
    for tenths in 10..=600_000 {
        let exact = tenths <= 13_799 || tenths % 10 == 0 && tenths <= 137_990 || tenths % 100 == 0;
        assert!(!exact || kept(tenths * 100) == tenths * 100, "{tenths} tenths of a millisecond");
    }
    assert_eq!((kept(1_001), kept(123_457), kept(59_999_999)), (1_001, 123_460, 60_000_000));
}

/// whole rates are exact over any time.
#[test]
fn whole_rates_are_exact() {
    for rate in [1, 3, 7, 30, 400] {
        let mut line = Line::new();
        line.set_interval(StreamProfile::Radio, 2, 1_000_000 / rate);
        let seconds = 1_000;
        let [.., count] = counts(&mut line, 5_000_000, seconds, StreamProfile::Radio, &[1_000]);
        let wanted = rate * u32::try_from(seconds).unwrap();
        assert!(count.abs_diff(wanted) <= 1, "{count} at {rate} Hz, not {wanted}");
    }
}

/// F-11: while a client transfers a file, each stream has four times its interval, or the longest that its units can
/// count. Then it has its own again, after at most that long.
#[test]
fn transfers_slow_streams() {
    for (interval, slowed) in [
        (1_000, 4_000),
        (20_000, 80_000),
        (1_000_000, 4_000_000),
        (1_990_000, 4_000_000),
        (2_000_000, 8_000_000),
        (20_000_000, 60_000_000),
        (60_000_000, 60_000_000),
    ] {
        let Line(mut link) = Line::new();
        let link: &mut StreamLink = &mut link;
        let start = Instant::from_millis(5_000);
        link.slots[2].set_interval(Some(interval));
        link.refresh(TABLE, StreamProfile::Off);
        let mut at = start;
        let mut next = |is_slowed: bool| {
            let before = at;
            while link.next_due(at, TABLE, StreamProfile::Off, 1, is_slowed) != Some(2) {
                at += Duration::from_micros(100);
            }
            (at - before).as_micros()
        };
        assert_eq!(next(true), 0, "it is due");
        for _ in 0..3 {
            let pause = next(true);
            assert!(pause.abs_diff(slowed) <= 1_300, "{interval} µs: {pause} µs");
        }
        next(false);
        let pause = next(false);
        assert!(pause.abs_diff(interval.into()) <= 1_300, "{interval} µs: {pause} µs again");
    }
}

/// a RADIO_STATUS is forgotten after a pause of any length, even when the units of its time wrap.
#[test]
fn radio_status_is_forgotten_after_any_pause() {
    for pause in [6u64, 4_294, 4_295, 4_296, 8_590] {
        let mut line = Line::new();
        counts(&mut line, 0, 1, StreamProfile::Radio, &[1_000]);
        line.link().on_radio(Instant::from_millis(1_000), 0);
        let later = Instant::from_millis((1 + pause) * 1_000);
        assert_eq!(line.link().slowdown(later, 1_000_000, 1), 0, "{pause} s");
        let [fast, ..] = counts(&mut line, later.as_micros(), 1, StreamProfile::Radio, &[1_000]);
        assert!(fast >= 50, "{pause} s: {fast}");
    }
}

#[test]
fn profiles_have_their_own_defaults() {
    let run = |profile| counts(&mut Line::new(), 0, 10, profile, &[1_000]);
    assert_eq!(run(StreamProfile::Radio), [500, 100, 0]);
    assert_eq!(run(StreamProfile::Onboard), [500, 200, 0]);
    assert_eq!(run(StreamProfile::Off), [0, 0, 0]);
}

/// rates do not depend on the time, even when its lower half wraps.
#[test]
fn rates_hold_when_the_lower_half_of_the_time_wraps() {
    for start in [(1 << 32) - 5_000_000, 123 << 32, u64::from(u32::MAX)] {
        let [fast, slow, _] = counts(&mut Line::new(), start, 10, StreamProfile::Radio, &[1_000]);
        assert!((499..=501).contains(&fast) && (99..=101).contains(&slow), "{start}: {fast} {slow}");
    }
}

/// No burst follows a stall: streams catch up a tenth of a second, one message per poll.
#[test]
fn no_burst_follows_a_stall() {
    let mut streams = Line::new();
    counts(&mut streams, 0, 1, StreamProfile::Radio, &[1_000]);
    let [fast, ..] = counts(&mut streams, 60_000_000, 1, StreamProfile::Radio, &[1_000]);
    assert!((50..=56).contains(&fast), "{fast}");
    let mut streams = Line::new();
    counts(&mut streams, 0, 1, StreamProfile::Radio, &[1_000]);
    let mut first = Vec::new();
    while let Some(number) = streams.next_due(Instant::from_millis(2_000), StreamProfile::Radio) {
        first.push(number);
    }
    assert_eq!(first, [0, 1], "each once");
}

/// a link that accepts one message every 40 ms, for streams that need more than 15 a second: the slow streams keep
/// their rate.
#[test]
fn a_slow_link_starves_no_stream() {
    let mut streams = Line::new();
    streams.set_interval(StreamProfile::Radio, 2, 1_000);
    let mut counts = [0u32; 3];
    for at in (0..10_000).step_by(40).map(Instant::from_millis) {
        if let Some(number) = streams.next_due(at, StreamProfile::Radio) {
            counts[number] += 1;
        }
    }
    assert!(counts.iter().all(|&count| count >= 80), "{counts:?}");
}

/// a radio with a full buffer lengthens every interval, one with a free buffer shortens them again, and one that
/// is silent for five seconds is forgotten.
#[test]
fn radio_status_throttles_streams() {
    let mut streams = Line::new();
    let rate = |streams: &mut Line, start| counts(streams, start, 4, StreamProfile::Radio, &[1_000])[0];
    assert_eq!(rate(&mut streams, 0), 200);
    streams.link().on_radio(Instant::from_millis(4_000), 19);
    // 20 ms and 60.
    assert!((49..=52).contains(&rate(&mut streams, 4_000_000)));
    streams.link().on_radio(Instant::from_millis(8_000), 49);
    assert!((39..=42).contains(&rate(&mut streams, 8_000_000)), "and 20 more");
    for (second, free) in [(12, 50), (16, 90)] {
        streams.link().on_radio(Instant::from_millis(second * 1_000), free);
        assert!((39..=42).contains(&rate(&mut streams, second * 1_000_000)), "neither");
    }
    streams.link().on_radio(Instant::from_millis(20_000), 96);
    assert!((65..=68).contains(&rate(&mut streams, 20_000_000)), "40 less");
    streams.link().on_radio(Instant::from_millis(24_000), 91);
    assert!((99..=102).contains(&rate(&mut streams, 24_000_000)), "20 less");
    // The last RADIO_STATUS was at 24 s.
    assert!((199..=206).contains(&rate(&mut streams, 29_001_000)));
    // Ten times a second, and a hundred times.
    for millis in (34_000..44_000).step_by(10) {
        streams.link().on_radio(Instant::from_millis(millis), 0);
    }
    assert!(rate(&mut streams, 44_000_000) <= 3, "two seconds, at most");
}

proptest! {
    /// the average over 100 s is within 1 %, however irregular the polls, as long as they are on average no rarer
    /// than the interval.
    #[test]
    fn jitter_does_not_change_the_average(
        gaps in proptest::collection::vec(1u64..30_000, 10..50),
        stretch in 1u32..20,
        start in 0u64..1 << 40,
    ) {
        let mean = gaps.iter().sum::<u64>() / gaps.len() as u64;
        // A fifth of slack for late polls; at least 1 ms.
        let interval = (mean as u32 * 6 / 5).saturating_mul(stretch).max(1_000);
        let mut streams = Line::new();
        streams.set_interval(StreamProfile::Off, 2, interval);
        let count = f64::from(counts(&mut streams, start, 100, StreamProfile::Off, &gaps)[2]);
        let wanted = 100e6 / f64::from(interval);
        prop_assert!((count - wanted).abs() <= wanted * 0.01 + 1.0, "{count}, not {wanted}");
    }

    /// The deadline is when a stream is due and not before, to a unit, for any interval; and errors do not add up.
    #[test]
    fn deadline_is_when_the_next_is_due(interval in 1_000u32..60_000_000, start in 1u64..1 << 40) {
        let mut streams = Line::new();
        let at = Instant::from_micros(start);
        streams.set_interval(StreamProfile::Off, 2, interval);
        while streams.next_due(at, StreamProfile::Off).is_some() {}
        let told = streams.0.slots[2].interval(&TABLE[2], StreamProfile::Off).unwrap();
        prop_assert!(told >= interval && told - interval <= interval / 1_000);
        let unit = if told < 2_000_000 { 64 } else { 1_024 };
        let mut now = at;
        for count in 1..300 {
            let due = streams.link().deadline(now, TABLE, StreamProfile::Off);
            let wanted = start + count * u64::from(told);
            prop_assert!(due.as_micros().abs_diff(wanted) <= 4 * unit, "{due:?}, not {wanted}");
            prop_assert_eq!(streams.next_due(Instant::from_micros(due.as_micros() - 1), StreamProfile::Off), None);
            prop_assert_eq!(streams.next_due(due, StreamProfile::Off), Some(2));
            while streams.next_due(due, StreamProfile::Off).is_some() {}
            now = due;
        }
    }
}
