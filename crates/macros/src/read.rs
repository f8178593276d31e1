//! Reads a declaration: the struct with its fields, and the entries of `#[stack(…)]`.

use proc_macro::{Delimiter, Group, Ident, Span, TokenStream, TokenTree};
use std::iter::Peekable;

use crate::Mistake;
use crate::write::tokens;

/// A declaration as it is written.
pub struct Declaration {
    pub name: Ident,
    pub visibility: TokenStream,
    /// The entries of `#[stack(…)]`.
    pub entries: Vec<Row>,
    /// The fields of the struct.
    pub fields: Vec<Row>,
}

/// An entry or a field: a name, and what follows the colon. An entry may be a name alone.
pub struct Row {
    pub name: Ident,
    pub value: TokenStream,
}

impl Row {
    /// Returns where the value is; the name if there is none.
    pub fn place(&self) -> Span {
        self.value.clone().into_iter().next().map_or(self.name.span(), |token| token.span())
    }
}

/// Reads the item that the derive macro is on.
pub fn declaration(input: TokenStream) -> Result<Declaration, Mistake> {
    let mut tokens = input.into_iter().peekable();
    let (mut attributes, visibility) = (attributes(&mut tokens), visibility(&mut tokens));
    match tokens.next() {
        Some(TokenTree::Ident(word)) if word.to_string() == "struct" => {}
        other => {
            let at = other.map_or(Span::call_site(), |token| token.span());
            return Err(Mistake::new(at, "`Stack` is derived for a struct: its fields are the services"));
        }
    }
    let Some(TokenTree::Ident(name)) = tokens.next() else {
        return Err(Mistake::new(Span::call_site(), "the struct needs a name"));
    };
    let fields = match tokens.next() {
        Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace => fields(group.stream())?,
        Some(TokenTree::Punct(end)) if end.as_char() == ';' => Vec::new(),
        other => {
            let at = other.map_or(name.span(), |token| token.span());
            let text = format!("`{name}` must have named fields and no parameters: `struct {name} {{}}`");
            return Err(Mistake::new(at, text));
        }
    };
    let mut entries = Vec::new();
    attributes.retain(|attribute| attribute.name.to_string() == "stack");
    for attribute in attributes {
        for entry in rows(attribute.value, Values::Types, false)? {
            once(&entries, &entry)?;
            entries.push(entry);
        }
    }
    Ok(Declaration { name, visibility, entries, fields })
}

/// Reads the attributes: the name of each, and what is in its parentheses.
fn attributes(tokens: &mut Peekable<impl Iterator<Item = TokenTree>>) -> Vec<Row> {
    let mut attributes = Vec::new();
    while matches!(tokens.peek(), Some(TokenTree::Punct(punct)) if punct.as_char() == '#') {
        tokens.next();
        let Some(TokenTree::Group(group)) = tokens.next() else { break };
        let mut inner = group.stream().into_iter();
        if let (Some(TokenTree::Ident(name)), Some(TokenTree::Group(value))) = (inner.next(), inner.next()) {
            attributes.push(Row { name, value: value.stream() });
        }
    }
    attributes
}

/// Reads `pub`, `pub(crate)` and so on.
fn visibility(tokens: &mut Peekable<impl Iterator<Item = TokenTree>>) -> TokenStream {
    let mut visibility = TokenStream::new();
    if matches!(tokens.peek(), Some(TokenTree::Ident(word)) if word.to_string() == "pub") {
        visibility.extend(tokens.next());
        if matches!(tokens.peek(), Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Parenthesis) {
            visibility.extend(tokens.next());
        }
    }
    visibility
}

/// Reads the fields of the struct, without attributes and visibility.
fn fields(input: TokenStream) -> Result<Vec<Row>, Mistake> {
    let mut plain = TokenStream::new();
    let mut tokens = input.into_iter().peekable();
    loop {
        attributes(&mut tokens);
        visibility(&mut tokens);
        let mut end = EndOfRow::of(Values::Types);
        let mut ended = true;
        for token in tokens.by_ref() {
            let is_comma = end.is(&token);
            plain.extend([token]);
            if is_comma {
                ended = false;
                break;
            }
        }
        if ended {
            return rows(plain, Values::Types, true);
        }
    }
}

/// What the values of rows are.
#[derive(Clone, Copy, PartialEq)]
enum Values {
    /// Types and numbers: a value ends at a comma outside of `<>`.
    Types,
    /// Expressions: `<` is an operator.
    Expressions,
}

/// Reads `name: value, name: value`. `needs_values`: a name alone is a mistake.
fn rows(input: TokenStream, values: Values, needs_values: bool) -> Result<Vec<Row>, Mistake> {
    let mut rows = Vec::new();
    let mut tokens = input.into_iter().peekable();
    while let Some(token) = tokens.next() {
        let at = token.span();
        let TokenTree::Ident(name) = ungrouped(token) else {
            return Err(Mistake::new(at, "an entry begins with its name"));
        };
        let mut value = TokenStream::new();
        match tokens.next() {
            Some(TokenTree::Punct(punct)) if punct.as_char() == ':' => {
                let mut end = EndOfRow::of(values);
                for token in tokens.by_ref() {
                    if end.is(&token) {
                        break;
                    }
                    value.extend([token]);
                }
                if value.is_empty() {
                    return Err(Mistake::new(name.span(), format!("`{name}:` needs a value")));
                }
                if end.depth != 0 {
                    let text = format!("a `<` of `{name}` has no `>`: write an expression in braces, `{{ 1 << 3 }}`");
                    return Err(Mistake::new(name.span(), text));
                }
            }
            None if !needs_values => {}
            Some(TokenTree::Punct(punct)) if punct.as_char() == ',' && !needs_values => {}
            other => {
                let at = other.map_or(name.span(), |token| token.span());
                return Err(Mistake::new(at, format!("a `:` or a `,` is missing after `{name}`")));
            }
        }
        let row = Row { name, value };
        once(&rows, &row)?;
        rows.push(row);
    }
    Ok(rows)
}

/// Returns the token in a group without delimiters, which macros make.
fn ungrouped(token: TokenTree) -> TokenTree {
    match &token {
        TokenTree::Group(group) if group.delimiter() == Delimiter::None => {
            group.stream().into_iter().next().unwrap_or(token)
        }
        _ => token,
    }
}

/// Finds the comma at the end of a row.
struct EndOfRow {
    values: Values,
    /// How deep in `<>` the row is.
    depth: i32,
    /// The last token was a `-`, which makes a `>` an arrow.
    is_arrow: bool,
}

impl EndOfRow {
    fn of(values: Values) -> Self {
        Self { values, depth: 0, is_arrow: false }
    }

    /// Whether the next token of the row is its end.
    fn is(&mut self, token: &TokenTree) -> bool {
        let is_arrow = std::mem::replace(&mut self.is_arrow, false);
        let TokenTree::Punct(punct) = token else { return false };
        match punct.as_char() {
            '-' => self.is_arrow = true,
            '<' if self.values == Values::Types => self.depth += 1,
            '>' if self.values == Values::Types && !is_arrow => self.depth -= 1,
            ',' => return self.depth == 0,
            _ => {}
        }
        false
    }
}

/// Refuses a row with the name of an earlier one.
fn once(rows: &[Row], new: &Row) -> Result<(), Mistake> {
    let name = new.name.to_string();
    match rows.iter().any(|row| row.name.to_string() == name) {
        true => Err(Mistake::new(new.name.span(), format!("`{name}` is given twice: remove one of the two"))),
        false => Ok(()),
    }
}

/// Returns the rows in the braces of an entry such as `plans: { mission: 100 }`. All must be in the example, each in the same form.
pub fn sizes(row: &Row, example: &str) -> Result<Vec<Row>, Mistake> {
    let wrong = |at| Mistake::new(at, format!("write `{example}`"));
    let given = in_braces(row).ok_or_else(|| wrong(row.place()))??;
    let example_row = rows(tokens(example), Values::Types, true)?;
    let known = example_row.first().and_then(in_braces).ok_or_else(|| wrong(row.place()))??;
    for size in &given {
        let (entry, name) = (&row.name, size.name.to_string());
        match known.iter().find(|known| known.name.to_string() == name) {
            Some(known) if known.value.is_empty() == size.value.is_empty() => {}
            Some(_) => return Err(wrong(size.name.span())),
            None => {
                return Err(Mistake::new(size.name.span(), format!("`{entry}` has no `{name}`: write `{example}`")));
            }
        }
    }
    Ok(given)
}

/// Reads the rows in the braces of a value; `None` if it is something else.
fn in_braces(row: &Row) -> Option<Result<Vec<Row>, Mistake>> {
    let mut tokens = row.value.clone().into_iter();
    match (tokens.next(), tokens.next()) {
        (Some(TokenTree::Group(group)), None) if group.delimiter() == Delimiter::Brace => {
            Some(rows(group.stream(), Values::Expressions, false))
        }
        _ => None,
    }
}

/// Returns the same tokens, which are reported at `place`.
pub fn placed(tokens: TokenStream, place: Span) -> TokenStream {
    let placed_token = |mut token: TokenTree| {
        if let TokenTree::Group(group) = &token {
            let mut inner = Group::new(group.delimiter(), placed(group.stream(), place));
            inner.set_span(group.span().located_at(place));
            return TokenTree::Group(inner);
        }
        token.set_span(token.span().located_at(place));
        token
    };
    tokens.into_iter().map(placed_token).collect()
}
