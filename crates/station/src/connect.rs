//! What a client does when it finds a vehicle.
//!
//! | QGroundControl | MAVSDK | MAVProxy | pymavlink |
//! |---|---|---|---|
//! | HEARTBEAT | HEARTBEAT | HEARTBEAT | HEARTBEAT |
//! | AUTOPILOT_VERSION | AUTOPILOT_VERSION | parameters: `@PARAM/param.pck`, else the list | |
//! | AVAILABLE_MODES | | | |
//! | COMPONENT_METADATA, else COMPONENT_INFORMATION | | | |
//! | parameters | | | |
//! | mission | | | |
//! | geofence and rally points, if the capabilities say so | | | |
//!
//! QGroundControl asks for AUTOPILOT_VERSION again if there was no answer. It takes the file of parameters from ArduPilot, else the list.
//! The hash of PX4's parameters is not asked for, because there is no cache. SYSTEM_TIME is not sent, because there is no calendar.
//!
//! What a client sends besides, again and again, is at [`Station::poll`](crate::Station::poll).
//!
//! A step that fails does not end the dialogue, as in the real clients: [`Connected::failures`] tells what the user will miss.

use crate::modes::{self, Mode};
use crate::parameters::{self, Parameter};
use crate::plans::{self, Plan};
use crate::streams::Request;
use crate::{Again, Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::{
    AutopilotVersion, ComponentInformation, ComponentMetadata, Heartbeat, MavAutopilot, MavProtocolCapability,
};
use mavstack::{Address, Duration, Instant, PlanType};
use std::collections::VecDeque;

/// How long to wait for the first heartbeat.
const WITHIN: Duration = Duration::from_secs(10);

/// What was learned about a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Connected {
    /// Its address.
    pub vehicle: Address,
    /// Its heartbeat.
    pub heartbeat: Heartbeat,
    /// Its version and capabilities, if the client asks for them.
    pub version: Option<AutopilotVersion>,
    /// Its component metadata, if the client asks for them.
    pub metadata: Option<ComponentMetadata>,
    /// Its flight modes, if the client asks for them.
    pub modes: Vec<Mode>,
    /// Its parameters, if the client asks for them.
    pub parameters: Vec<Parameter>,
    /// Its plans, in the order of [`PlanType::ALL`], if the client asks for them.
    pub plans: [Option<Plan>; 3],
    /// The steps that failed.
    pub failures: Vec<Failure>,
}

impl Connected {
    fn new(vehicle: Address, heartbeat: Heartbeat) -> Self {
        Self {
            vehicle,
            heartbeat,
            version: None,
            metadata: None,
            modes: Vec::new(),
            parameters: Vec::new(),
            plans: [const { None }; 3],
            failures: Vec::new(),
        }
    }

    /// Returns the capabilities; none if they are not known.
    pub fn capabilities(&self) -> MavProtocolCapability {
        self.version.map_or(MavProtocolCapability::EMPTY, |version| version.capabilities)
    }
}

/// Connects as the client does.
#[derive(Debug, Default)]
pub struct Connect {
    end: Option<Instant>,
    steps: VecDeque<Step>,
    connected: Option<Connected>,
}

/// A step after the heartbeat.
#[derive(Debug)]
enum Step {
    Version(Again<Request<AutopilotVersion>, fn() -> Request<AutopilotVersion>>),
    Modes(modes::List),
    Metadata(Request<ComponentMetadata>),
    Information(Request<ComponentInformation>),
    ParameterFile(parameters::FileList),
    Parameters(parameters::List),
    Plan(PlanType, plans::Download),
}

impl Step {
    fn plan(plan: PlanType) -> Self {
        Self::Plan(plan, plans::Download::new(plan))
    }

    /// Returns the steps of a client.
    fn all(client: Client) -> VecDeque<Self> {
        match client {
            Client::QGroundControl => VecDeque::from([
                Self::Version(Again::new(2, Request::new)),
                Self::Modes(modes::List::new()),
                Self::Metadata(Request::new()),
                Self::Information(Request::new()),
                Self::ParameterFile(parameters::FileList::new()),
                Self::Parameters(parameters::List::new()),
                Self::plan(PlanType::Mission),
                Self::plan(PlanType::Fence),
                Self::plan(PlanType::Rally),
            ]),
            Client::Mavsdk => VecDeque::from([Self::Version(Again::new(1, Request::new))]),
            Client::MavProxy => VecDeque::from([
                Self::ParameterFile(parameters::FileList::new()),
                Self::Parameters(parameters::List::new()),
            ]),
            Client::Pymavlink => VecDeque::new(),
        }
    }

    /// Whether the client leaves the step out, after what it has learned.
    fn is_left_out(&self, client: Client, connected: &Connected) -> bool {
        let lacks = |capability| !connected.capabilities().contains(capability);
        match self {
            Self::Plan(PlanType::Fence, _) => lacks(MavProtocolCapability::MISSION_FENCE),
            Self::Plan(PlanType::Rally, _) => lacks(MavProtocolCapability::MISSION_RALLY),
            Self::ParameterFile(_) => {
                client == Client::QGroundControl && connected.heartbeat.autopilot != MavAutopilot::ARDUPILOTMEGA
            }
            Self::Information(_) => connected.metadata.is_some(),
            // The list is for vehicles without the file.
            Self::Parameters(_) => !connected.parameters.is_empty(),
            _ => false,
        }
    }

    /// Polls the step. Returns its failure, or nothing, once it has ended.
    fn poll(&mut self, io: &mut Io<'_>, connected: &mut Connected) -> Option<Result<(), Failure>> {
        Some(match self {
            Self::Version(request) => request.poll(io)?.map(|version| connected.version = Some(version)),
            Self::Modes(list) => list.poll(io)?.map(|modes| connected.modes = modes),
            Self::Metadata(request) => request.poll(io)?.map(|metadata| connected.metadata = Some(metadata)),
            Self::Information(request) => request.poll(io)?.map(drop),
            Self::ParameterFile(list) => list.poll(io)?.map(|parameters| connected.parameters = parameters),
            Self::Parameters(list) => list.poll(io)?.map(|parameters| connected.parameters = parameters),
            Self::Plan(plan, download) => {
                let plans = PlanType::ALL.into_iter().zip(&mut connected.plans);
                let places = plans.filter(|(other, _)| other == plan).map(|(_, place)| place);
                download.poll(io)?.map(|plan| places.for_each(|place| *place = Some(plan.clone())))
            }
        })
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        match self {
            Self::Version(request) => request.receive(io, frame),
            Self::Modes(list) => list.receive(io, frame),
            Self::Metadata(request) => request.receive(io, frame),
            Self::Information(request) => request.receive(io, frame),
            Self::ParameterFile(list) => list.receive(io, frame),
            Self::Parameters(list) => list.receive(io, frame),
            Self::Plan(_, download) => download.receive(io, frame),
        }
    }
}

impl Connect {
    /// Creates the dialogue.
    pub fn new() -> Self {
        Self::default()
    }

    /// Waits for a heartbeat of the autopilot.
    fn find(&mut self, io: &Io<'_>) -> Option<Failure> {
        let end = *self.end.get_or_insert(io.now() + WITHIN);
        let vehicle = io.target();
        if let Some(heartbeat) = io.seen().component(vehicle).and_then(|component| component.heartbeat) {
            self.connected = Some(Connected::new(vehicle, heartbeat));
            self.steps = Step::all(io.client());
        }
        (self.connected.is_none() && io.now() >= end).then_some(Failure::NoVehicle)
    }
}

impl Dialogue for Connect {
    type Output = Connected;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Connected, Failure>> {
        if self.connected.is_none()
            && let Some(failure) = self.find(io)
        {
            return Some(Err(failure));
        }
        let connected = self.connected.as_mut()?;
        while let Some(step) = self.steps.front_mut() {
            if !step.is_left_out(io.client(), connected)
                && let Err(failure) = step.poll(io, connected)?
            {
                connected.failures.push(failure);
            }
            self.steps.pop_front();
        }
        self.connected.take().map(Ok)
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(step) = self.steps.front_mut() {
            step.receive(io, frame);
        }
    }
}
