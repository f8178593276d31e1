//! Streams and requested messages.
