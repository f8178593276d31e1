//! Flight modes.
