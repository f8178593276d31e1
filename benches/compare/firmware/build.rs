//! Adds the memory layout of the emulated board, and links the C library that `cargo measure compare` has built.

use std::path::Path;

fn main() {
    println!("cargo::rustc-link-search={}", Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..").display());
    println!("cargo::rerun-if-changed=../../../memory.x");
    println!("cargo::rerun-if-env-changed=COMPARE_C_LIBRARY");
    if let (Some(_), Ok(folder)) = (std::env::var_os("CARGO_FEATURE_C"), std::env::var("COMPARE_C_LIBRARY")) {
        println!("cargo::rustc-link-search=native={folder}");
        println!("cargo::rustc-link-lib=static=comparefirmware");
        println!("cargo::rerun-if-changed={folder}/libcomparefirmware.a");
    }
}
