//! `#[derive(Stack)]` of [mavstack](https://docs.rs/mavstack), which re-exports it: the declaration of a vehicle's stack.
//!
//! ```text
//!   #[stack(entry: value, …)] ─▶ read ─▶ entries ─▶ parts ──▶ impl Firmware, impl Declares
//!   struct { name: Type, … }  ─▶ read ─▶ fields ───────────▶ the states on a link, impl ServiceList
//! ```
//!
//! It has no dependencies, so it takes less than a second to build. What is written for an entry or a field has its place, so the
//! compiler reports a mistake there, and `cargo check` shows it.

mod entries;
mod read;
mod write;

use proc_macro::{Delimiter, Group, Ident, Literal, Punct, Spacing, Span, TokenStream, TokenTree};

/// What is wrong with a declaration, and where.
struct Mistake {
    at: Span,
    text: String,
}

impl Mistake {
    fn new(at: Span, text: impl Into<String>) -> Self {
        Self { at, text: text.into() }
    }

    /// Returns a call of `compile_error!` that is reported at the mistake.
    fn report(self) -> TokenStream {
        let mut text = Literal::string(&self.text);
        text.set_span(self.at);
        let mut body = Group::new(Delimiter::Brace, TokenTree::Literal(text).into());
        body.set_span(self.at);
        let punct = |char, spacing| {
            let mut punct = Punct::new(char, spacing);
            punct.set_span(self.at);
            TokenTree::Punct(punct)
        };
        let name = |name| TokenTree::Ident(Ident::new(name, self.at));
        [
            punct(':', Spacing::Joint),
            punct(':', Spacing::Alone),
            name("core"),
            punct(':', Spacing::Joint),
            punct(':', Spacing::Alone),
            name("compile_error"),
            punct('!', Spacing::Alone),
            TokenTree::Group(body),
        ]
        .into_iter()
        .collect()
    }
}

/// Declares the stack of a vehicle: see the derive macro `Stack` of `mavstack`.
#[proc_macro_derive(Stack, attributes(stack))]
pub fn derive_stack(input: TokenStream) -> TokenStream {
    read::declaration(input).and_then(|declaration| write::declaration(&declaration)).unwrap_or_else(Mistake::report)
}
