//! Links, the transports below them, and the peers behind them.

#[path = "../support/mod.rs"]
mod support;

mod io;
mod peers;
mod transports;
