//! Helpers that several tests share.
#![allow(dead_code, reason = "each test uses only some of the helpers")]

use mavstack_dialect::Dialect;
use std::{
    io::Write,
    path::{Path, PathBuf},
};

/// The first line of wire.csv.
pub const HEADER: &str =
    "dialect,id,name,crc_extra,min_len,max_len,target_system_offset,target_component_offset,wire_order";

/// A path in this package.
pub fn path(relative: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(relative)
}

/// The XML files of directories, sorted by name without the extension.
pub fn xml_files(directories: &[PathBuf]) -> Vec<PathBuf> {
    let entries = directories.iter().flat_map(|dir| std::fs::read_dir(dir).expect("a directory"));
    let mut files: Vec<_> = entries.map(|entry| entry.expect("an entry").path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "xml"));
    files.sort_by_key(|file| file.file_stem().expect("a name").to_owned());
    files
}

/// The rows of wire.csv for a dialect.
pub fn rows(name: &str, dialect: &Dialect) -> Vec<String> {
    let offset = |offset: Option<usize>| offset.map_or(String::new(), |offset| offset.to_string());
    let row = |message: &mavstack_dialect::model::Message| {
        let order: Vec<_> = message.wire_order().iter().map(|field| field.name.as_str()).collect();
        format!(
            "{name},{},{},{},{},{},{},{},{}",
            message.id,
            message.name,
            message.crc_extra(),
            message.base_len(),
            message.max_len(),
            offset(message.offset("target_system")),
            offset(message.offset("target_component")),
            order.join(" ")
        )
    };
    dialect.messages.iter().map(row).collect()
}

/// The rows of all files in these directories, in which includes are searched, too.
pub fn table(directories: &[PathBuf]) -> Vec<String> {
    let mut table = vec![HEADER.to_owned()];
    for file in xml_files(directories) {
        let dialect = mavstack_dialect::load(&file, directories).unwrap_or_else(|error| panic!("{error}"));
        table.extend(rows(&file.file_stem().expect("a name").to_string_lossy(), &dialect));
    }
    table
}

/// Asserts that the rows are equal, and shows the first row that differs.
pub fn assert_rows(ours: &[String], theirs: &[String]) {
    for (ours, theirs) in ours.iter().zip(theirs) {
        assert_eq!(ours, theirs);
    }
    assert_eq!(ours.len(), theirs.len(), "number of rows");
}

/// Prints a line that the test harness does not capture.
pub fn say(line: &str) {
    writeln!(std::io::stderr(), "{line}").expect("standard error");
}
