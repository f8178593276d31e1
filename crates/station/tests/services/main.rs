//! The dialogues of the smaller services, with each client, against a vehicle with all of them.

mod camera;
mod control;
mod events;
mod files;
mod forms;
mod gimbal;
mod logs;
mod rig;
mod signing;
mod sticks;
mod time;
mod vehicle;
