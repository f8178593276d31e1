//! The dialogues of the smaller services, with each client, against a vehicle with all of them.

mod control;
mod events;
mod files;
mod logs;
mod rig;
mod signing;
mod sticks;
mod time;
mod vehicle;
