//! Formats the vehicle's status.

use std::fmt;

use mavstack::LinkId;
use mavstack::dialect::MissionState;
use mavstack_demo::status::{LINK_DROPS, LinkStatus, Mission, OTHER_DROPS};
use mavstack_demo::{COMPANION, Mode, SATELLITE, Status, TELEMETRY};

/// Formats a status as one line.
#[derive(Clone, Copy, Debug)]
pub struct Line<'a> {
    /// The status to show.
    pub now: &'a Status,
    /// The previous status, from which rates are computed. After a reboot of the vehicle it is ignored.
    pub before: Option<&'a Status>,
}

impl fmt::Display for Line<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Status { is_armed, mode, mission, .. } = self.now;
        let armed = if *is_armed { "armed" } else { "disarmed" };
        let between = if *mode == Mode::Mission && mission.count > 0 { "" } else { ", mission" };
        write!(f, "{armed}, {mode:?}{between} {}", Progress(*mission))?;
        self.drops(f)?;
        f.write_str(" | frames/s in/out:")?;
        for (link, name) in [TELEMETRY, COMPANION, SATELLITE].into_iter().zip(NAMES) {
            // An unused satellite link carries no traffic at all.
            if link == SATELLITE && counts(self.now, link) == LinkStatus::default() {
                continue;
            }
            let (received, sent) = self.rates(link);
            write!(f, " {name} {received}/{sent}")?;
            self.peers(f, link)?;
        }
        Ok(())
    }
}

/// The links' names, in order of their ids.
const NAMES: [&str; 3] = ["telemetry", "companion", "satellite"];

fn counts(status: &Status, link: LinkId) -> LinkStatus {
    status.links.get(usize::from(link.0)).copied().unwrap_or_default()
}

impl Line<'_> {
    /// Returns the rates of received and sent frames (1/s).
    fn rates(&self, link: LinkId) -> (u32, u32) {
        let before = self.before.filter(|before| before.time < self.now.time);
        let elapsed = self.now.time - before.map_or(0, |before| before.time);
        let counts = |status| counts(status, link);
        let (now, before) = (counts(self.now), before.map(counts).unwrap_or_default());
        let rate = |now: u32, before| {
            let frames = u64::from(now.wrapping_sub(before));
            let rounded = (frames * 1_000 + u64::from(elapsed) / 2) / u64::from(elapsed.max(1));
            u32::try_from(rounded).unwrap_or(u32::MAX)
        };
        (rate(now.received, before.received), rate(now.sent, before.sent))
    }

    fn peers(&self, f: &mut fmt::Formatter<'_>, link: LinkId) -> fmt::Result {
        let mut separator = " (";
        for peer in self.now.peers.iter().flatten().filter(|peer| peer.link == link.0) {
            write!(f, "{separator}{}/{}", peer.system, peer.component)?;
            separator = " ";
        }
        if separator == " " { f.write_str(")") } else { Ok(()) }
    }

    fn drops(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Status { link_drops, other_drops, .. } = self.now;
        let counts = LINK_DROPS.iter().zip(link_drops).chain(OTHER_DROPS.iter().zip(other_drops));
        let mut separator = " | dropped:";
        for (reason, count) in counts.filter(|(_, count)| **count > 0) {
            write!(f, "{separator} {count} {reason}")?;
            separator = ",";
        }
        Ok(())
    }
}

/// Formats the progress of the mission: the current item, the number of items, the state.
struct Progress(Mission);

impl fmt::Display for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Mission { current, count, state } = self.0;
        let state = match MissionState(state) {
            MissionState::NO_MISSION => return f.write_str("none"),
            MissionState::NOT_STARTED => "not started",
            MissionState::ACTIVE => "active",
            MissionState::PAUSED => "paused",
            MissionState::COMPLETE => "complete",
            _ => "in an unknown state",
        };
        write!(f, "{current}/{count} {state}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavstack_demo::status::PeerStatus;

    fn status(time: u32) -> Status {
        Status {
            time,
            is_armed: false,
            mode: Mode::Hold,
            mission: Mission { current: 0, count: 0, state: MissionState::NO_MISSION.0 },
            links: [LinkStatus::default(); 3],
            peers: [None; 8],
            link_drops: [0; LINK_DROPS.len()],
            other_drops: [0; OTHER_DROPS.len()],
        }
    }

    #[test]
    fn a_vehicle_without_peers() {
        assert_eq!(
            Line { now: &status(0), before: None }.to_string(),
            "disarmed, Hold, mission none | frames/s in/out: telemetry 0/0 companion 0/0"
        );
    }

    #[test]
    fn a_line_with_every_part() {
        let peer = |link, system, component| Some(PeerStatus { link, system, component });
        let mut before = status(10_000);
        before.links[0] = LinkStatus { received: u32::MAX - 1, sent: 1_000 };
        let mut now = status(12_000);
        now.is_armed = true;
        now.mode = Mode::Mission;
        now.mission = Mission { current: 3, count: 12, state: MissionState::ACTIVE.0 };
        // Two seconds later; the counters have wrapped.
        now.links[0] = LinkStatus { received: 4, sent: 1_099 };
        now.links[1] = LinkStatus { received: 1, sent: 0 };
        now.links[2] = LinkStatus { received: 0, sent: 3 };
        now.peers[..3].copy_from_slice(&[peer(0, 255, 190), peer(1, 1, 191), peer(0, 254, 190)]);
        now.link_drops[0] = 3;
        now.other_drops[1] = 1;
        assert_eq!(
            Line { now: &now, before: Some(&before) }.to_string(),
            "armed, Mission 3/12 active | dropped: 3 checksum, 1 bad signature | frames/s in/out: \
             telemetry 3/50 (255/190 254/190) companion 1/0 (1/191) satellite 0/2"
        );
    }

    #[test]
    fn after_a_reboot_rates_count_from_zero() {
        let mut before = status(60_000);
        before.links[0] = LinkStatus { received: 900, sent: 9_000 };
        let mut now = status(500);
        now.links[0] = LinkStatus { received: 1, sent: 20 };
        let line = Line { now: &now, before: Some(&before) }.to_string();
        assert!(line.contains("telemetry 2/40"), "{line}");
    }
}
