//! The rules of commands: `CommandRule::without_position(31_010, &[ParamRule::range(2, -4.0, 4.0).or_nan()])`.

use proc_macro2::{Delimiter, TokenTree};

use super::source::{self, only_group};
use super::tokens::split;
use crate::{Error, Origin};

/// What a rule says of a command.
pub(super) struct CommandRule {
    pub id: i128,
    pub is_located: bool,
    pub has_altitude: bool,
    pub params: Vec<ParamRule>,
}

/// What a rule says of a parameter. A limit that is not given is open.
pub(super) struct ParamRule {
    pub index: u8,
    pub kind: Kind,
    pub minimum: Option<f64>,
    pub maximum: Option<f64>,
    pub may_be_nan: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Any,
    Floats,
    Integers,
    /// Bits, or some integers: the values of an enumeration.
    Listed,
}

/// A call: its name and its arguments.
struct Call {
    name: String,
    arguments: Vec<Vec<TokenTree>>,
}

/// Reads a rule.
pub(super) fn of(rule: &source::Rule) -> Result<CommandRule, Error> {
    let failed = |problem: &str| rule.origin.error(format!("the rule {}", rule.name), problem);
    let calls = calls(&rule.value);
    let Some((Call { name, arguments }, others)) = calls.split_first() else {
        return Err(failed("write `CommandRule::without_position(…)` or `CommandRule::at_position(…)`"));
    };
    let (is_located, [id, list]) = match (name.as_str(), arguments.as_slice()) {
        ("at_position", [id, list]) => (true, [id, list]),
        ("without_position", [id, list]) => (false, [id, list]),
        _ => return Err(failed("write `CommandRule::without_position(…)` or `CommandRule::at_position(…)`")),
    };
    let id = number(id).and_then(whole).ok_or_else(|| failed("the id of a command must be written as a number"))?;
    let Some(list) = list.get(1..).and_then(|list| only_group(list, Delimiter::Bracket)) else {
        return Err(failed(
            "the rules of the parameters must be written as a list: `&[ParamRule::range(1, 0.0, 9.0)]`",
        ));
    };
    if let Some(call) = others.iter().find(|call| call.name.starts_with("with_")) {
        return Err(failed(&format!(
            "`{}` is a vehicle's, not the definition's: apply it to another constant",
            call.name
        )));
    }
    let params = split(list, ',').iter().map(|tokens| param(tokens, &rule.origin)).collect::<Result<_, _>>()?;
    let has_altitude = !others.iter().any(|call| call.name == "altitude_optional");
    Ok(CommandRule { id, is_located, has_altitude, params })
}

fn param(tokens: &[TokenTree], origin: &Origin) -> Result<ParamRule, Error> {
    let failed = |problem: &str| origin.error("the rule of a parameter", problem);
    let calls = calls(tokens);
    let Some((Call { name, arguments }, others)) = calls.split_first() else {
        return Err(failed("write one of the constructors of `ParamRule`"));
    };
    let value = |at: usize| arguments.get(at).and_then(|argument| number(argument));
    let index =
        value(0).and_then(whole).and_then(|index| u8::try_from(index).ok()).filter(|index| (1..=7).contains(index));
    let index = index.ok_or_else(|| failed("the number of a parameter is 1 to 7, written as a number"))?;
    let (kind, minimum, maximum) = match name.as_str() {
        "any" => (Kind::Any, None, None),
        "range" => (Kind::Floats, value(1), value(2)),
        "at_least" => (Kind::Floats, value(1), None),
        "at_most" => (Kind::Floats, None, value(1)),
        "integers" => (Kind::Integers, value(1), value(2)),
        "bits" | "one_of" => (Kind::Listed, None, None),
        _ => return Err(failed(&format!("`{name}` is none of the constructors of `ParamRule`"))),
    };
    let may_be_nan = others.iter().any(|call| call.name == "or_nan");
    Ok(ParamRule { index, kind, minimum, maximum, may_be_nan })
}

/// Returns the calls in a chain of them: `A::b(c).d()` has `b` and `d`.
fn calls(tokens: &[TokenTree]) -> Vec<Call> {
    let called = tokens.windows(2).filter_map(|pair| match pair {
        [TokenTree::Ident(name), TokenTree::Group(group)] if group.delimiter() == Delimiter::Parenthesis => {
            Some(Call { name: name.to_string(), arguments: split(group.stream(), ',') })
        }
        _ => None,
    });
    called.collect()
}

/// Returns a number as written; `None` if it is another expression, such as `i32::MAX`, which leaves a range open.
fn number(tokens: &[TokenTree]) -> Option<f64> {
    let text: String = tokens.iter().map(TokenTree::to_string).collect();
    super::model::number(&text)
}

fn whole(number: f64) -> Option<i128> {
    (number.fract() == 0.0).then_some(number as i128)
}
