//! Manual control: sticks and setpoints at a rate.
