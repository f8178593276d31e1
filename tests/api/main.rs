//! What a user of the crate meets first: the README's loop, the pages and their links, the errors' texts, and what the compiler
//! refuses. Beside them, the rooms of `src/`.

#[path = "../support/mod.rs"]
mod support;

mod compile_fail;
mod errors;
mod pages;
mod readme;
mod rooms;
