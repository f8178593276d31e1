//! The network: who is heard on which link, and what goes on from one link to another.
//!
//! ```text
//!   frame ──▶ peers: who, on which link ──▶ routes: for whom, on which links ──▶ forward: the queues of these links
//!                                                                                  │     ▲
//!                                                                                  ▼     │
//!                                                                              queue   memory: did it come before?
//! ```

mod forward;
mod memory;
mod peers;
mod queue;
mod routes;

pub(crate) use forward::Passage;
pub use forward::{ForwardCounters, ForwardQueues, Forwarding};
pub use peers::PeerInfo;
pub(crate) use peers::{Booking, Peers, Reception, deadline, is_heard, is_known, on_frame, on_unchecked, poll};
pub(crate) use routes::{forget_rebooted, routes};
