//! Operator control.
