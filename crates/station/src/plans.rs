//! Plans: missions, fences and rally points.
