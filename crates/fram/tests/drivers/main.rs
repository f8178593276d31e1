//! The drivers on a mocked bus and on simulated chips, and a vehicle that stores its plans and parameters there.

mod bus;
mod chips;
mod eeprom;
mod fram;
mod vehicle;
