//! STATUSTEXT: rule T-5, D-4, L-4.

use crate::support::*;
use mavstack::config::{LinkClass, TxVersion};
use mavstack::dialect::{Heartbeat, MavCmd, MavSeverity, Statustext};
use mavstack::limits::MAX_TEXT_LEN;
use mavstack::{LinkConfig, LinkId, Text};
use proptest::prelude::*;

/// A text of `len` bytes, without repetition within 50 bytes.
fn text(len: usize) -> String {
    ('A'..='z').cycle().take(len).collect()
}

/// Assembles chunks as a ground station does: by id, in order, up to the first NUL. An incomplete text is dropped.
fn assemble(chunks: &[Statustext]) -> Vec<(MavSeverity, Vec<u8>)> {
    let (mut texts, mut open) = (Vec::new(), Vec::new());
    for chunk in chunks {
        let bytes = chunk.text.as_bytes();
        if chunk.id == 0 {
            texts.push((chunk.severity, bytes.to_vec()));
            continue;
        }
        if chunk.chunk_seq == 0 {
            open.clear();
        }
        open.extend(bytes);
        if bytes.len() < 50 {
            texts.push((chunk.severity, std::mem::take(&mut open)));
        }
    }
    texts
}

fn chunks<const N: usize>(world: &World<N>, link: usize) -> Vec<Statustext> {
    world.gcs[link].all::<Statustext>().into_iter().map(|(_, chunk)| chunk).collect()
}

fn texts<const N: usize>(world: &World<N>, link: usize) -> Vec<String> {
    let texts = assemble(&chunks(world, link));
    texts.into_iter().map(|(_, text)| String::from_utf8(text).expect("UTF-8")).collect()
}

/// T-5: a text of up to 50 bytes is one message. A longer one is chunks with a common id and indices, and a NUL in the last
/// one, also if its length is a multiple of 50. Beyond 120 bytes it is truncated.
#[test]
fn long_texts_are_sent_in_chunks() {
    for (len, lengths) in [
        (1, vec![1]),
        (49, vec![49]),
        (50, vec![50]),
        (51, vec![50, 1]),
        (99, vec![50, 49]),
        (100, vec![50, 50, 0]),
        (101, vec![50, 50, 1]),
        (120, vec![50, 50, 20]),
        (121, vec![50, 50, 20]),
        (500, vec![50, 50, 20]),
    ] {
        let mut world = World::new(Setup::<1>::new());
        world.run_for(millis(10));
        world.stack.text(world.now(), MavSeverity::NOTICE, &text(len));
        world.run_for(millis(500));
        let chunks = chunks(&world, 0);
        assert_eq!(chunks.iter().map(|chunk| chunk.text.len()).collect::<Vec<_>>(), lengths, "{len} bytes");
        let id = chunks[0].id;
        assert_eq!(id == 0, lengths.len() == 1, "{len} bytes: only chunks have an id");
        for (seq, chunk) in (0..).zip(&chunks) {
            assert_eq!((chunk.severity, chunk.id, chunk.chunk_seq), (MavSeverity::NOTICE, id, seq), "{len} bytes");
        }
        assert_eq!(texts(&world, 0), [text(len.min(120))]);
    }
}

/// T-5: two long texts have two ids, and their chunks are not interleaved.
#[test]
fn chunks_of_two_texts_are_not_interleaved() {
    let mut world = World::new(Setup::<1>::new());
    world.stack.text(world.now(), MavSeverity::INFO, &text(120));
    world.run_for(millis(1));
    // A more severe text does not interrupt the first one.
    world.stack.text(world.now(), MavSeverity::ALERT, &text(70));
    world.run_for(secs(1));
    let ids: Vec<u16> = chunks(&world, 0).iter().map(|chunk| chunk.id).collect();
    assert!(ids[0] == ids[2] && ids[3] == ids[4] && ids[0] != ids[3], "{ids:?}");
    assert_eq!(texts(&world, 0), [text(120), text(70)]);
}

/// T-5: a text and its chunks end between code points, because MAVProxy and QGroundControl decode each chunk. A space fills a
/// chunk to 50 bytes; a shorter one would be the last.
#[test]
fn chunks_end_between_code_points() {
    let links = [LinkConfig::uart(57_600), LinkConfig::uart(57_600).with_version(TxVersion::V1)];
    let mut world = World::new(Setup { links, ..Setup::new() });
    // 119 bytes, then a code point of two; the 50th byte is in the middle of one too.
    let long = format!("a{}", "é".repeat(60));
    world.stack.text(world.now(), MavSeverity::INFO, &long);
    world.run_for(secs(1));
    assert_eq!(texts(&world, 0), [format!("a{} {}", "é".repeat(24), "é".repeat(35))]);
    assert_eq!(texts(&world, 1), [format!("a{}", "é".repeat(24))], "49 bytes, in v1");
}

/// T-5, S-8: v1 has no chunks: one message of 50 bytes.
#[test]
fn v1_link_gets_the_first_50_bytes() {
    let links = [LinkConfig::uart(57_600).with_version(TxVersion::V1)];
    let mut world = World::new(Setup { links, ..Setup::new() });
    for len in [50, 51, 120] {
        world.gcs[0].forget();
        world.stack.text(world.now(), MavSeverity::ERROR, &text(len));
        world.run_for(millis(500));
        assert_eq!(texts(&world, 0), [text(50)], "{len} bytes");
    }
}

/// T-5: the same text within five seconds is dropped and counted; with another severity, or later, it is sent.
#[test]
fn repetitions_are_dropped() {
    let mut world = World::new(Setup::<1>::new());
    let say = |world: &mut World<1>, severity| {
        world.stack.text(world.now(), severity, "GPS glitch");
        world.run_for(millis(100));
        chunks(world, 0).len()
    };
    assert_eq!(say(&mut world, MavSeverity::WARNING), 1);
    for _ in 0..40 {
        assert_eq!(say(&mut world, MavSeverity::WARNING), 1);
    }
    assert_eq!(world.stack.dropped_texts(), 40);
    assert_eq!(say(&mut world, MavSeverity::ERROR), 2);
    world.run_for(secs(1));
    assert_eq!(say(&mut world, MavSeverity::WARNING), 3, "5.2 s after the first");
    world.stack.text(world.now(), MavSeverity::ERROR, "");
    world.run_for(millis(100));
    assert_eq!(chunks(&world, 0).len(), 3, "an empty text is not sent");
}

/// T-5: three texts that alternate are sent once each, too.
#[test]
fn alternating_texts_are_sent_once() {
    let mut world = World::new(Setup::<1>::new());
    let said =
        [(MavSeverity::WARNING, "GPS glitch"), (MavSeverity::ERROR, "Low voltage"), (MavSeverity::INFO, "Ready")];
    for (severity, text) in said.into_iter().cycle().take(48) {
        world.stack.text(world.now(), severity, text);
        world.run_for(millis(100));
    }
    assert_eq!(texts(&world, 0), ["GPS glitch", "Low voltage", "Ready"]);
}

/// T-5: the id of chunks is never 0, which means a single message, not even after 65,535 texts.
#[test]
fn chunk_ids_skip_zero() {
    let mut world = World::new(Setup::<1>::new());
    for i in 0..65_533 {
        world.stack.text(world.now(), MavSeverity::INFO, &i.to_string());
    }
    world.run_for(secs(1));
    world.gcs[0].forget();
    for i in 0..5 {
        world.stack.text(world.now(), MavSeverity::INFO, &format!("{i}{}", text(60)));
        world.run_for(millis(100));
    }
    let ids: Vec<u16> = chunks(&world, 0).iter().filter(|chunk| chunk.chunk_seq == 0).map(|chunk| chunk.id).collect();
    assert_eq!(ids, [65_534, 65_535, 1, 2, 3]);
}

/// T-5: a full queue drops the least severe text, the older of two equals; the others are sent in order, critical ones first.
#[test]
fn least_severe_text_is_dropped_first() {
    use MavSeverity as S;
    let mut world = World::new(Setup::<1>::new());
    world.uarts[0].stall_writes_until(mavstack::Instant::from_millis(2_000));
    let said = [
        (S::INFO, "first"),
        (S::CRITICAL, "second"),
        (S::INFO, "third"),
        (S::WARNING, "fourth"),
        // Replaces the first one, and then the third one.
        (S::ALERT, "fifth"),
        (S::INFO, "sixth"),
        // Less severe than all others, so it is dropped itself.
        (S::DEBUG, "seventh"),
        (S::ERROR, "eighth"),
    ];
    for (severity, text) in said {
        world.stack.text(world.now(), severity, text);
        world.run_for(millis(10));
    }
    world.run_for(secs(3));
    // Those of severity CRITICAL and higher come first.
    assert_eq!(texts(&world, 0), ["second", "fifth", "fourth", "eighth"]);
    assert_eq!(world.stack.dropped_texts(), 4);
}

/// D-4: on a slow link heartbeats and answers do not wait for texts, and texts keep to its rate.
#[test]
fn texts_keep_to_the_rate_of_a_slow_link() {
    let links = [LinkConfig::uart(1_200)];
    let lines = [LineConfig::radio(1_200, millis(100))];
    let mut world = World::new(Setup { links, lines, ..Setup::new() });
    for i in 0..120 {
        world.stack.text(world.now(), MavSeverity::INFO, &format!("{i} {}", text(80)));
        world.run_for(millis(500));
    }
    let beats: Vec<_> = world.gcs[0].all::<Heartbeat>().into_iter().map(|(at, _)| at).collect();
    assert!((58..=61).contains(&beats.len()), "{} in a minute", beats.len());
    // At 120 bytes/s, a text of two chunks takes a second, and one may be in transmission.
    assert!(beats.windows(2).all(|pair| pair[1] - pair[0] <= millis(1_700)), "{beats:?}");
    let bytes = world.uarts[0].written();
    assert!((6_500..=7_800).contains(&bytes), "{bytes} bytes in a minute at 120 bytes/s");
}

/// T-5: each link has its own pace: a fast one sends every text at once, and a slow one loses only what its queue cannot hold.
#[test]
fn each_link_has_its_own_pace() {
    let links = [LinkConfig::uart(115_200), LinkConfig::uart(1_200)];
    let lines = [LineConfig::default(), LineConfig::radio(1_200, millis(20))];
    let mut world = World::new(Setup { links, lines, ..Setup::new() });
    let said: Vec<String> = (0..4).map(|i| format!("{i}{}", text(110))).collect();
    for text in &said {
        world.stack.text(world.now(), MavSeverity::INFO, text);
    }
    world.run_for(millis(500));
    assert_eq!(texts(&world, 0), said);
    assert!(texts(&world, 1).len() < 2);
    world.run_for(secs(10));
    assert_eq!(texts(&world, 1), said);
    assert_eq!(texts(&world, 0), said, "once");
}

/// A link that is backpressured for long delays no text on another link, however severe its own pending texts are.
#[test]
fn dead_link_delays_no_text() {
    let mut world = World::new(Setup::<2>::new());
    world.uarts[1].stall_writes_until(mavstack::Instant::NEVER);
    for i in 0..4 {
        world.stack.text(world.now(), MavSeverity::EMERGENCY, &format!("emergency {i}"));
    }
    world.run_for(secs(11));
    for i in 0..20 {
        world.stack.text(world.now(), MavSeverity::INFO, &format!("info {i}"));
        world.run_for(millis(100));
    }
    assert_eq!(texts(&world, 0).len(), 24);
}

/// critical texts that wait for a dead link leave no text that answers a command without a place for ever: after a minute they make
/// room. Before, the operator never learned again why something was refused.
#[test]
fn dead_link_hides_no_answer_for_ever() {
    let mut world = World::new(Setup::<2>::new());
    world.uarts[1].stall_writes_until(mavstack::Instant::NEVER);
    for i in 0..8 {
        world.stack.text(world.now(), MavSeverity::CRITICAL, &format!("critical {i}"));
        world.run_for(millis(100));
    }
    world.run_for(secs(61));
    world.vehicle.is_talkative = true;
    world.gcs[0].command_long(MavCmd::DO_REPEAT_SERVO, [1.0; 7]);
    world.run_for(millis(500));
    assert_eq!(texts(&world, 0).last().map(String::as_str), Some("in control?"));
}

/// L-4, T-5: a text is sent on all links except high-latency ones.
#[test]
fn high_latency_link_gets_no_text() {
    let links = [LinkConfig::uart(9_600).with_class(LinkClass::HighLatency), LinkConfig::uart(57_600)];
    let mut world = World::new(Setup { links, ..Setup::new() });
    world.stack.text(world.now(), MavSeverity::EMERGENCY, "Engine failure");
    world.run_for(secs(10));
    assert_eq!(texts(&world, 1), ["Engine failure"]);
    assert_eq!(world.uarts[0].written(), 0);
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().tx_frames, 0);
}

/// T-5: texts may be strings, built texts or bytes, and with `fmt` formatted ones.
#[test]
fn texts_of_all_types_are_sent() {
    let mut world = World::new(Setup::<1>::new());
    let mut built = Text::<MAX_TEXT_LEN>::new("Home moved by ");
    built.push_decimal(-125, 1);
    world.stack.text(world.now(), MavSeverity::INFO, "plain");
    world.stack.text(world.now(), MavSeverity::INFO, &String::from("owned"));
    world.stack.text(world.now(), MavSeverity::INFO, &built);
    world.run_for(millis(100));
    assert_eq!(texts(&world, 0), ["plain", "owned", "Home moved by -12.5"]);
    world.gcs[0].forget();
    // Bytes that are not UTF-8 are sent unchanged.
    world.stack.text(world.now(), MavSeverity::INFO, &[0xFF; 130]);
    #[cfg(feature = "fmt")]
    {
        world.stack.text(world.now(), MavSeverity::INFO, &Text::<120>::formatted(format_args!("{:.1} m/s", 2.25)));
        world.stack.text(world.now(), MavSeverity::INFO, &Text::<120>::formatted(format_args!("{:>200}", 1)));
    }
    world.run_for(millis(500));
    let mut expected = vec![(MavSeverity::INFO, vec![0xFF; 120])];
    if cfg!(feature = "fmt") {
        expected.extend([(MavSeverity::INFO, b"2.2 m/s".to_vec()), (MavSeverity::INFO, vec![b' '; 120])]);
    }
    assert_eq!(assemble(&chunks(&world, 0)), expected);
}

/// `write!` writes what fits, ends between code points, and returns an error if that is not everything.
#[cfg(feature = "fmt")]
#[test]
fn formatted_text_is_truncated() {
    use std::fmt::Write;
    let mut text = Text::<10>::EMPTY;
    assert_eq!(write!(text, "{:.1} m, {}", 2.25, 7), Ok(()));
    assert_eq!(text.as_str(), Some("2.2 m, 7"));
    assert_eq!(write!(text, " €"), Err(std::fmt::Error));
    assert_eq!(text.as_str(), Some("2.2 m, 7 "), "no half of it");
}

/// Returns the chunks of a text, computed from its characters.
fn chunks_of(text: &str) -> Vec<String> {
    let mut chunks = vec![String::new()];
    let mut len = 0;
    for char in text.chars() {
        len += char.len_utf8();
        if len > 120 {
            break;
        }
        let last = chunks.last_mut().unwrap();
        if last.len() + char.len_utf8() > 50 {
            last.push_str(&" ".repeat(50 - last.len()));
            chunks.push(String::new());
        }
        chunks.last_mut().unwrap().push(char);
    }
    if chunks.len() > 1 && chunks.last().unwrap().len() == 50 {
        chunks.push(String::new());
    }
    chunks
}

proptest! {
    #![proptest_config(cases(128))]

    /// T-5: for any characters, each chunk is valid UTF-8, and every chunk but the last one has 50 bytes.
    #[test]
    fn chunks_are_whole_characters(text in "[ -~é€𝄞]{1,125}") {
        let mut world = World::new(Setup::<1>::new());
        world.stack.text(world.now(), MavSeverity::INFO, &text);
        world.run_for(millis(500));
        let got: Vec<_> = chunks(&world, 0).iter().map(|chunk| chunk.text.as_str().map(String::from)).collect();
        let mut expected = chunks_of(&text);
        if expected.len() == 2 && expected[1].is_empty() {
            // A single chunk of 50 bytes needs no second one.
            expected.pop();
        }
        prop_assert_eq!(got, expected.into_iter().map(Some).collect::<Vec<_>>());
    }

    /// T-5: for any texts at any pace, received texts are whole and in order, and no more are missing than were dropped.
    #[test]
    fn texts_arrive_whole(said in prop::collection::vec(("[ -~]{0,130}", 0u8..8, 0u64..400), 0..30)) {
        let mut world = World::new(Setup::<1>::new());
        let mut expected = Vec::new();
        for (text, severity, pause) in said {
            world.stack.text(world.now(), MavSeverity(severity), &text);
            expected.push((MavSeverity(severity), text.as_bytes()[..text.len().min(120)].to_vec()));
            world.run_for(millis(pause));
        }
        world.run_for(secs(5));
        let got = assemble(&chunks(&world, 0));
        let mut rest = expected.iter();
        prop_assert!(got.iter().all(|text| rest.any(|said| said == text)), "{got:?} of {expected:?}");
        prop_assert_eq!(got.len() + world.stack.dropped_texts() as usize, expected.len());
    }
}
