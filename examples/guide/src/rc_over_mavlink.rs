//! A pilot's receiver in MAVLink mode: `docs/rc-over-mavlink.md`.

use mavstack::manual_control::ControlSource;
use mavstack::prelude::*;

#[derive(Stack)]
#[stack(vehicle: Rover, links: 2, manual_control)]
struct Mavlink;

/// The receiver is on the second link.
const RADIO: LinkId = LinkId(1);
/// ExpressLRS, and mLRS in both of its settings. The first has the highest rank. A vehicle has at most two receivers.
const RECEIVERS: [Peer; 2] =
    [Peer { address: Address::new(255, 68), link: RADIO }, Peer { address: Address::new(51, 68), link: RADIO }];
/// The rate is that of the air link, not that of the UART: see "Telemetry".
const LINKS: [LinkConfig; 2] = [LinkConfig::uart(57_600), LinkConfig::limited(800)];

fn configure(stack: &mut StackOf<Mavlink>) {
    let input = stack.manual_input_mut();
    input.set_receivers(&RECEIVERS);
    // A joystick steers while the receiver is silent. `Nobody` if only the receiver may.
    input.set_source(ControlSource::GroundStation);
}

/// Called in every pass of the flight loop. Returns steering and throttle (µs); `None`: start the failsafe.
fn sticks(stack: &StackOf<Mavlink>, now: Instant) -> Option<[u16; 2]> {
    let channels = stack.manual_input().rc_channels(now)?;
    Some([channels.channel(1)?, channels.channel(3)?])
}

struct Rover;

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        None
    }
}

impl Commands for Rover {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}
