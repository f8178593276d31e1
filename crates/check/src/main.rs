//! `mavstack-check`: examines a vehicle's board.

fn main() {}
