//! What is wrong with a definition, and where.

use std::{
    fmt,
    path::{Path, PathBuf},
};

/// A definition that cannot be used: `file:line: element: what is wrong`, one line, says what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    /// The XML file.
    pub file: PathBuf,
    /// Line of the element, from 1; `None` when the file as a whole is meant.
    pub line: Option<u32>,
    /// The element, for example `field HEARTBEAT.type`.
    pub element: String,
    /// What is wrong with it and what to do.
    pub problem: String,
}

impl Error {
    /// An error about a file as a whole.
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
