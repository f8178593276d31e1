//! What a user meets first: the README's loop, the pages and their links, the error messages, and configurations that do not
//! compile. Also the rooms of `src/`.

#[path = "../support/mod.rs"]
mod support;

mod compile_fail;
mod derived;
mod errors;
mod pages;
mod readme;
mod rooms;
