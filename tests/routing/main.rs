//! Which frames are for us, and which are forwarded to other links and vehicles.

#[path = "../support/mod.rs"]
mod support;

mod addressing;
mod forwarding;
mod networks;
mod queues;
#[cfg(feature = "signing")]
mod refused;

use mavstack::__private::NoPlans;
use support::{Forwarded, Tested, World};

/// A world whose vehicle forwards between its `N` links.
type Forwarder<const N: usize, P = NoPlans, const PEERS: usize = 8> = World<N, Tested<P, PEERS, Forwarded>>;
