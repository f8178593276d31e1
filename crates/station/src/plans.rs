//! Plans: missions, fences and rally points, up, down and cleared, and the current item.
//!
//! | | QGroundControl | MAVSDK | MAVProxy | pymavlink |
//! |---|---|---|---|---|
//! | upload: MISSION_COUNT again | 1.5 s, 7 tries | 0.5 s, 5 tries | never | never |
//! | upload: without a request | ends after 1.5 s | ends after 2.5 s | ends after 10 s | ends after 3 s |
//! | upload: last item was lost | sends it again if asked | the same | does not: the upload fails | sends it again |
//! | answer to MISSION_REQUEST | MISSION_ITEM_INT | MISSION_ACK: UNSUPPORTED | MISSION_ITEM_INT | MISSION_ITEM |
//! | download: list again | 1.5 s, 7 tries | 0.5 s, 5 tries | never | never |
//! | download: item again | 250 ms, 7 tries | 0.5 s, 5 tries | 2 s, 5 items at a time | never |
//! | download: asks with | MISSION_REQUEST_INT | MISSION_REQUEST_INT | MISSION_REQUEST_INT | MISSION_REQUEST |
//! | download: closing MISSION_ACK | yes | yes | no | no |
//! | MISSION_CLEAR_ALL | 1.5 s, 7 tries | 0.5 s, 5 tries | once | once |
//! | current item | MAV_CMD_DO_SET_MISSION_CURRENT, else the message | MISSION_SET_CURRENT | the command | the message |
//!
//! pymavlink has no transfers of its own: it is a script that asks and answers one by one, and waits 3 s.

mod clear;
mod current;
mod download;
mod items;
mod upload;

pub use clear::Clear;
pub use current::SetCurrent;
pub use download::{Download, Plan};
pub use items::{from_message, waypoint};
pub use upload::Upload;

use crate::{Client, Failure, Io, Received};
use mavstack::dialect::{MavAutopilot, MavMissionResult, MissionAck};
use mavstack::{Duration, PlanType};

/// The timers of a transfer.
#[derive(Clone, Copy, Debug)]
struct Timing {
    /// How long to wait for the answer to COUNT, REQUEST_LIST and CLEAR_ALL.
    wait: Duration,
    /// How often they are sent.
    tries: u32,
}

impl Timing {
    fn of(client: Client) -> Self {
        match client {
            Client::QGroundControl => Self { wait: Duration::from_millis(1_500), tries: 7 },
            Client::Mavsdk => Self { wait: Duration::from_millis(500), tries: 5 },
            Client::MavProxy => Self { wait: Duration::from_secs(10), tries: 1 },
            Client::Pymavlink => Self { wait: client.patience(), tries: 1 },
        }
    }
}

/// Returns the target fields for a message.
fn target(io: &Io<'_>) -> (u8, u8) {
    let target = io.target();
    (target.system.wire(), target.component.wire())
}

/// Whether a message of a transfer is for this client: from its vehicle, and addressed to it. Only MAVProxy looks at the addressee.
fn is_ours(io: &Io<'_>, frame: &Received, is_for_us: bool) -> bool {
    frame.source() == io.target() && (is_for_us || io.client() != Client::MavProxy)
}

/// Returns a MISSION_ACK for this transfer. MAVSDK does not look at its plan type.
fn ack_of(io: &Io<'_>, frame: &Received, plan: PlanType) -> Option<MissionAck> {
    let ack = frame.decode::<MissionAck>()?;
    let is_plan = ack.mission_type == plan.mission_type() || io.client() == Client::Mavsdk;
    let is_ours = is_ours(io, frame, io.is_for_us(ack.target_system, ack.target_component));
    (is_plan && is_ours).then_some(ack)
}

/// Sends a MISSION_ACK.
fn send_ack(io: &mut Io<'_>, plan: PlanType, result: MavMissionResult) {
    let (target_system, target_component) = target(io);
    io.send(&MissionAck {
        target_system,
        target_component,
        r#type: result,
        mission_type: plan.mission_type(),
        opaque_id: 0,
    });
}

/// Returns the failure of a refusal, at an item if one was transferred.
fn refused(plan: PlanType, seq: Option<u16>, result: MavMissionResult) -> Failure {
    Failure::Plan { plan, seq, result, text: None }
}

/// Whether the vehicle is ArduPilot, with which MAVSDK accepts MISSION_REQUEST.
fn is_ardupilot(io: &Io<'_>) -> bool {
    let heartbeat = io.seen().component(io.target()).and_then(|component| component.heartbeat);
    heartbeat.is_some_and(|heartbeat| heartbeat.autopilot == MavAutopilot::ARDUPILOTMEGA)
}
