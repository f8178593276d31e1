//! `cargo xtask trace`: which rule of behaviour is proven by which test.
//!
//! `docs/conformance.md` lists the rules, one row each; tests name the rules that they prove. The last column of the rows
//! is made of the second, so a rule that lost its tests, or a number that is no rule, does not go unseen.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::system::{Result, root};

const STATEMENT: &str = "docs/conformance.md";
/// Where tests are. Of files under a `src` only those in a folder `tests` count, and of others what follows `#[cfg(test)]`.
const FOLDERS: [&str; 5] = ["tests", "src", "dialect", "examples", ".ci/integration"];
/// What a rule says that is not implemented, in the column of its place.
const LEFT_OUT: &str = "no";

/// One rule and where its row stands.
struct Row<'a> {
    line: usize,
    rule: &'a str,
    asked: &'a str,
    place: &'a str,
}

/// Compares the statement with the tests; with `write` it brings the statement up to date.
pub fn run(write: bool) -> Result {
    let path = root().join(STATEMENT);
    let text = read(&path)?;
    let rows = rows(&text)?;
    let proofs = proofs(&rows)?;

    let mut faults = Vec::new();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    for Row { line, rule, asked, place } in &rows {
        let tests = proofs.get(*rule);
        match (*place == LEFT_OUT, tests) {
            (false, None) => faults.push(format!("{rule} is named by no test")),
            (false, Some(_)) => faults.extend(missing(place).map(|file| format!("{rule}: there is no {file}"))),
            (true, _) => {}
        }
        let tests: Vec<&str> = tests.into_iter().flatten().map(String::as_str).collect();
        let tests = tests.join(", ");
        let space = if tests.is_empty() { "" } else { " " };
        lines[*line] = format!("| {rule} | {asked} | {place} | {tests}{space}|");
    }
    let fresh = lines.join("\n") + "\n";
    if write && fresh != text {
        std::fs::write(&path, &fresh).map_err(|error| format!("{STATEMENT}: {error}"))?;
    } else if fresh != text {
        faults.push(format!("{STATEMENT} is out of date: `cargo xtask trace --write` makes it new"));
    }
    if !faults.is_empty() {
        return Err(faults.join("\n       "));
    }
    let left_out = rows.iter().filter(|row| row.place == LEFT_OUT).count();
    let proven = rows.len() - left_out;
    println!(
        "{proven} rules are implemented, each named by a test; {left_out} rows of {STATEMENT} say that they are not."
    );
    Ok(())
}

/// The rows of all tables that begin with a rule.
fn rows(text: &str) -> Result<Vec<Row<'_>>> {
    let mut rows: Vec<Row<'_>> = Vec::new();
    for (line, row) in text.lines().enumerate() {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let ["", rule, asked, place, _, ""] = cells[..] else { continue };
        if rules_in(rule).is_empty() {
            continue;
        }
        if rows.iter().any(|known| known.rule == rule) {
            return Err(format!("{STATEMENT}:{}: {rule} stands there twice", line + 1));
        }
        rows.push(Row { line, rule, asked, place });
    }
    Ok(rows)
}

/// For each rule the tests that name it.
fn proofs(rows: &[Row<'_>]) -> Result<BTreeMap<String, BTreeSet<String>>> {
    let letters: BTreeSet<&str> = rows.iter().filter_map(|row| row.rule.split('-').next()).collect();
    let mut proofs: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for folder in FOLDERS {
        let mut files = Vec::new();
        collect(&root().join(folder), &mut files)?;
        for file in files {
            let text = read(&file)?;
            let file = file.strip_prefix(root()).unwrap_or(&file);
            let is_in = |folder: &str| file.components().any(|part| part.as_os_str() == folder);
            let all = is_in("tests") || !is_in("src");
            let tests = if all { &text } else { text.split_once("#[cfg(test)]").map_or("", |(_, tests)| tests) };
            let between = ranges_in(tests).into_iter().filter(|rule| rows.iter().any(|row| row.rule == rule));
            for rule in rules_in(tests).into_iter().map(str::to_owned).chain(between) {
                if letters.contains(rule.split('-').next().unwrap_or_default()) {
                    proofs.entry(rule).or_default().insert(name(file));
                }
            }
        }
    }
    let left_out = |rule: &str| {
        let row = rows.iter().find(|row| row.rule == rule);
        row.is_none() && !rows.iter().any(|row| row.rule.contains(" to ") && row.rule.starts_with(&rule[..1]))
    };
    let unknown: Vec<_> = proofs.iter().filter(|(rule, _)| left_out(rule)).collect();
    match unknown.first() {
        Some((rule, files)) => Err(format!("{STATEMENT} has no rule {rule}, which {files:?} name")),
        None => Ok(proofs),
    }
}

/// What a file is called in the statement: its path, without what says nothing.
fn name(file: &Path) -> String {
    let name = file.with_extension("").to_string_lossy().replace('\\', "/");
    let short = [".ci/integration/", "tests/"].iter().find_map(|prefix| name.strip_prefix(prefix));
    short.map_or(name.clone(), str::to_owned)
}

/// The files of `place`, a list, that do not exist.
fn missing(place: &str) -> impl Iterator<Item = &str> {
    let exists = |file: &str| root().join("src").join(file).exists() || root().join(file).exists();
    place.split(", ").filter(move |file| !exists(file))
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> Result {
    let entries = std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    for path in entries.flatten().map(|entry| entry.path()) {
        let is = |extension| path.extension().is_some_and(|found| found == extension);
        if path.is_dir() && !path.ends_with("target") {
            collect(&path, files)?;
        } else if is("rs") || is("py") {
            files.push(path);
        }
    }
    Ok(())
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))
}

/// Every word of `text` that looks like a rule: one capital letter, a hyphen, a number, perhaps a small letter.
fn rules_in(text: &str) -> BTreeSet<&str> {
    let word = |c: char| !(c.is_ascii_alphanumeric() || c == '-' || c == '_');
    text.split(word).filter(|word| is_rule(word)).collect()
}

/// The rules of `text` that "X-1 to X-4" means, but for the two that it names.
fn ranges_in(text: &str) -> Vec<String> {
    let words: Vec<&str> = text.split(|c: char| c.is_whitespace() || ",:;.()".contains(c)).collect();
    let mut rules = Vec::new();
    for three in words.windows(3) {
        let &[first, "to", last] = three else { continue };
        let (Some((letter, from)), Some((other, to))) = (first.split_once('-'), last.split_once('-')) else { continue };
        if let (true, true, Ok(from), Ok(to)) =
            (is_rule(first), letter == other, from.parse::<u16>(), to.parse::<u16>())
        {
            rules.extend((from + 1..to).map(|number| format!("{letter}-{number}")));
        }
    }
    rules
}

fn is_rule(word: &str) -> bool {
    let Some((letter, number)) = word.split_once('-') else { return false };
    let digits = number.trim_end_matches(|c: char| c.is_ascii_lowercase());
    letter.len() == 1
        && letter.chars().all(|c| c.is_ascii_uppercase())
        && !digits.is_empty()
        && digits.chars().all(|c| c.is_ascii_digit())
        && number.len() - digits.len() <= 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_are_told_from_other_words() {
        let found = rules_in("(M-22, S-9b) UTF-8 CRC-32 x-1 A-1a-b T-M9 C-3: not C3, L-");
        assert_eq!(found.into_iter().collect::<Vec<_>>(), ["C-3", "M-22", "S-9b"]);
    }

    #[test]
    fn ranges_are_what_lies_between() {
        assert_eq!(ranges_in("/// C-20 to C-23, M-9 to S-12: x"), ["C-21", "C-22"]);
    }

    #[test]
    fn rows_are_those_with_a_rule_and_none_stands_twice() {
        let text = "| rule | asked | where | tests |\n|---|---|---|---|\n| S-1 | a | b.rs | c |\n| S-2 | d | no | |\n";
        let found = rows(text).expect("good rows");
        assert_eq!(
            found.iter().map(|row| (row.line, row.rule, row.place)).collect::<Vec<_>>(),
            [(2, "S-1", "b.rs"), (3, "S-2", "no")]
        );
        assert!(rows(&text.replace("S-2", "S-1")).is_err());
    }
}
