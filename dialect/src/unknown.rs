//! The `invalid` attribute: the value of a field that means "not known".
//!
//! <https://mavlink.io/en/guide/xml_schema.html> defines its notations. A value is a number, NaN, a C limit
//! (`UINT16_MAX`) or an entry of the field's enumeration.
//!
//! | notation | meaning |
//! |---|---|
//! | `v` | the value of a scalar field |
//! | `[v]` | the value of all elements of an array |
//! | `[v:]` | the value of the first element, which applies to the whole array |
//! | `[v,,w,]` | the values of the elements, with gaps |

use crate::{
    Dialect,
    model::{Enum, Field, Scalar},
    parse,
};

/// Returns the values of the field's elements, or a single value for a scalar field; `None` for an element without a
/// value for "not known".
///
/// # Errors
///
/// The attribute is invalid; the text says why.
pub(crate) fn values(dialect: &Dialect, field: &Field) -> Result<Vec<Option<Value>>, String> {
    let count = usize::from(field.array.unwrap_or(1));
    let text = field.invalid.as_str();
    if text.is_empty() {
        return Ok(vec![None; count]);
    }
    let enumeration = dialect.enumeration(&field.enumeration);
    let one = |text: &str| value(text.trim(), field.scalar, enumeration);
    let Some(list) = text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) else {
        return Ok(vec![Some(one(text)?); count]);
    };
    if let Some(first) = list.strip_suffix(':') {
        let mut values = vec![None; count];
        values[0] = Some(one(first)?);
        return Ok(values);
    }
    if !list.contains(',') {
        return Ok(vec![Some(one(list)?); count]);
    }
    let mut values = Vec::new();
    for text in list.split(',') {
        values.push(if text.trim().is_empty() { None } else { Some(one(text)?) });
    }
    // A trailing comma means that the remaining elements have no such value.
    if values.len() > count && values[count..].iter().any(Option::is_some) {
        return Err(format!("invalid: `{text}` has more values than the array has elements, {count}; remove some"));
    }
    values.resize(count, None);
    Ok(values)
}

/// A value that means "not known".
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Value {
    Integer(i128),
    Float(f64),
}

impl Value {
    /// Returns whether all bits are zero, as in a field that was never set.
    pub(crate) fn is_zero(self) -> bool {
        match self {
            Self::Integer(value) => value == 0,
            Self::Float(value) => value.to_bits() == 0,
        }
    }

    /// Returns the Rust literal.
    pub(crate) fn literal(self, scalar: Scalar) -> String {
        let name = if scalar == Scalar::Char { "u8" } else { scalar.rust_name() };
        match self {
            Self::Integer(value) => match scalar.range() {
                Some((_, max)) if value == max => format!("{name}::MAX"),
                Some((min, _)) if value == min && min < 0 => format!("{name}::MIN"),
                _ => value.to_string(),
            },
            Self::Float(value) if value.is_nan() => format!("{name}::NAN"),
            Self::Float(value) => format!("{value:?}"),
        }
    }
}

fn value(text: &str, scalar: Scalar, enumeration: Option<&Enum>) -> Result<Value, String> {
    let entry = || enumeration?.entries.iter().find(|entry| entry.name == text).map(|entry| entry.value);
    let integer = parse::integer(text).or_else(|| limit(text)).or_else(entry);
    let not_one = || format!("invalid: `{text}` is not a value; use a number, NaN or a limit such as UINT16_MAX");
    if matches!(scalar, Scalar::F32 | Scalar::F64) {
        let number = match integer {
            Some(integer) => integer.to_string().parse().map_err(|_| not_one())?,
            None => text.parse::<f64>().map_err(|_| not_one())?,
        };
        // Rounded as on the wire: `UINT64_MAX` has more digits than an `f32`.
        let number = if scalar == Scalar::F32 { f64::from(number as f32) } else { number };
        if number.is_infinite() {
            return Err(not_one());
        }
        return Ok(Value::Float(number));
    }
    let integer = integer.ok_or_else(not_one)?;
    let (min, max) = scalar.range().unwrap_or((0, 255));
    if !(min..=max).contains(&integer) {
        return Err(format!(
            "invalid: {integer} does not fit in {}; use a value from {min} to {max}",
            scalar.wire_name()
        ));
    }
    Ok(Value::Integer(integer))
}

/// Parses a C limit such as `UINT16_MAX`.
fn limit(text: &str) -> Option<i128> {
    let (name, limit) = text.rsplit_once('_')?;
    let scalar = Scalar::ALL.into_iter().find(|scalar| {
        scalar.range().is_some()
            && scalar.wire_name().strip_suffix("_t").is_some_and(|of| of.eq_ignore_ascii_case(name))
    })?;
    let (min, max) = scalar.range()?;
    match limit {
        "MIN" => Some(min),
        "MAX" => Some(max),
        _ => None,
    }
}
