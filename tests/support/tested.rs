//! The declaration of the tests' stacks: [`Tested`], composed of types. A firmware uses [`mavstack::Stack`].

use super::{TestVehicle, Tuning};
use mavstack::__private::{
    About, Absent, CommandSlots, Credits, Declares, EventHistory, Firmware, Forwarding, ForwardingGate, Look, LookAll,
    Missions, ModeService, ParamMemory, ParamService, PeerTable, Persistent, RequestQueue, Requests, Service,
    ServiceList, SigningGate, SticksGate, StreamService, TextQueue, Values, Visit, VisitAll, WithoutPlans,
    WithoutSigning,
};
use mavstack::__private::{NoPlans, PlanBuffers, PlanMemory};
use mavstack::clock::Time;
use mavstack::high_latency::HighLatency;
use mavstack::manual_control::ManualInput;
use mavstack::setpoints::Setpoints;
use mavstack::{Commands, Config, FlightMode, LinkConfig, Modes, Plans, Stack, Stream, Telemetry, Vehicle};
use std::marker::PhantomData;

/// A stack of the vehicle `V` with plan memory `P`, `PEERS` entries in the peer table, and the services of `O`.
pub struct Tested<P = NoPlans, const PEERS: usize = 8, O = Plain, V = TestVehicle>(PhantomData<(P, O, V)>);

impl<P, const PEERS: usize, O, V> Firmware for Tested<P, PEERS, O, V>
where
    P: PlanMemory + 'static,
    O: 'static,
    V: Hooks + 'static,
{
    type Vehicle = V;
    type Plans = P;
    type Parameters = V::Parameters;
    type Credits = [Credits; 1];
    const HAS_MODES: bool = V::HAS_MODES;
}

impl<P, const PEERS: usize, O, V> Declares for Tested<P, PEERS, O, V>
where
    P: Planned<Self> + 'static,
    O: Options<Self> + 'static,
    V: HookServices<Self> + 'static,
{
    type Services = Chosen<O::Time, O::Setpoints, O::HighLatency>;
    type Peers = PeerTable<PEERS>;
    type Texts = TextQueue<4>;
    type Commands = CommandSlots<3>;
    type Components = Absent;
    type Mission = P::Mission;
    type Param = V::Param;
    type Requests = Requests<[RequestQueue; 0]>;
    type Messages = Absent;
    type Client = Absent;
    type Events = Absent;
    type EventLog = EventHistory<0>;
    type Logs = Absent;
    type Stream = V::Stream;
    type Mode = V::Mode;
    type ManualControl = O::ManualControl;
    type OperatorControl = Absent;
    type Signing = O::Signing;
    type Forwarding = O::Forwarding;
    type Files = Absent;
    type Records = Absent;
    type Storage = Stored;
    const CHECKED: () = V::CHECKED;
}

/// The storage of the tests, or none without the feature.
#[cfg(feature = "storage")]
type Stored = mavstack::__private::Storage;
#[cfg(not(feature = "storage"))]
type Stored = Absent;

/// Returns a stack that has begun.
pub fn begun<D: Declares, const N: usize>(config: Config, links: [LinkConfig; N]) -> Box<Stack<D, N>> {
    let mut stack: Box<Stack<D, N>> = Box::new(Stack::VACANT);
    stack.begin(config, links);
    stack
}

/// The service for a plan memory.
pub trait Planned<D: Firmware>: PlanMemory {
    type Mission: Persistent<D>;
}

impl<D: Firmware> Planned<D> for NoPlans {
    type Mission = WithoutPlans;
}

impl<D, const M: usize, const F: usize, const R: usize, const S: usize> Planned<D> for PlanBuffers<M, F, R, S>
where
    D: Firmware<Vehicle: Vehicle + Plans + Commands>,
{
    type Mission = Missions;
}

/// The services that a test chooses.
pub trait Options<D: Firmware> {
    type Time: Service<D>;
    type ManualControl: Service<D> + SticksGate;
    type Setpoints: Service<D>;
    type HighLatency: Service<D>;
    type Signing: Persistent<D> + SigningGate<<Self::Signing as Service<D>>::Link>;
    type Forwarding: Service<D> + ForwardingGate<D>;
}

/// The services that a declaration has as fields.
#[derive(Debug)]
pub struct Chosen<T, S, H> {
    pub time: T,
    pub setpoints: S,
    pub high_latency: H,
}

impl<F: Firmware, T: Service<F>, S: Service<F>, H: Service<F>> ServiceList<F> for Chosen<T, S, H> {
    type Links = (T::Link, S::Link, H::Link);
    const NEW: Self = Self { time: T::NEW, setpoints: S::NEW, high_latency: H::NEW };
    const VACANT: Self::Links = (T::VACANT, S::VACANT, H::VACANT);
    const ABOUT: &'static [About] = &[T::ABOUT, S::ABOUT, H::ABOUT];

    fn visit(&mut self, (time, setpoints, high_latency): &mut Self::Links, visit: &mut impl Visit<F>) -> bool {
        visit.visit(&mut self.time, time)
            || visit.visit(&mut self.setpoints, setpoints)
            || visit.visit(&mut self.high_latency, high_latency)
    }

    fn look(&self, (time, setpoints, high_latency): &Self::Links, look: &mut impl Look<F>) {
        look.look(&self.time, time);
        look.look(&self.setpoints, setpoints);
        look.look(&self.high_latency, high_latency);
    }

    fn visit_all<L>(
        &mut self,
        states: &mut [L],
        of: impl Fn(&mut L) -> &mut Self::Links + Copy,
        visit: &mut impl VisitAll<F>,
    ) {
        visit.visit(&mut self.time, states.iter_mut().map(move |state| &mut of(state).0));
        visit.visit(&mut self.setpoints, states.iter_mut().map(move |state| &mut of(state).1));
        visit.visit(&mut self.high_latency, states.iter_mut().map(move |state| &mut of(state).2));
    }

    fn look_all(&self, look: &mut impl LookAll<F>) {
        look.look(&self.time);
        look.look(&self.setpoints);
        look.look(&self.high_latency);
    }
}

macro_rules! options {
    ($($(#[$meta:meta])* $name:ident: $time:ty, $manual:ty, $setpoints:ty, $high_latency:ty, $signing:ty, $forwarding:ty;)*) => { $(
        $(#[$meta])*
        #[derive(Debug)]
        pub struct $name;

        impl<D: Firmware<Vehicle: Vehicle>> Options<D> for $name {
            type Time = $time;
            type ManualControl = $manual;
            type Setpoints = $setpoints;
            type HighLatency = $high_latency;
            type Signing = $signing;
            type Forwarding = $forwarding;
        }
    )* };
}

/// The signing of the tests, or none without the feature.
#[cfg(feature = "signing")]
type Signs = mavstack::__private::SigningStreams<16>;
#[cfg(not(feature = "signing"))]
type Signs = WithoutSigning;

/// The forwarding of the tests: six links.
pub type Forwards = Forwarding<6, 512, 256>;

options! {
    /// None.
    Plain: Absent, Absent, Absent, Absent, WithoutSigning, Absent;
    /// PING and TIMESYNC.
    Timed: Time, Absent, Absent, Absent, WithoutSigning, Absent;
    /// Manual control and setpoints.
    Steered: Absent, ManualInput, Setpoints, Absent, WithoutSigning, Absent;
    /// HIGH_LATENCY2.
    Satellite: Absent, Absent, Absent, HighLatency, WithoutSigning, Absent;
    /// Forwarding.
    Forwarded: Absent, Absent, Absent, Absent, WithoutSigning, Forwards;
    /// Forwarding and HIGH_LATENCY2.
    ForwardedSatellite: Absent, Absent, Absent, HighLatency, WithoutSigning, Forwards;
    /// Signing.
    Signed: Absent, Absent, Absent, Absent, Signs, Absent;
    /// Signing and HIGH_LATENCY2.
    SignedSatellite: Absent, Absent, Absent, HighLatency, Signs, Absent;
    /// Signing and forwarding.
    SignedForwarded: Absent, Absent, Absent, Absent, Signs, Forwards;
    /// All except signing.
    Unsigned: Time, ManualInput, Setpoints, HighLatency, WithoutSigning, Forwards;
    /// All of them.
    Everything: Time, ManualInput, Setpoints, HighLatency, Signs, Forwards;
}

/// The hooks of a test vehicle besides `Vehicle` and `Commands`.
pub trait Hooks: Vehicle + Commands {
    type Parameters: ParamMemory + Values;
    const HAS_MODES: bool = false;
    const CHECKED: () = ();
}

/// The services for these hooks.
pub trait HookServices<D: Firmware>: Hooks {
    type Param: Persistent<D>;
    type Stream: Service<D>;
    type Mode: Service<D>;
}

impl Hooks for TestVehicle {
    type Parameters = Tuning;
    const CHECKED: () = Stream::check(<Self as Telemetry>::STREAMS, false);
}

impl<D: Firmware<Vehicle = Self, Parameters = Tuning>> HookServices<D> for TestVehicle {
    type Param = ParamService;
    type Stream = StreamService<{ <Self as Telemetry>::STREAMS.len() }>;
    type Mode = Absent;
}

/// The services of a vehicle with modes and streams, and without parameters.
pub type WithModes = ModeService;

/// Checks the modes of a vehicle.
pub const fn check_modes<V: Modes>() {
    FlightMode::check(V::MODES);
}
