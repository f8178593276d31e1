//! The dialogues of the smaller services, with each client, against a vehicle with all of them.

mod files;
mod logs;
mod rig;
mod vehicle;
