//! Small data types that the services share: links and peers, commands and outcomes, the configuration, texts.

mod command;
mod component;
mod config;
mod context;
mod control;
mod credits;
mod decode;
mod events;
mod faults;
mod firmware;
mod identity;
mod link;
mod observed;
mod plans;
mod requests;
mod sender;
#[cfg(feature = "signing")]
mod signing;
mod texts;
mod vehicle;

pub use command::{Command, CommandAnswer, CommandPosition, Outcome};
pub(crate) use command::{ModeFault, Origin, Refusal, RefusalReason, SignedAt};
pub use component::{Component, MAX_COMPONENTS};
pub(crate) use config::Allowance;
pub use config::{Config, Durability, PollBudget, VehicleAddress};
pub use context::Context;
pub(crate) use control::CHANNELS;
pub use control::{
    AttitudeSetpoint, ControlInput, ManualControlInput, Place, PositionSetpoint, RcOverride, Setpoint, Target,
};
pub use credits::{CreditConfig, CreditMemory, CreditView, Credits, Payer};
pub use events::{EventEntry, EventLog, EventSequence, MAX_EVENT_ARGUMENTS};
pub use faults::HookFaults;
pub use firmware::{Firmware, Values};
pub use identity::{Identity, version};
pub use link::{LinkClass, LinkConfig, LinkId, MAX_LINKS, Peer, StreamProfile, TxVersion};
pub(crate) use link::{LinkFacts, LinkMask, Progress};
pub(crate) use observed::ObservedVehicle;
pub use plans::{MAX_ITEMS, NoPlans, PlanBuffers, PlanMemory, PlanMemoryOf, PlanType, PlanView, PlansMut, largest};
pub(crate) use plans::{NO_ITEM, UploadStep};
pub(crate) use requests::{Cancellation, MAX_PENDING, Pending};
pub use requests::{Destination, Recipient, RequestQueue, Requests};
pub use sender::{Controllers, Sender, Trust};
#[cfg(feature = "signing")]
pub use signing::{Accept, LinkSigning};
pub use texts::MAX_TEXT_LEN;
pub(crate) use texts::{ONE_FRAME, TextNumber};
pub use texts::{StatusTexts, TextEntry, TextKind};
pub use vehicle::{PeerEvent, Vehicle, VehicleState};
