//! The current item of the mission.

use super::target;
use crate::command::Send;
use crate::{Client, Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::Duration;
use mavstack::dialect::{MavCmd, MavResult, MissionCurrent, MissionSetCurrent};

/// How long MAVSDK is waited for, which repeats for ever as long as the vehicle reports another item.
const MAVSDK_WITHIN: Duration = Duration::from_secs(10);

/// Makes an item of the mission the current one.
///
/// QGroundControl and MAVProxy send MAV_CMD_DO_SET_MISSION_CURRENT, and QGroundControl falls back to MISSION_SET_CURRENT if the command is
/// unsupported. MAVSDK and pymavlink send MISSION_SET_CURRENT, which has no answer but MISSION_CURRENT.
#[derive(Clone, Debug)]
pub struct SetCurrent {
    seq: u16,
    phase: Phase,
    /// The item that the vehicle reported last.
    reported: Option<u16>,
}

#[derive(Clone, Debug)]
enum Phase {
    New,
    Command(Send),
    Message { retry: Retry, limit: Retry },
}

impl SetCurrent {
    /// Creates the dialogue.
    pub fn new(seq: u16) -> Self {
        Self { seq, phase: Phase::New, reported: None }
    }

    fn message(client: Client) -> Phase {
        let retry = match client {
            // It sends such messages five times.
            Client::QGroundControl => Retry::new(Duration::from_millis(500), 5),
            Client::Mavsdk => Retry::new(Duration::from_millis(500), 5),
            Client::MavProxy | Client::Pymavlink => Retry::new(client.patience(), 1),
        };
        Phase::Message { retry, limit: Retry::new(MAVSDK_WITHIN, 1) }
    }

    fn timeout(&self, tries: u32) -> Failure {
        Failure::timeout(format!("MISSION_SET_CURRENT {}", self.seq), tries)
    }
}

impl Dialogue for SetCurrent {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        if matches!(self.phase, Phase::New) {
            self.phase = match io.client() {
                Client::QGroundControl | Client::MavProxy => {
                    Phase::Command(Send::new(MavCmd::DO_SET_MISSION_CURRENT, &[f32::from(self.seq)]))
                }
                client => Self::message(client),
            };
        }
        match &mut self.phase {
            Phase::New => None,
            Phase::Command(send) => match send.poll(io)? {
                Err(Failure::Command { result: MavResult::UNSUPPORTED, .. })
                    if io.client() == Client::QGroundControl =>
                {
                    self.phase = Self::message(io.client());
                    None
                }
                result => Some(result.map(drop)),
            },
            Phase::Message { .. } if self.reported == Some(self.seq) => Some(Ok(())),
            Phase::Message { retry, limit } => {
                // MAVSDK repeats as soon as it hears another item.
                if io.client() == Client::Mavsdk && self.reported.take().is_some() {
                    retry.restart();
                }
                let (due, tries) = (retry.due(io.now()), retry.tries());
                if limit.due(io.now()) == Due::GiveUp || due == Due::GiveUp {
                    return Some(Err(self.timeout(tries)));
                }
                if due == Due::Send {
                    let (target_system, target_component) = target(io);
                    io.send(&MissionSetCurrent { seq: self.seq, target_system, target_component });
                }
                None
            }
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        match &mut self.phase {
            Phase::Command(send) => send.receive(io, frame),
            Phase::Message { .. } if frame.source() == io.target() => {
                self.reported = frame.decode::<MissionCurrent>().map(|current| current.seq).or(self.reported);
            }
            _ => {}
        }
    }
}
