//! The linker script of defmt, when there is a log. The others are in `.cargo/config.toml`.

fn main() {
    // The linker runs in the workspace's root and finds `memory.x` there.
    println!("cargo:rerun-if-changed=../../memory.x");
    println!("cargo:rerun-if-changed=build.rs");
    if std::env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
}
