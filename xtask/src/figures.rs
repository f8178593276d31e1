//! The figures in `docs/figures.toml`, which `cargo measure figures` shows on the pages.

use crate::system::{Result, root};

/// The file.
pub const FILE: &str = "docs/figures.toml";

/// The text of the file.
pub fn read() -> Result<String> {
    std::fs::read_to_string(root().join(FILE)).map_err(|error| format!("{FILE}: {error}"))
}

/// Keys and values of a section of this text. The values are without quotation marks and without separators of thousands.
pub fn section<'a>(text: &'a str, name: &str) -> Result<Vec<(&'a str, String)>> {
    let body = text.split("\n[").find_map(|section| section.strip_prefix(name)?.strip_prefix("]\n"));
    let body = body.ok_or_else(|| format!("{FILE} has no section `{name}`"))?;
    let figures = body.lines().filter_map(|line| line.split_once(" = "));
    Ok(figures.map(|(key, value)| (key, value.trim_matches('"').replace(',', ""))).collect())
}
