//! The error of a definition, with its position.

use std::{
    fmt,
    path::{Path, PathBuf},
};

/// Why a definition cannot be used. Displayed as a line: `file:line: element: what is wrong; what to do`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    /// The XML file.
    pub file: PathBuf,
    /// Line of the element, from 1; `None` for the whole file.
    pub line: Option<u32>,
    /// The element, for example `field HEARTBEAT.type`.
    pub element: String,
    /// What is wrong, and what to do.
    pub problem: String,
}

impl Error {
    /// Returns an error about a whole file.
    pub(crate) fn whole(file: &Path, element: &str, problem: impl Into<String>) -> Self {
        Self { file: file.into(), line: None, element: element.into(), problem: problem.into() }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:", self.file.display())?;
        if let Some(line) = self.line {
            write!(f, "{line}:")?;
        }
        write!(f, " {}: {}", self.element, self.problem)
    }
}

impl std::error::Error for Error {}
