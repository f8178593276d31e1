//! The declaration of a stack, and the types that `#[stack]` names in it.

use super::memory::Memory;
use crate::network::Peers;
use crate::service::ServiceList;
use crate::service::command::{CommandMemory, Commands};
use crate::service::param::ParamMemory;
use crate::service::{ControlGate, ForwardingGate, OwnCommands, Service, SigningGate, SticksGate};
use crate::types::{EventLog, Firmware, Requests, StatusTexts, Vehicle};

/// A service whose content is stored. Without the feature `storage` it is any service.
#[cfg(not(feature = "storage"))]
#[doc(hidden)]
pub use crate::service::Service as Persistent;
#[cfg(feature = "storage")]
pub use crate::storage::Persistent;

/// The services of a firmware, and their memory. [`#[stack]`](macro@crate::Stack) implements it.
#[doc(hidden)]
pub trait Declares: Firmware<Vehicle: Vehicle + Commands, Parameters: ParamMemory> {
    /// The services of the struct that declares the stack.
    type Services: ServiceList<Self>;
    type Peers: Memory<View = Peers>;
    type Texts: Memory<View = StatusTexts>;
    type Requests: Memory<View = Requests>;
    type EventLog: Memory<View = EventLog>;
    /// The number of links that have a queue of messages.
    const MESSAGE_QUEUES: usize = 0;
    type Commands: CommandMemory;
    type Components: Service<Self>;
    type Mission: Persistent<Self>;
    type Param: Persistent<Self>;
    type Stream: Service<Self>;
    type Messages: Service<Self>;
    type Client: Service<Self> + OwnCommands<Self>;
    type Events: Service<Self>;
    type Logs: Service<Self>;
    type Mode: Service<Self>;
    type ManualControl: Service<Self> + SticksGate;
    type OperatorControl: Service<Self> + ControlGate;
    type Signing: Persistent<Self> + SigningGate<<Self::Signing as Service<Self>>::Link>;
    type Files: Service<Self>;
    type Forwarding: Service<Self> + ForwardingGate<Self>;
    type Records: Persistent<Self>;
    type Storage: Memory;
    /// Fails to compile if the declaration is invalid.
    const CHECKED: ();
}

/// A declaration with its links, whose stack is [`StackOf`]. [`derive(Stack)`](crate::Stack) implements it.
#[doc(hidden)]
pub trait Declaration {
    type Stack;
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
