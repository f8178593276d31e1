//! Links, the transports below them, and the peers behind them.

#[path = "../support/mod.rs"]
mod support;

#[cfg(feature = "embedded-io-async")]
mod async_ends;
mod failing;
mod io;
mod opened;
mod peers;
mod transports;
mod udp;
