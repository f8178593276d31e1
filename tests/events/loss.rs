//! Bad lines and long flights: a receiver gets every event, in order. Rules EVT-2 to EVT-4.

use super::*;
use proptest::prelude::*;

/// A radio that loses, duplicates and reorders frames.
fn radio(loss: f64, disorder: f64) -> LineConfig {
    let faults = Faults {
        frame_loss: loss,
        frame_duplicate: disorder,
        frame_reorder: disorder,
        reorder_by: millis(30),
        ..Faults::default()
    };
    LineConfig::both(Wire { bytes_per_second: 11_520, latency: millis(15), faults, ..Wire::default() })
}

/// A receiver on each link, and the number of the next event.
struct Watch {
    site: Site,
    receivers: [Receiver; 2],
    next: u32,
}

impl Watch {
    fn new(line: LineConfig, seed: u64) -> Self {
        let mut watch = Self { site: lossy(line, seed), receivers: receivers(), next: 0 };
        // Both know from where on they count.
        watch.run(3_500);
        watch
    }

    fn run(&mut self, millis: u64) {
        for _ in 0..millis {
            self.site.step();
            let now = self.site.now();
            for (receiver, gcs) in self.receivers.iter_mut().zip(&mut self.site.gcs) {
                receiver.poll(now, gcs);
            }
        }
    }

    fn record(&mut self, events: u32) {
        count(&mut self.site, self.next..self.next + events);
        self.next += events;
    }

    /// From now on, loses this part of the frames to the ground stations.
    fn lose(&self, part: f64) {
        for line in &self.site.lines {
            line.set_down(|wire| wire.faults.frame_loss = part);
        }
    }

    /// Returns the numbers that each receiver has.
    fn numbers(&self) -> [Vec<u32>; 2] {
        let all = |receiver: &Receiver| {
            let events = receiver.dialogue.events().iter().filter(|event| event.id == id_of::<Counted>());
            events.map(number_of).collect()
        };
        [all(&self.receivers[0]), all(&self.receivers[1])]
    }

    /// Both have all events.
    fn check(&self) {
        for (numbers, receiver) in self.numbers().iter().zip(&self.receivers) {
            assert!(numbers.iter().copied().eq(0..self.next), "{numbers:?} of {}", self.next);
            assert_eq!(receiver.dialogue.lost(), 0);
        }
    }
}

/// EVT-2, EVT-4: with 0, 10 and 20 % loss, duplicates and reordering, both receivers have every event in order.
#[test]
fn every_event_arrives_in_order() {
    for (loss, disorder) in [(0.0, 0.0), (0.1, 0.05), (0.2, 0.05), (0.0, 0.2)] {
        for seed in 1..5 {
            let mut watch = Watch::new(radio(loss, disorder), seed);
            for burst in [1, 3, 1, 8, 2, 15, 1, 1] {
                watch.record(burst);
                watch.run(1_500);
            }
            watch.run(10_000);
            watch.check();
            if loss == 0.0 && disorder == 0.0 {
                assert_eq!(watch.receivers[0].dialogue.requests(), 0, "nothing is missing");
            }
        }
    }
}

/// EVT-3: the last event before a silence is missed too.
#[test]
fn last_event_is_recovered() {
    let mut watch = Watch::new(radio(0.0, 0.0), 1);
    watch.record(1);
    watch.run(1_000);
    watch.lose(1.0);
    watch.record(1);
    watch.run(200);
    watch.lose(0.0);
    assert_eq!(watch.numbers(), [vec![0], vec![0]]);
    watch.run(4_000);
    watch.check();
}

/// EVT-2, EVT-4: the sequence numbers wrap. All events from 65,533 to 3 are lost and sent again on request, while a fifth of all frames
/// is lost.
#[test]
fn sequence_numbers_wrap() {
    let mut watch = Watch::new(LineConfig::default(), 1);
    let fast = LinkConfig::unlimited();
    watch.site = Site::of(Setup { links: [fast; 2], ..Setup::new() });
    watch.receivers = receivers();
    watch.run(5);
    let fly = |watch: &mut Watch, to: u32| {
        while watch.next < to {
            watch.record(7.min(to - watch.next));
            watch.run(1);
            for (receiver, gcs) in watch.receivers.iter_mut().zip(&mut watch.site.gcs) {
                gcs.forget();
                receiver.forgot();
            }
        }
    };
    let last =
        |watch: &Watch| watch.receivers.each_ref().map(|receiver| receiver.dialogue.events().last().unwrap().sequence);
    fly(&mut watch, 65_530);
    watch.run(100);
    watch.record(u32::from(65_532 - last(&watch)[0]));
    watch.run(100);
    assert_eq!(
        (last(&watch), watch.receivers.each_ref().map(|receiver| receiver.dialogue.requests())),
        ([65_532; 2], [0; 2])
    );

    watch.lose(1.0);
    watch.record(7);
    watch.run(1_000);
    assert_eq!(last(&watch), [65_532; 2]);
    watch.lose(0.2);
    watch.run(15_000);
    watch.lose(0.0);
    watch.run(4_000);
    assert_eq!(last(&watch), [3; 2]);
    for receiver in &watch.receivers {
        assert!(receiver.dialogue.requests() >= 7, "each was requested: {}", receiver.dialogue.requests());
    }
    fly(&mut watch, 70_000);
    watch.run(100);
    watch.check();
}

/// EVT-3, EVT-4: after a reboot of the vehicle, a receiver that knows it from before gets its new events.
#[test]
fn receiver_follows_a_reboot() {
    let mut watch = Watch::new(radio(0.0, 0.0), 1);
    watch.record(15);
    watch.run(3_000);
    watch.check();
    watch.site = lossy(radio(0.0, 0.0), 2);
    watch.receivers.iter_mut().for_each(Talk::forgot);
    watch.run(100);
    watch.record(3);
    watch.run(3_000);
    watch.check();
}

/// EVT-3: a receiver that comes late begins with what comes after it.
#[test]
fn late_receiver_gets_what_comes_after_it() {
    let mut watch = Watch::new(radio(0.0, 0.0), 1);
    watch.record(12);
    watch.run(5_000);
    watch.site.gcs[0].forget();
    watch.receivers[0] = receiver(Client::QGroundControl, STATION);
    watch.run(3_500);
    watch.record(2);
    watch.run(2_000);
    assert_eq!(watch.numbers()[0], [12, 13]);
    assert_eq!((watch.receivers[0].dialogue.lost(), watch.receivers[0].dialogue.requests()), (0, 0));
}

proptest! {
    #![proptest_config(cases(40))]

    /// EVT-2 to EVT-4: whatever is lost, duplicated or reordered, each receiver has in the end all events, once and in order.
    #[test]
    fn receivers_have_all_events(
        loss in 0.0..0.3f64,
        disorder in 0.0..0.3f64,
        bursts in prop::collection::vec((1..8u32, 200..3_000u64), 1..10),
        seed in any::<u64>(),
    ) {
        let mut watch = Watch::new(radio(loss, disorder), seed);
        for (events, pause) in bursts {
            watch.record(events);
            watch.run(pause);
            // The history is 20 long: wait for the slowest before it overflows.
            for _ in 0..200 {
                if watch.numbers().iter().all(|numbers| numbers.len() as u32 + 8 > watch.next) {
                    break;
                }
                watch.run(100);
            }
        }
        watch.run(20_000);
        watch.check();
    }
}
