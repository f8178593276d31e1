//! `cargo xtask trace`: holds the statement of conformance to the code and its tests.
//!
//! `docs/conformance.md` has a row for each rule of behaviour. Tests cite the rules that they prove, and comments cite the rules
//! that they follow. This task prints the files and the tests of each rule. It fails when no file or no test cites an implemented
//! rule, and when something cites a rule without a row.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::system::{Result, root};

const STATEMENT: &str = "docs/conformance.md";
/// Where tests are: see [`tests_of`].
const TESTS: [&str; 6] = ["tests", "src", "crates", "dialect", "examples", ".ci/integration"];
/// Where rules are cited: see [`prose_of`].
const CITED_IN: [&str; 16] = [
    "src",
    "tests",
    "examples",
    "fuzz",
    "benches",
    "xtask",
    "dialect",
    "docs",
    "crates",
    ".ci/integration",
    ".ci/run",
    ".github/workflows",
    "Cargo.toml",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "README.md",
];
/// Capital letters that begin the name of a standard or an algorithm, such as UTF-8 or RS-485, and no id of a rule.
const NAMES: [&str; 10] = ["AES", "CRC", "DO", "FNV", "GPL", "IEEE", "RFC", "RS", "SHA", "UTF"];
/// Where rules are implemented: see [`code_of`].
const CODE: [&str; 4] = ["src", "crates", "dialect", "examples"];
/// How the requirement of a rule begins that is not implemented.
const LEFT_OUT: &str = "Not implemented: ";

/// A rule.
struct Row<'a> {
    rule: &'a str,
    requirement: &'a str,
}

impl Row<'_> {
    fn is_left_out(&self) -> bool {
        self.requirement.starts_with(LEFT_OUT)
    }
}

/// The files that cite each rule.
type Citations = BTreeMap<String, BTreeSet<String>>;

/// What to print of each rule.
#[derive(Clone, Copy)]
pub struct Printed {
    /// The files whose comments cite it.
    pub places: bool,
    /// The tests that cite it.
    pub tests: bool,
}

/// Compares the statement with the code and the tests. First prints what is asked for.
pub fn run(printed: Printed) -> Result {
    let text = read(&root().join(STATEMENT))?;
    let rows = rows(&text)?;
    let known = known(&rows);
    let places = citations(&known, &CODE, &["rs"], code_of)?;
    let proofs = citations(&known, &TESTS, &["rs", "py"], |file, text| tests_of(file, text).to_owned())?;

    let mut faults = Vec::new();
    for row in &rows {
        let (rule, files, tests) = (row.rule, places.get(row.rule), proofs.get(row.rule));
        for (what, found) in [("in", files.filter(|_| printed.places)), ("tests", tests.filter(|_| printed.tests))] {
            if let Some(found) = found {
                println!("{rule} {what}: {}", found.iter().map(String::as_str).collect::<Vec<_>>().join(", "));
            }
        }
        if !row.is_left_out() && tests.is_none() {
            faults.push(format!("{rule}: no test cites it"));
        }
        if !row.is_left_out() && files.is_none() {
            faults.push(format!("{rule}: no comment in the code cites it: cite it where it is implemented"));
        }
    }
    faults.extend(unknown_citations(&known)?);
    if !faults.is_empty() {
        return Err(faults.join("\n       "));
    }
    let left_out = rows.iter().filter(|row| row.is_left_out()).count();
    let proven = rows.len() - left_out;
    println!(
        "{proven} rules are implemented, each cited by code and by a test; {left_out} rows of {STATEMENT} are not."
    );
    Ok(())
}

/// Returns the rows of all tables whose first column is a rule.
fn rows(text: &str) -> Result<Vec<Row<'_>>> {
    let mut rows: Vec<Row<'_>> = Vec::new();
    for (line, row) in text.lines().enumerate() {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let ["", rule, requirement, rest @ ..] = &cells[..] else { continue };
        if rules_in(rule).is_empty() {
            continue;
        }
        if *rest != [""] {
            return Err(format!("{STATEMENT}:{}: {rule}: a row is a rule and its requirement", line + 1));
        }
        if rows.iter().any(|known| known.rule == *rule) {
            return Err(format!("{STATEMENT}:{}: {rule} has a row already: remove one", line + 1));
        }
        rows.push(Row { rule, requirement });
    }
    Ok(rows)
}

/// Returns the ids of all rules that have a row.
fn known(rows: &[Row<'_>]) -> BTreeSet<String> {
    let rules = rows.iter().map(|row| row.rule);
    rules.flat_map(|rule| rules_in(rule).into_iter().map(str::to_owned).chain(ranges_in(rule))).collect()
}

/// Returns the files at `places` that cite each rule, in the part of them that `part` returns.
fn citations(
    known: &BTreeSet<String>,
    places: &[&str],
    extensions: &[&str],
    part: impl Fn(&Path, &str) -> String,
) -> Result<Citations> {
    let mut found = Citations::new();
    for file in files(places, extensions)? {
        let text = part(&file, &read(&root().join(&file))?);
        let cited = rules_in(&text).into_iter().map(str::to_owned).chain(ranges_in(&text));
        for rule in cited.filter(|rule| known.contains(rule)) {
            found.entry(rule).or_default().insert(name(&file));
        }
    }
    Ok(found)
}

/// Returns a fault for each citation of a rule that has no row.
fn unknown_citations(known: &BTreeSet<String>) -> Result<Vec<String>> {
    let mut faults = Vec::new();
    for file in files(&CITED_IN, &["rs", "py", "md", "toml", "yml"])? {
        let text = read(&root().join(&file))?;
        for (line, prose) in prose_of(&file, &text) {
            let unknown = words(prose).filter(|word| is_citation(word) && !known.contains(*word));
            faults.extend(unknown.map(|word| {
                let place = file.display();
                format!("{place}:{line}: {word} has no row in {STATEMENT}: cite a rule that has one, or add the row")
            }));
        }
    }
    Ok(faults)
}

/// Returns the part of a source file that is tests. Outside a folder `src` that is all of it. In a folder `src` it is a file
/// or folder called `tests`, or the module `tests` at the end of another file.
fn tests_of<'a>(file: &Path, text: &'a str) -> &'a str {
    if is_test(file) {
        return text;
    }
    text.split_once("\nmod tests {").map_or("", |(_, tests)| tests)
}

/// Returns the comments of a source file outside its tests, as one text: a range may be broken over two lines.
fn code_of(file: &Path, text: &str) -> String {
    if is_test(file) {
        return String::new();
    }
    let code = text.split_once("\nmod tests {").map_or(text, |(code, _)| code);
    let comments = code.lines().filter_map(comment).map(|line| line.trim_start_matches(['/', '!', ' ']));
    comments.collect::<Vec<_>>().join(" ")
}

/// Whether all of a source file is tests.
fn is_test(file: &Path) -> bool {
    let has = |name: &str| file.components().any(|part| part.as_os_str() == name);
    has("tests") || has("tests.rs") || !has("src")
}

/// Returns the lines of a file, counted from 1, in which a rule may be cited: the comments of a program or of a configuration
/// file, and all of a page or a Python script, which has docstrings. Generated files cite no rules.
fn prose_of<'a>(file: &Path, text: &'a str) -> Vec<(usize, &'a str)> {
    let extension = file.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    let prose = |line: &'a str| match extension {
        "md" | "py" => Some(line),
        "rs" => comment(line),
        _ => line.split_once('#').map(|(_, comment)| comment),
    };
    let text = if text.starts_with("// @generated") { "" } else { text };
    (1..).zip(text.lines()).filter_map(|(number, line)| Some((number, prose(line)?))).collect()
}

/// Returns the comment at the end of a line of Rust. The two slashes of a URL begin none.
fn comment(line: &str) -> Option<&str> {
    let begins = |at: &usize| !line[..*at].ends_with(':');
    let at = line.match_indices("//").map(|(at, _)| at).find(begins)?;
    line.get(at..)
}

/// Returns what a file of tests is called: its path without the extension and the folder of all tests.
fn name(file: &Path) -> String {
    let name = file.with_extension("").to_string_lossy().replace('\\', "/");
    let short = [".ci/integration/", "tests/"].iter().find_map(|prefix| name.strip_prefix(prefix));
    short.map_or(name.clone(), str::to_owned)
}

/// Returns the files at `places` and below with one of these extensions, relative to the repository. A file among `places` is
/// taken whatever its extension is.
fn files(places: &[&str], extensions: &[&str]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for place in places {
        let path = root().join(place);
        if path.is_dir() {
            collect(&path, extensions, &mut files)?;
        } else {
            files.push(path);
        }
    }
    Ok(files.into_iter().map(|file| file.strip_prefix(root()).map_or(file.clone(), Path::to_owned)).collect())
}

fn collect(folder: &Path, extensions: &[&str], files: &mut Vec<PathBuf>) -> Result {
    let entries = std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    for path in entries.flatten().map(|entry| entry.path()) {
        let is_hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if path.is_dir() {
            if !is_hidden && !path.ends_with("target") {
                collect(&path, extensions, files)?;
            }
        } else if path.extension().is_some_and(|found| extensions.iter().any(|extension| found == *extension)) {
            files.push(path);
        }
    }
    Ok(())
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))
}

/// Splits a text into words, which may contain hyphens and underscores.
fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '-' || c == '_'))
}

/// Returns every word of `text` that has the form of a rule's id.
fn rules_in(text: &str) -> BTreeSet<&str> {
    words(text).filter(|word| is_rule(word)).collect()
}

/// Returns the rules between the first and the last one of each "M-1 to M-4" in `text`.
fn ranges_in(text: &str) -> Vec<String> {
    let words: Vec<&str> = text.split(|c: char| c.is_whitespace() || ",:;.()".contains(c)).collect();
    let mut rules = Vec::new();
    for three in words.windows(3) {
        let &[first, "to", last] = three else { continue };
        let (Some((letters, from)), Some((other, to))) = (first.split_once('-'), last.split_once('-')) else {
            continue;
        };
        if let (true, true, Ok(from), Ok(to)) =
            (is_rule(first), letters == other, from.parse::<u16>(), to.parse::<u16>())
        {
            rules.extend((from + 1..to).map(|number| format!("{letters}-{number}")));
        }
    }
    rules
}

/// Whether a word has the form of a rule's id: one to five capital letters, a hyphen, one to three digits, and perhaps a small
/// letter.
fn is_rule(word: &str) -> bool {
    let Some((letters, number)) = word.split_once('-') else { return false };
    let digits = number.strip_suffix(|c: char| c.is_ascii_lowercase()).unwrap_or(number);
    (1..=5).contains(&letters.len())
        && letters.chars().all(|c| c.is_ascii_uppercase())
        && (1..=3).contains(&digits.len())
        && digits.chars().all(|c| c.is_ascii_digit())
}

/// Whether a word in prose cites a rule: it has the form of an id, perhaps with one more capital letter before the digits, and
/// is not the name of a standard.
fn is_citation(word: &str) -> bool {
    let Some((letters, number)) = word.split_once('-') else { return false };
    let number = number.strip_prefix(|c: char| c.is_ascii_uppercase()).unwrap_or(number);
    is_rule(&format!("{letters}-{number}")) && !NAMES.contains(&letters)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn citations(text: &str) -> Vec<&str> {
        words(text).filter(|word| is_citation(word)).collect()
    }

    #[test]
    fn rules_differ_from_other_words() {
        let found = rules_in("(M-22, S-9b) SEC-11; x-1 A-1a-b T-M9 C-3: not C3, L- D-1234 ABCDEF-1 M-1ab");
        assert_eq!(found.into_iter().collect::<Vec<_>>(), ["C-3", "M-22", "S-9b", "SEC-11"]);
    }

    #[test]
    fn citations_of_every_letter_are_found() {
        let text = "S-1, (T-G5) and GOAL-4: Z-9 (S-9b), M-22/M-45; X-1 to X-4.";
        assert_eq!(citations(text), ["S-1", "T-G5", "GOAL-4", "Z-9", "S-9b", "M-22", "M-45", "X-1", "X-4"]);
    }

    #[test]
    fn names_are_no_citations() {
        for text in [
            "UTF-8, CRC-16/MCRF4XX, CRC-32s, SHA-256, AES-128, RS-485, DO-178C",
            "ISO-8859-1, ISO-8601, IEEE-754, RFC-793, RFC-1071, CVE-2020-10282, GPL-3.0-only",
            "Cortex-M4, ARMv7-M, STM32F4-DISCO, thumbv7em, PX4#27132, 8-N-1, v1-only, SEC-n, M-n, 0-15",
            "MAV_CMD_NAV_WAYPOINT, MAV_CMD-1, HIGH_LATENCY2, PARAM_VALUE-3, BSD-3-Clause, S-, -1, --1, I2C-1",
        ] {
            assert_eq!(citations(text), [""; 0], "{text}");
        }
    }

    #[test]
    fn ranges_are_the_rules_between() {
        assert_eq!(ranges_in("C-20 to C-23, M-9 to S-12: SEC-5 to SEC-7."), ["C-21", "C-22", "SEC-6"]);
    }

    #[test]
    fn rows_are_those_with_a_rule_and_none_is_repeated() {
        let text = "| rule | requirement |\n|---|---|\n| S-1 | a |\n| F-1 to F-3 | Not implemented: d |\n";
        let found = rows(text).expect("good rows");
        assert_eq!(
            found.iter().map(|row| (row.rule, row.is_left_out())).collect::<Vec<_>>(),
            [("S-1", false), ("F-1 to F-3", true)]
        );
        assert_eq!(known(&found).into_iter().collect::<Vec<_>>(), ["F-1", "F-2", "F-3", "S-1"]);
        assert!(rows(&text.replace("F-1 to F-3", "S-1")).is_err());
        assert!(rows(&text.replace("| a |", "| a | b.rs |")).is_err());
    }

    #[test]
    fn rules_are_implemented_where_a_comment_cites_them() {
        let text =
            "//! Rules C-1, C-4 to\n//! C-6.\nlet a = \"C-8\"; // C-9\nfn C_10() {}\nmod tests {\n    // C-11\n}\n";
        let code = code_of(Path::new("src/a.rs"), text);
        assert_eq!(rules_in(&code).into_iter().collect::<Vec<_>>(), ["C-1", "C-4", "C-6", "C-9"]);
        assert_eq!(ranges_in(&code), ["C-5"]);
        assert_eq!(code_of(Path::new("src/tests/a.rs"), text), "");
    }

    #[test]
    fn tests_are_told_from_the_code_beside_them() {
        let code = "/// S-1\n#[cfg(test)]\nmod tests;\n/// S-2\n";
        let both = "/// S-1\n#[cfg(test)]\nmod tests {\n/// S-2\n}\n";
        let rules = |file: &str, text| rules_in(tests_of(Path::new(file), text)).into_iter().collect::<Vec<_>>();
        assert_eq!(rules("src/a/mod.rs", code), [""; 0]);
        assert_eq!(rules("src/a/mod.rs", both), ["S-2"]);
        for file in ["src/a/tests.rs", "src/a/tests/b.rs", "tests/b.rs", ".ci/integration/b.py", "dialect/tests/b.rs"] {
            assert_eq!(rules(file, code), ["S-1", "S-2"], "{file}");
        }
    }

    #[test]
    fn only_comments_and_pages_cite() {
        let cited = |file: &str, text| {
            let lines = prose_of(Path::new(file), text);
            lines
                .into_iter()
                .flat_map(|(line, prose)| citations(prose).into_iter().map(move |word| (line, word)))
                .collect()
        };
        let found: Vec<(usize, &str)> =
            cited("src/a.rs", "let a = \"S-1\";\nlet b = \"https://S-2\"; // S-3\n/// S-4\n");
        assert_eq!(found, [(2, "S-3"), (3, "S-4")]);
        let found: Vec<(usize, &str)> = cited("Cargo.toml", "a = \"S-1\"\nb = 1 # S-2\n");
        assert_eq!(found, [(2, "S-2")]);
        let found: Vec<(usize, &str)> = cited("docs/a.md", "S-1\n\nS-2\n");
        assert_eq!(found, [(1, "S-1"), (3, "S-2")]);
        let found: Vec<(usize, &str)> = cited("src/common.rs", "// @generated by a tool\n/// S-1\n");
        assert_eq!(found, []);
    }
}
