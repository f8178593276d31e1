//! The declaration of a stack, and the types that `#[stack]` names in it.

use super::memory::Memory;
use crate::network::Peers;
use crate::service::ServiceList;
use crate::service::command::{CommandMemory, Commands};
use crate::service::param::ParamMemory;
use crate::service::{About, ControlGate, ForwardingGate, OwnCommands, Service, SigningGate, SticksGate, Turn};
use crate::types::{EventLog, Firmware, Requests, StatusTexts, Vehicle};

/// A service whose content is stored. Without the feature `storage` it is any service.
#[cfg(not(feature = "storage"))]
#[doc(hidden)]
pub use crate::service::Service as Persistent;
#[cfg(feature = "storage")]
pub use crate::storage::Persistent;

/// The services of a firmware, and their memory: the bound of functions that take any [`Stack`](struct@crate::Stack).
/// [`derive(Stack)`](macro@crate::Stack) implements it, and nothing else can. Its items are details of the derive.
///
/// ```
/// use mavstack::declare::Declares;
/// use mavstack::prelude::*;
///
/// /// Logs all counters of a stack that are not 0.
/// fn report<D: Declares, const LINKS: usize>(stack: &Stack<D, LINKS>) {
///     stack.counters(|counter| if counter.value > 0 { println!("{counter:?}") });
/// }
/// ```
pub trait Declares: Firmware<Vehicle: Vehicle + Commands, Parameters: ParamMemory> {
    /// The services of the struct that declares the stack.
    #[doc(hidden)]
    type Services: ServiceList<Self>;
    #[doc(hidden)]
    type Peers: Memory<View = Peers>;
    #[doc(hidden)]
    type Texts: Memory<View = StatusTexts>;
    #[doc(hidden)]
    type Requests: Memory<View = Requests>;
    #[doc(hidden)]
    type EventLog: Memory<View = EventLog>;
    /// The number of links.
    #[doc(hidden)]
    const LINKS: usize = crate::types::MAX_LINKS;
    /// The number of links that have a queue of messages.
    #[doc(hidden)]
    const MESSAGE_QUEUES: usize = 0;
    #[doc(hidden)]
    type Commands: CommandMemory;
    #[doc(hidden)]
    type Components: Service<Self>;
    #[doc(hidden)]
    type Mission: Persistent<Self>;
    #[doc(hidden)]
    type Param: Persistent<Self>;
    #[doc(hidden)]
    type Stream: Service<Self>;
    #[doc(hidden)]
    type Messages: Service<Self>;
    #[doc(hidden)]
    type Client: Service<Self> + OwnCommands<Self>;
    #[doc(hidden)]
    type Events: Service<Self>;
    #[doc(hidden)]
    type Logs: Service<Self>;
    #[doc(hidden)]
    type Mode: Service<Self>;
    #[doc(hidden)]
    type ManualControl: Service<Self> + SticksGate;
    #[doc(hidden)]
    type OperatorControl: Service<Self> + ControlGate;
    #[doc(hidden)]
    type Signing: Persistent<Self> + SigningGate<<Self::Signing as Service<Self>>::Link>;
    #[doc(hidden)]
    type Files: Service<Self>;
    #[doc(hidden)]
    type Forwarding: Service<Self> + ForwardingGate<Self>;
    #[doc(hidden)]
    type Records: Persistent<Self>;
    #[doc(hidden)]
    type Storage: Memory;
    /// Fails to compile if the declaration is invalid.
    #[doc(hidden)]
    const CHECKED: ();
}

/// A declaration with its links, whose stack is [`StackOf`](crate::StackOf). [`derive(Stack)`](macro@crate::Stack)
/// implements it.
pub trait Declaration {
    /// The stack: `Stack<D, LINKS>`.
    type Stack;
}

/// Returns the number of accounts of credits: one if a peer can cause a frame on a high-latency link (L-17), because the
/// firmware sends HIGH_LATENCY2 or forwards.
#[doc(hidden)]
pub const fn credits(services: &[About], has_forwarding: bool) -> usize {
    let (mut count, mut services) = (if has_forwarding { 1 } else { 0 }, services);
    while let [about, rest @ ..] = services {
        if Turn::bits(about.turns) & Turn::HighLatency.bit() != 0 {
            count = 1;
        }
        services = rest;
    }
    count
}

/// The list of the files of services: those of [virtual directories](crate::Files).
#[doc(hidden)]
#[macro_export]
macro_rules! __one_of {
    ($uploads:block;) => { $crate::__private::NoFile };
    ($uploads:block; $service:ty, $($rest:ty,)*) => {
        $crate::__private::OneOf<
            $uploads,
            <$service as $crate::__private::HasFiles>::File,
            $crate::__one_of!($uploads; $($rest,)*),
        >
    };
}

/// Signing with this many streams at a time.
#[cfg(feature = "signing")]
#[doc(hidden)]
#[macro_export]
macro_rules! __signing {
    ($n:expr) => { $crate::__private::SigningStreams<{ $n }> };
}

/// Signing without the feature.
#[cfg(not(feature = "signing"))]
#[doc(hidden)]
#[macro_export]
macro_rules! __signing {
    ($n:expr) => {
        ::core::compile_error!(
            "`signing` in `#[stack]` needs the feature `signing` of mavstack: enable it in Cargo.toml"
        )
    };
}

/// The state of storage, and the service of the firmware's own records.
#[cfg(feature = "storage")]
#[doc(hidden)]
#[macro_export]
macro_rules! __storage {
    () => { $crate::__private::Storage };
    ($n:expr) => { $crate::__private::RecordService<{ $n }> };
}

/// Storage without the feature.
#[cfg(not(feature = "storage"))]
#[doc(hidden)]
#[macro_export]
macro_rules! __storage {
    ($($n:expr)?) => {
        ::core::compile_error!(
            "`storage` in `#[stack]` needs the feature `storage` of mavstack: enable it in Cargo.toml"
        )
    };
}
