//! Reads tokens one by one, with the position of each for error messages.

use std::path::Path;
use std::sync::Arc;

use proc_macro2::{Delimiter, TokenStream, TokenTree};

use crate::{Error, Origin};

/// A position among tokens.
pub(super) struct Cursor<'a> {
    file: &'a Arc<Path>,
    rest: std::collections::VecDeque<TokenTree>,
    line: u32,
}

impl Iterator for Cursor<'_> {
    type Item = TokenTree;

    fn next(&mut self) -> Option<TokenTree> {
        let token = self.rest.pop_front()?;
        self.line = line(&token);
        Some(token)
    }
}

impl<'a> Cursor<'a> {
    pub fn new(file: &'a Arc<Path>, tokens: TokenStream) -> Self {
        Self { file, rest: tokens.into_iter().collect(), line: 1 }
    }

    /// Returns a cursor over tokens of the same file.
    pub fn of(&self, tokens: Vec<TokenTree>) -> Cursor<'a> {
        Cursor { file: self.file, line: tokens.first().map_or(self.line, line), rest: tokens.into() }
    }

    pub fn peek(&self) -> Option<&TokenTree> {
        self.rest.front()
    }

    /// Returns the name of a constant and the last part of its type, if its declaration is next: `NAME: path::Type =`.
    pub fn declared(&self) -> Option<(String, String)> {
        let mut tokens = self.rest.iter();
        let Some(TokenTree::Ident(name)) = tokens.next() else { return None };
        let mut ty = None;
        is(tokens.next(), ':').then_some(())?;
        loop {
            match tokens.next() {
                Some(TokenTree::Ident(part)) => ty = Some(part.to_string()),
                token if is(token, ':') => {}
                token => return Some((name.to_string(), ty.filter(|_| is(token, '='))?)),
            }
        }
    }

    /// Returns the position of the next token, or of the last one.
    pub fn origin(&self) -> Origin {
        Origin { file: self.file.clone(), line: self.peek().map_or(self.line, line) }
    }

    fn expected(&self, what: &str) -> Error {
        let found = self.peek().map_or("the end".to_owned(), |token| format!("`{token}`"));
        self.origin().error("a declaration", format!("{what} is expected, and there is {found}"))
    }

    /// Takes a punctuation character, if it is next.
    pub fn takes(&mut self, char: char) -> bool {
        let is_next = is(self.peek(), char);
        if is_next {
            self.next();
        }
        is_next
    }

    /// Takes this word, if it is next.
    pub fn takes_ident(&mut self, name: &str) -> bool {
        let is_next = matches!(self.peek(), Some(TokenTree::Ident(ident)) if ident == name);
        if is_next {
            self.next();
        }
        is_next
    }

    pub fn punct(&mut self, char: char) -> Result<(), Error> {
        if self.takes(char) { Ok(()) } else { Err(self.expected(&format!("`{char}`"))) }
    }

    pub fn ident(&mut self, what: &str) -> Result<String, Error> {
        let Some(TokenTree::Ident(ident)) = self.peek() else { return Err(self.expected(what)) };
        let name = ident.to_string();
        self.next();
        Ok(name)
    }

    pub fn literal(&mut self) -> Result<String, Error> {
        let Some(TokenTree::Literal(literal)) = self.peek() else { return Err(self.expected("a number")) };
        let number = literal.to_string();
        self.next();
        Ok(number)
    }

    /// Takes what is in braces.
    pub fn body(&mut self) -> Result<Cursor<'a>, Error> {
        match self.peek() {
            Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace => {
                let body = Cursor::new(self.file, group.stream());
                self.next();
                Ok(body)
            }
            _ => Err(self.expected("`{`")),
        }
    }

    /// Takes attributes, visibility and `struct`. Returns the description, and where the struct is.
    pub fn head(&mut self) -> Result<(String, Origin), Error> {
        let description = self.docs();
        if self.takes_ident("pub")
            && let Some(TokenTree::Group(_)) = self.peek()
        {
            self.next();
        }
        let origin = self.origin();
        if self.takes_ident("struct") { Ok((description, origin)) } else { Err(self.expected("`struct`")) }
    }

    /// Takes attributes. Returns the text of the doc comment in one line.
    pub fn docs(&mut self) -> String {
        let mut words = Vec::new();
        while self.takes('#') {
            let Some(TokenTree::Group(attribute)) = self.next() else { break };
            if let [TokenTree::Ident(name), TokenTree::Punct(_), TokenTree::Literal(doc)] =
                attribute.stream().into_iter().collect::<Vec<_>>().as_slice()
                && name == "doc"
            {
                words.extend(unescaped(&doc.to_string()).split_whitespace().map(str::to_owned));
            }
        }
        words.join(" ")
    }

    /// Takes all tokens before one of these characters; all tokens if there is none.
    pub fn until(&mut self, ends: &[char]) -> Vec<TokenTree> {
        let mut taken = Vec::new();
        while self.peek().is_some_and(|token| !ends.iter().any(|end| is(Some(token), *end))) {
            taken.extend(self.next());
        }
        taken
    }

    pub fn skip_to_group(&mut self) {
        while !matches!(self.peek(), None | Some(TokenTree::Group(_))) {
            self.next();
        }
    }

    /// Skips the rest of an item: to its `;`, or its braces.
    pub fn skip_item(&mut self) {
        for token in self.by_ref() {
            match token {
                TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => return,
                TokenTree::Punct(punct) if punct.as_char() == ';' => return,
                _ => {}
            }
        }
    }
}

fn line(token: &TokenTree) -> u32 {
    u32::try_from(token.span().start().line).unwrap_or(u32::MAX)
}

fn is(token: Option<&TokenTree>, char: char) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == char)
}

/// Splits tokens at each of these characters. An empty part at the end is left out.
pub(super) fn split(tokens: impl IntoIterator<Item = TokenTree>, at: char) -> Vec<Vec<TokenTree>> {
    let mut parts = vec![Vec::new()];
    for token in tokens {
        match parts.last_mut() {
            _ if is(Some(&token), at) => parts.push(Vec::new()),
            Some(part) => part.push(token),
            None => {}
        }
    }
    parts.retain(|part| !part.is_empty());
    parts
}

pub(super) fn text(tokens: TokenStream) -> String {
    tokens.to_string()
}

/// Returns the text of a string literal.
fn unescaped(literal: &str) -> String {
    if let Some(raw) = literal.strip_prefix('r') {
        return raw.trim_matches('#').trim_matches('"').to_owned();
    }
    let mut text = String::new();
    let mut chars = literal.strip_prefix('"').unwrap_or(literal).strip_suffix('"').unwrap_or(literal).chars();
    while let Some(c) = chars.next() {
        match c {
            '\\' => text.extend(match chars.next() {
                Some('n' | 'r' | 't') => Some(' '),
                other => other,
            }),
            c => text.push(c),
        }
    }
    text
}
