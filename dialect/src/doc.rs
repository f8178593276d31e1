//! Doc comments, escaped for rustdoc and wrapped.

use crate::model::{Lifecycle, Replacement};

/// Maximum length of a line.
const WIDTH: usize = 120;

/// A paragraph, as a list of words.
#[derive(Default)]
pub(crate) struct Doc(Vec<String>);

impl Doc {
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds Markdown text.
    pub fn text(&mut self, markdown: &str) {
        self.0.extend(markdown.split_whitespace().map(str::to_owned));
    }

    /// Adds Markdown text that must not be wrapped.
    pub fn phrase(&mut self, markdown: String) {
        self.0.push(markdown);
    }

    /// Adds plain text.
    pub fn prose(&mut self, plain: &str) {
        for word in plain.split_whitespace() {
            let end = word.trim_end_matches(['.', ',', ';', ':', ')', '"', '\'']);
            if let (true, Some(rest)) =
                (end.starts_with("http://") || end.starts_with("https://"), word.get(end.len()..))
            {
                self.0.push(format!("<{end}>{}", escape(rest)));
            } else {
                self.0.push(escape(word));
            }
        }
    }

    /// Adds a sentence for an element that is deprecated, superseded or in progress.
    pub fn lifecycle(&mut self, lifecycle: Option<&Lifecycle>) {
        let replaced = |what: &str, Replacement { since, replaced_by }: &Replacement| {
            let by = if replaced_by.is_empty() { String::new() } else { format!(": {}", escape(replaced_by)) };
            format!("{what} since {since}{by}.")
        };
        match lifecycle {
            None => {}
            Some(Lifecycle::WorkInProgress) => self.text("Work in progress."),
            Some(Lifecycle::Deprecated(replacement)) => self.text(&replaced("Deprecated", replacement)),
            Some(Lifecycle::Superseded(replacement)) => self.text(&replaced("Superseded", replacement)),
        }
    }

    /// Writes the paragraph with `start` before each line; nothing if it is empty.
    pub fn write(&self, out: &mut String, start: &str) {
        let mut width = 0;
        for word in &self.0 {
            let length = word.chars().count();
            if width > 0 && width + 1 + length <= WIDTH {
                out.push(' ');
                width += 1 + length;
            } else {
                if width > 0 {
                    out.push('\n');
                }
                out.push_str(start);
                width = start.len() + length;
            }
            out.push_str(word);
        }
        if width > 0 {
            out.push('\n');
        }
    }
}

/// Escapes plain text for Markdown.
pub(crate) fn escape(plain: &str) -> String {
    let mut escaped = String::new();
    for (at, c) in plain.char_indices() {
        // An underscore inside a word has no meaning in Markdown; `#`, `+` and `-` have one at the start of a line.
        if "\\`*[]<>|~".contains(c) || (at == 0 && "#+-_=".contains(c)) || (c == '_' && at + 1 == plain.len()) {
            escaped.push('\\');
        }
        escaped.push(c);
    }
    escaped
}

/// Formats a range.
pub(crate) fn range(minimum: Option<f64>, maximum: Option<f64>) -> Option<String> {
    match (minimum, maximum) {
        (Some(min), Some(max)) => Some(format!("{min} to {max}")),
        (Some(min), None) => Some(format!("≥ {min}")),
        (None, Some(max)) => Some(format!("≤ {max}")),
        (None, None) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prose_is_escaped_and_wrapped() {
        let mut doc = Doc::new();
        doc.prose(&format!("See [x] and <b>, https://mavlink.io/en/. {}", "word ".repeat(40)));
        let mut out = String::new();
        doc.write(&mut out, "    /// ");
        assert!(out.starts_with("    /// See \\[x\\] and \\<b\\>, <https://mavlink.io/en/>. word"), "{out}");
        assert!(out.lines().count() == 3 && out.lines().all(|line| line.chars().count() <= WIDTH), "{out}");
    }

    #[test]
    fn an_empty_paragraph_is_not_written() {
        let mut out = String::new();
        Doc::new().write(&mut out, "/// ");
        assert_eq!(out, "");
    }
}
