//! Links again when the memory layout changes.

fn main() {
    println!("cargo:rerun-if-changed=memory.x");
}
