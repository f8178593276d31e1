//! Links anew when the memory layout was changed.

fn main() {
    println!("cargo:rerun-if-changed=memory.x");
}
