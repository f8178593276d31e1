//! A rig: a firmware, its lines and a ground station in one process and in simulated time.
