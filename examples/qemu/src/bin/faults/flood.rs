//! Floods: as many requests as the link can carry.

use mavstack::dialect::{MavMissionResult, MissionCount, ParamRequestList};
use mavstack::{Address, Duration, Instant, LinkId};
use mavstack_demo::{COMPANION, TELEMETRY};
use semihosting::println;

use crate::station::{Pinger, Upload, request_message, upload};
use crate::world::{Client, Network, OTHER, Parts, Received, STATION, World};

#[derive(Clone, Copy, Debug)]
enum Kind {
    Counts,
    Lists,
    Commands,
}

/// A client that floods a link, with a new sender address for each frame.
struct Flood {
    kind: Kind,
    link: LinkId,
    frames: u32,
}

impl Client for Flood {
    fn on_frame(&mut self, _: &Received<'_>, _: &mut Network) {}

    fn tick(&mut self, _: Instant, network: &mut Network) {
        let at = usize::from(self.link.0);
        // Keep the line busy, but little more.
        while network.lines[at].up.room() > 1_700 {
            self.frames += 1;
            let from = Address::new(2 + (self.frames % 200) as u8, 1 + (self.frames % 7) as u8);
            let (target_system, target_component) = (1, 1);
            match self.kind {
                Kind::Counts => {
                    let count = 1 + (self.frames % 250) as u16;
                    let message = MissionCount { target_system, target_component, count, ..MissionCount::default() };
                    network.send(self.link, from, &message);
                }
                Kind::Lists => network.send(self.link, from, &ParamRequestList { target_system, target_component }),
                Kind::Commands => network.send(self.link, from, &request_message(self.frames % 300)),
            }
        }
    }
}

const TIME: Duration = Duration::from_secs(10);
const ITEMS: u16 = 40;

/// Floods one link. The other link must work as usual.
pub fn floods(mut parts: Parts) -> Parts {
    let (mut frames, mut longest, mut pings, mut slowest) = (0, Duration::ZERO, 0, Duration::ZERO);
    for kind in [Kind::Counts, Kind::Lists, Kind::Commands] {
        for (link, other) in [(TELEMETRY, COMPANION), (COMPANION, TELEMETRY)] {
            let mut world = World::fresh(parts);
            world.step = Duration::from_millis(2);
            assert!(upload(&mut world, other, STATION, ITEMS, 1) == MavMissionResult::ACCEPTED);
            world.run(Duration::from_secs(2), &mut []);
            // Started before the flood, whose own uploads would block it.
            let mut honest = Upload::new(other, OTHER, ITEMS, 2);
            while !honest.has_request {
                world.pass(&mut [&mut honest]);
            }
            let mut flood = Flood { kind, link, frames: 0 };
            let mut pinger = Pinger::new(other, OTHER, Duration::from_millis(200));
            world.reset_tally();
            world.run(TIME, &mut [&mut flood, &mut honest, &mut pinger]);
            assert!(
                honest.result == Some(MavMissionResult::ACCEPTED),
                "{kind:?}: the honest upload: {:?}",
                honest.result
            );
            assert!(world.live(2) == Some(ITEMS), "{kind:?}: the honest plan is not live");
            for link in [TELEMETRY, COMPANION] {
                let silence = world.longest_silence(link);
                assert!(
                    silence <= Duration::from_millis(1_100),
                    "{kind:?}: no heartbeat for {} ms",
                    silence.as_millis()
                );
                longest = longest.max(silence);
            }
            assert!(
                pinger.answers + 1 >= pinger.sent,
                "{kind:?}: {} of {} pings answered",
                pinger.answers,
                pinger.sent
            );
            frames += flood.frames;
            pings += pinger.answers;
            slowest = slowest.max(pinger.slowest);
            parts = world.end();
        }
    }
    println!(
        "floods: {frames} MISSION_COUNT, PARAM_REQUEST_LIST and COMMAND_LONG in 60 s from 1400 senders: heartbeats at most {} ms \
         apart; on the other link an upload accepted, {pings} pings answered within {} ms",
        longest.as_millis(),
        slowest.as_millis()
    );
    parts
}
