//! The memory of the emulated board, the stream that is read, and the C library where `cargo xtask compare` has put it.

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
