//! Events, and requests of those that were lost.
