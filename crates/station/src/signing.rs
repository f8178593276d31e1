//! Message signing: keys that a vehicle is given.
