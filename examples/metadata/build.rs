//! Makes the files that describe the parameters, from their declaration. Nothing is checked in, so nothing can be out of step.

use std::io::Write as _;
use std::path::PathBuf;
use std::{env, fs};

use lzma_rust2::{CheckType, XzOptions, XzWriter};
use mavstack::metadata::{self, MetadataFile};

// The build script has a copy of the declaration. So that file uses `mavstack` alone.
#[path = "src/tuning.rs"]
#[allow(dead_code, reason = "the build script only describes the parameters")]
mod tuning;

fn main() {
    println!("cargo:rerun-if-changed=src/tuning.rs");
    let folder = PathBuf::from(env::var_os("OUT_DIR").expect("Cargo sets it"));
    let write = |name: &str, bytes: &[u8]| fs::write(folder.join(name), bytes).expect("the folder can be written to");

    let mut parameters = String::new();
    metadata::parameters::<tuning::Tuning>(&mut parameters).expect("a string takes all");
    let parameters = compress(parameters.as_bytes());
    write("parameters.json.xz", &parameters);

    let file = MetadataFile::parameters("mftp:///parameters.json.xz", metadata::file_crc(&parameters));
    let mut general = String::new();
    metadata::general(&mut general, &[file]).expect("a string takes all");
    write("general.json", general.as_bytes());
    write("general.crc", metadata::file_crc(general.as_bytes()).to_string().as_bytes());
}

/// Compresses a file. Ground stations with a small decoder check CRC-32 only.
fn compress(bytes: &[u8]) -> Vec<u8> {
    let mut options = XzOptions::with_preset(9);
    options.set_check_sum_type(CheckType::Crc32);
    options.lzma_options.dict_size = 64 * 1024;
    let mut writer = XzWriter::new(Vec::new(), options).expect("the options are valid");
    writer.write_all(bytes).expect("a vector takes all");
    writer.finish().expect("a vector takes all")
}
