//! The network: counters of links, the peers on them, routes, and forwarding between links.
//!
//! ```text
//!   frame ──▶ peers: source and link ──▶ routes: links that reach the target ──▶ forward: the queues of these links
//!                                                                                  │     ▲
//!                                                                                  ▼     │
//!                                                                              queue   memory: is it a duplicate?
//! ```

mod forward;
mod hash;
mod memory;
mod peers;
mod queue;
mod routes;

// For firmwares, whose names of links and peers are here.
pub use crate::link::{LinkCounters, LinkError};
#[doc(hidden)]
pub use forward::ForwardDecision;
pub(crate) use forward::Passed;
pub use forward::{ForwardCounters, ForwardQueues};
pub use peers::PeerInfo;
#[doc(hidden)]
pub use peers::{Peers, SenderEntry};
pub(crate) use peers::{
    Reception, Recorded, Residents, deadline, is_heard, is_known, is_of_vehicle, poll, record, record_unchecked,
};
pub(crate) use routes::{forget_rebooted, learn_route, routes, target_of};
