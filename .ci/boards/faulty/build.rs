//! Lets the linker find the memory layout of the Pico with DMA, and links again when it changes.

fn main() {
    let board = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../examples/boards/rp2040-dma");
    println!("cargo:rustc-link-search={board}");
    println!("cargo:rerun-if-changed={board}/memory.x");
}
