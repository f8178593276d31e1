//! Why a dialogue failed.

use crate::names::Named;
use mavstack::PlanType;
use mavstack::dialect::{MavCmd, MavFtpErr, MavMissionResult, MavParamError, MavResult};

/// Why a dialogue failed.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Failure {
    /// No autopilot was heard.
    NoVehicle,
    /// The vehicle did not answer in the time that the client waits.
    Timeout {
        /// What was not answered.
        request: String,
        /// How often it was sent.
        tries: u32,
    },
    /// A command was refused.
    Command {
        /// The command.
        command: MavCmd,
        /// The result.
        result: MavResult,
        /// The vehicle's text, if one came.
        text: Option<String>,
    },
    /// A plan was refused.
    Plan {
        /// The plan.
        plan: PlanType,
        /// The last item that the vehicle had asked for, if any: usually the one that it refuses.
        seq: Option<u16>,
        /// The result.
        result: MavMissionResult,
        /// The vehicle's text, if one came.
        text: Option<String>,
    },
    /// A parameter was refused.
    Param {
        /// Its name.
        name: String,
        /// The reason; `None` if the vehicle answered with another value.
        error: Option<MavParamError>,
        /// The vehicle's text, if one came.
        text: Option<String>,
    },
    /// A file operation was refused.
    File {
        /// The path.
        path: String,
        /// The reason.
        error: MavFtpErr,
        /// The vehicle's text, if one came.
        text: Option<String>,
    },
    /// The vehicle broke the protocol, or does not have what the client needs.
    Protocol(String),
    /// The vehicle is armed, and the program sends nothing to an armed vehicle. No dialogue of this crate returns it.
    Armed,
    /// The transport failed.
    Transport(String),
}

impl Failure {
    /// Returns a timeout.
    pub fn timeout(request: impl Into<String>, tries: u32) -> Self {
        Self::Timeout { request: request.into(), tries }
    }

    /// Whether lost frames may be the cause: the same dialogue may succeed the next time. MAVSDK ends a download with
    /// [`MavFtpErr::EOF`] if the last data was lost, because the end that follows it comes too early.
    pub fn is_by_loss(&self) -> bool {
        matches!(self, Self::Timeout { .. } | Self::File { error: MavFtpErr::EOF, .. })
    }

    /// Returns the vehicle's text with the reason of a refusal, if one came.
    pub fn text(&self) -> Option<&str> {
        match self {
            Self::Command { text, .. }
            | Self::Plan { text, .. }
            | Self::Param { text, .. }
            | Self::File { text, .. } => text.as_deref(),
            _ => None,
        }
    }

    /// Returns the place for the vehicle's text; `None` if it is no refusal.
    pub(crate) fn text_mut(&mut self) -> Option<&mut Option<String>> {
        match self {
            Self::Command { text, .. }
            | Self::Plan { text, .. }
            | Self::Param { text, .. }
            | Self::File { text, .. } => Some(text),
            _ => None,
        }
    }
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoVehicle => f.write_str("no heartbeat of an autopilot was received: is the link connected?")?,
            Self::Timeout { request, tries: 1 } => write!(f, "{request} was not answered")?,
            Self::Timeout { request, tries } => write!(f, "{request} was not answered, sent {tries} times")?,
            Self::Command { command, result, .. } => {
                write!(f, "the vehicle refused {}: {}", command.named(), result.named())?
            }
            Self::Plan { plan, seq: Some(seq), result, .. } => {
                write!(f, "the vehicle refused the {} at item {seq}: {}", plan_name(*plan), result.named())?;
            }
            Self::Plan { plan, result, .. } => {
                write!(f, "the vehicle refused the {}: {}", plan_name(*plan), result.named())?;
            }
            Self::Param { name, error: Some(error), .. } => {
                write!(f, "the vehicle refused parameter {name}: {}", error.named())?
            }
            Self::Param { name, .. } => write!(f, "the vehicle kept another value of parameter {name}")?,
            Self::File { path, error, .. } => write!(f, "the vehicle refused file {path}: {}", error.named())?,
            Self::Armed => f.write_str("the vehicle is armed")?,
            Self::Protocol(what) | Self::Transport(what) => f.write_str(what)?,
        }
        self.text().map_or(Ok(()), |text| write!(f, " ({text})"))
    }
}

impl std::error::Error for Failure {}

/// Returns the name of a plan in a sentence.
pub(crate) fn plan_name(plan: PlanType) -> &'static str {
    match plan {
        PlanType::Mission => "mission",
        PlanType::Fence => "fence",
        PlanType::Rally => "rally points",
    }
}
