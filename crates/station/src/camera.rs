//! Camera control.
