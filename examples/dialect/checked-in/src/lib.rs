//! Messages from an XML of one's own, made by the command line tool and checked in: who builds the firmware needs no
//! generator. After a change of `crane.xml`:
//!
//! ```text
//! mavstack-dialect --beside-common crane.xml src/crane.rs
//! ```
#![no_std]

pub mod crane;
