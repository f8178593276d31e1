//! For any XML, the generator returns declarations or an error, and never panics.

use mavstack_dialect::{Options, generate, load};
use proptest::prelude::*;
use std::fs;

const TRICKY: &str = include_str!("generated/tricky.xml");

/// Fragments of definitions that are inserted in wrong places.
const TOKENS: [&str; 24] = [
    "<",
    ">",
    "/>",
    "\"",
    "</field>",
    "<extensions/>",
    "<enum name=\"E\">",
    "<message id=\"1\" name=\"M\">",
    "name=\"",
    "type=\"",
    "uint8_t",
    "[255]",
    "[",
    "char",
    "value=\"",
    "2**63",
    "2**-1",
    "-",
    "0x",
    "_",
    "é",
    "\n",
    "&#0;",
    "<!--",
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    #[test]
    fn mutated_definitions_never_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0_usize..30, 0..TOKENS.len()), 1..6)
    ) {
        let mut text: Vec<char> = TRICKY.chars().collect();
        for (at, removed, token) in edits {
            let at = at.index(text.len());
            let end = text.len().min(at + removed);
            text.splice(at..end, TOKENS[token].chars());
        }
        let dir = tempfile::tempdir().expect("a directory");
        let file = dir.path().join("mutated.xml");
        fs::write(&file, text.into_iter().collect::<String>()).expect("written");
        match load(&file, &[]) {
            Ok(dialect) => prop_assert!(generate(&dialect, &Options::for_file(&file)).is_ok()),
            Err(error) => prop_assert!(error.line.is_some() && !error.problem.is_empty(), "{error}"),
        }
    }
}
