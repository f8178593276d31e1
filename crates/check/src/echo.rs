//! A request that every vehicle answers, to measure the line and the answer times.

use mavstack::dialect::{self, AutopilotVersion, CommandAck, CommandLong, MavCmd, ParamRequestRead, ParamValue};
use mavstack::message::Text;
use mavstack::{Address, Instant, Message};
use mavstack_station::{Received, Station};

/// A request, and how its answer is recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Echo {
    /// TIMESYNC, which carries the time of the request.
    Timesync,
    /// PARAM_REQUEST_READ of the first parameter.
    Parameter,
    /// MAV_CMD_REQUEST_MESSAGE for AUTOPILOT_VERSION, which is acknowledged even if it is refused.
    Command,
}

impl Echo {
    /// All of them, the best first.
    pub const ALL: [Self; 3] = [Self::Timesync, Self::Parameter, Self::Command];

    /// Sends the request.
    pub fn send(self, station: &mut Station, now: Instant, target: Address) {
        let (target_system, target_component) = (target.system.wire(), target.component.wire());
        match self {
            Self::Timesync => {
                station.send(&dialect::Timesync { tc1: 0, ts1: stamp(now), ..dialect::Timesync::default() });
            }
            Self::Parameter => station.send(&ParamRequestRead {
                param_index: 0,
                target_system,
                target_component,
                // The name is ignored. It makes the frame as long as others: a longer one is damaged more easily.
                param_id: Text::new(IGNORED_NAME),
            }),
            Self::Command => station.send(&CommandLong {
                param1: AutopilotVersion::ID as f32,
                param2: 0.0,
                param3: 0.0,
                param4: 0.0,
                param5: 0.0,
                param6: 0.0,
                param7: 0.0,
                command: MavCmd::REQUEST_MESSAGE,
                target_system,
                target_component,
                confirmation: 0,
            }),
        }
    }

    /// Whether a frame is the answer to the request sent at `sent`.
    pub fn is_answer(self, frame: &Received, sent: Instant) -> bool {
        match self {
            Self::Timesync => {
                let sync = frame.decode::<dialect::Timesync>();
                sync.is_some_and(|sync| sync.tc1 != 0 && sync.ts1 == stamp(sent))
            }
            Self::Parameter => frame.decode::<ParamValue>().is_some_and(|value| value.param_index == 0),
            Self::Command => frame.decode::<CommandAck>().is_some_and(|ack| ack.command == MavCmd::REQUEST_MESSAGE),
        }
    }
}

/// The name in a request for a parameter by its index.
const IGNORED_NAME: &str = "BY_ITS_INDEX____";

/// Returns the time as TIMESYNC carries it (ns), never 0.
fn stamp(now: Instant) -> i64 {
    now.as_micros() as i64 * 1_000 + 1
}
