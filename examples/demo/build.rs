//! Compresses the descriptions of the parameters and of the events, and writes the file that names them (O-1).
//!
//! Ground stations take files of the format ".xz". They are a quarter as long, in flash and on the link.

use std::io::Write as _;
use std::path::Path;
use std::{env, fs};

use lzma_rust2::{CheckType, XzOptions, XzWriter};

/// The description, and its `COMP_METADATA_TYPE`.
const FILES: [(&str, u8); 2] = [("parameters.json", 1), ("events.json", 4)];

fn main() {
    let folder = env::var("OUT_DIR").expect("Cargo sets it");
    let mut types = Vec::new();
    for (name, kind) in FILES {
        let source = Path::new("metadata").join(name);
        println!("cargo:rerun-if-changed={}", source.display());
        let bytes = compress(&fs::read(&source).expect("the description"));
        types.push(format!(r#"{{"type":{kind},"uri":"mftp:///{name}.xz","fileCrc":{}}}"#, crc(&bytes)));
        fs::write(Path::new(&folder).join(format!("{name}.xz")), bytes).expect("the folder can be written to");
    }
    let general = format!(r#"{{"version":1,"metadataTypes":[{}]}}"#, types.join(","));
    fs::write(Path::new(&folder).join("general.crc"), crc(general.as_bytes()).to_string())
        .expect("the folder can be written to");
    fs::write(Path::new(&folder).join("general.json"), general).expect("the folder can be written to");
}

/// Ground stations with a small decoder check CRC-32 only.
fn compress(bytes: &[u8]) -> Vec<u8> {
    let mut options = XzOptions::with_preset(9);
    options.set_check_sum_type(CheckType::Crc32);
    options.lzma_options.dict_size = 64 * 1024;
    let mut writer = XzWriter::new(Vec::new(), options).expect("the options are valid");
    writer.write_all(bytes).expect("a vector takes all");
    writer.finish().expect("a vector takes all")
}

/// MAVLink's CRC-32 of a file.
fn crc(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg()))
    })
}
