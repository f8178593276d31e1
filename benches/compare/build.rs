//! Links the C library that `cargo measure compare` has built.

fn main() {
    println!("cargo::rerun-if-env-changed=COMPARE_C_LIBRARY");
    if let (Some(_), Ok(folder)) = (std::env::var_os("CARGO_FEATURE_C"), std::env::var("COMPARE_C_LIBRARY")) {
        println!("cargo::rustc-link-search=native={folder}");
        println!("cargo::rustc-link-lib=static=compare");
        println!("cargo::rerun-if-changed={folder}/libcompare.a");
    }
}
