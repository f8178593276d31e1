//! The guide quotes these tests.

/// Every block of Rust in `docs/testing.md` is in one of these files.
#[test]
fn guide_quotes_what_is_compiled() {
    let guide = include_str!("../../../../docs/testing.md");
    let sources = [include_str!("main.rs"), include_str!("rig.rs")];
    let blocks: Vec<_> = guide.split("```rust,ignore\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
    assert!(blocks.len() > 5);
    for block in blocks {
        assert!(
            sources.iter().any(|source| source.contains(block)),
            "docs/testing.md differs from the tests:\n{block}"
        );
    }
}
