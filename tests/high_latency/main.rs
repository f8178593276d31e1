//! Links by satellite: when they send, what they may send, and what they delay.

#[path = "../support/mod.rs"]
mod support;

mod allowed_messages;
mod auto;
mod delayed;
#[cfg(feature = "signing")]
mod delayed_signed;
mod link;
