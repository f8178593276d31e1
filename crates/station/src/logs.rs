//! Downloads of flight logs.
