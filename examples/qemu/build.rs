//! Adds linker scripts: the board's interrupts, and defmt's if logging is enabled. The others are in `.cargo/config.toml`.

use std::env;

fn main() {
    // The linker runs in the workspace root and finds `memory.x` there.
    println!("cargo:rerun-if-changed=../../memory.x");
    println!("cargo:rerun-if-changed=device.x");
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-link-search={}", env::var("CARGO_MANIFEST_DIR").expect("set by cargo"));
    if env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
}
