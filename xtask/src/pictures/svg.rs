//! Pictures as SVG: elements, scales, and the style that all pictures share.

use std::fmt::Write as _;

/// Two numbers: a place in the picture or on the map, or a range.
pub type Point = (f64, f64);

/// How wide a picture is, in pixels.
pub const WIDTH: f64 = 820.0;

/// What all pictures share: colours for light and dark pages, the font, the thin lines.
const STYLE: &str = "\
text{font:12px system-ui,-apple-system,'Segoe UI',Roboto,Helvetica,Arial,sans-serif;fill:#1f2933}
.s{font-size:11px}.h{font-size:13px;font-weight:600}.q{fill:#5f6b7a}.m{text-anchor:middle}.e{text-anchor:end}
.paper{fill:#fff;stroke:#d8dee6}.plot{fill:#f7f9fb}.grid{stroke:#e4e9ef;fill:none}.axis{stroke:#b3bdc9;fill:none}
.plan{stroke:#8d98a7;stroke-dasharray:2 4;fill:none}.disc{fill:#fff;stroke:#5f6b7a}
.in{fill:#bc4c00;fill-opacity:.05;stroke:#bc4c00;stroke-width:1.5;stroke-dasharray:7 4}
.out{fill:#bc4c00;fill-opacity:.14;stroke:#bc4c00}.warn{fill:#bc4c00}.cross{stroke:#bc4c00;stroke-width:1.5;fill:none}
.want{stroke:#bc4c00;stroke-dasharray:2 4;fill:none}.thin{stroke:#bc4c00;stroke-width:.75;fill:none}
.a,.b,.c{fill:none;stroke-width:2.5;stroke-linejoin:round;stroke-linecap:round}
.a{stroke:#0969da}.b{stroke:#1a7f37}.c{stroke:#8250df}.ta{fill:#0969da}.tb{fill:#1a7f37}.tc{fill:#8250df}
.ours{fill:#0969da}.theirs{fill:#98a4b3}.pale{fill-opacity:.35}
@media (prefers-color-scheme:dark){text{fill:#e6edf3}.q{fill:#9aa7b5}.paper{fill:#0f141a;stroke:#2b3440}.plot{fill:#151b23}
.grid{stroke:#232c37}.axis{stroke:#4a5665}.plan{stroke:#768392}.disc{fill:#0f141a;stroke:#9aa7b5}
.in,.out{stroke:#f0883e;fill:#f0883e}.warn{fill:#f0883e}.cross,.want,.thin{stroke:#f0883e}
.a{stroke:#58a6ff}.b{stroke:#3fb950}.c{stroke:#bc8cff}.ta{fill:#58a6ff}.tb{fill:#3fb950}.tc{fill:#bc8cff}
.ours{fill:#58a6ff}.theirs{fill:#6b7785}}
";

/// A picture in the making; places are in pixels, from the left and from above.
pub struct Svg(String);

impl Svg {
    /// An empty picture. The title is what screen readers say.
    pub fn new(width: f64, height: f64, title: &str) -> Self {
        let (w, h) = (short(width), short(height));
        Self(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" role=\"img\">\n\
             <!-- Drawn by `cargo xtask pictures`. -->\n<title>{title}</title>\n<style>\n{STYLE}</style>\n\
             <rect class=\"paper\" x=\".5\" y=\".5\" width=\"{}\" height=\"{}\" rx=\"8\"/>\n",
            short(width - 1.0),
            short(height - 1.0),
        ))
    }

    /// The whole file.
    pub fn end(mut self) -> String {
        self.0 += "</svg>\n";
        self.0
    }

    fn element(&mut self, name: &str, class: &str, attributes: &[(&str, f64)]) {
        let _ = write!(self.0, "<{name} class=\"{class}\"");
        for (attribute, value) in attributes {
            let _ = write!(self.0, " {attribute}=\"{}\"", short(*value));
        }
        self.0 += "/>\n";
    }

    /// A rectangle by its upper left corner and its size.
    pub fn rect(&mut self, class: &str, (x, y): Point, (width, height): Point) {
        self.element("rect", class, &[("x", x), ("y", y), ("width", width), ("height", height)]);
    }

    /// A circle by its centre.
    pub fn circle(&mut self, class: &str, (x, y): Point, radius: f64) {
        self.element("circle", class, &[("cx", x), ("cy", y), ("r", radius)]);
    }

    /// Lines from place to place; back to the first with `closes`.
    pub fn lines(&mut self, class: &str, places: impl IntoIterator<Item = Point>, closes: bool) {
        let mut path = String::new();
        let mut last = String::new();
        for (x, y) in places {
            let place = format!("{} {}", short(x), short(y));
            if place != last {
                let _ = write!(path, "{}{place}", if path.is_empty() { "M" } else { "L" });
            }
            last = place;
        }
        let _ = writeln!(self.0, "<path class=\"{class}\" d=\"{path}{}\"/>", if closes { "Z" } else { "" });
    }

    /// A text; its class says where it is aligned.
    pub fn text(&mut self, class: &str, (x, y): Point, text: &str) {
        self.turned(class, (x, y), 0.0, text);
    }

    /// A text, rotated clockwise by this many degrees.
    pub fn turned(&mut self, class: &str, (x, y): Point, angle: f64, text: &str) {
        let (x, y, angle) = (short(x), short(y), short(angle));
        let turn = if angle == "0" { String::new() } else { format!(" transform=\"rotate({angle} {x} {y})\"") };
        let text = text.replace('&', "&amp;").replace('<', "&lt;");
        let _ = writeln!(self.0, "<text class=\"{class}\" x=\"{x}\" y=\"{y}\"{turn}>{text}</text>");
    }

    /// A number in a circle.
    pub fn numbered(&mut self, (x, y): Point, radius: f64, number: u16) {
        self.circle("disc", (x, y), radius);
        self.text("s m", (x, y + 4.0), &number.to_string());
    }
}

/// Without the places that are no further than a fifth of a pixel from the line that the others make (Douglas and Peucker).
pub fn thinned(places: Vec<Point>) -> Vec<Point> {
    let [first, middle @ .., last] = &places[..] else { return places };
    let (x, y) = (last.0 - first.0, last.1 - first.1);
    let length = x.hypot(y);
    let distance = |place: &Point| {
        let (east, south) = (place.0 - first.0, place.1 - first.1);
        if length > 0.0 { (east * y - south * x).abs() / length } else { east.hypot(south) }
    };
    let furthest = (1..).zip(middle).max_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
    match furthest.filter(|(_, place)| distance(place) > 0.2) {
        Some((at, _)) => {
            let mut before = thinned(places[..=at].to_vec());
            before.pop();
            before.extend(thinned(places[at..].to_vec()));
            before
        }
        None => vec![*first, *last],
    }
}

/// A tenth of a pixel is exact enough.
pub fn short(number: f64) -> String {
    let text = format!("{number:.1}");
    let text = text.strip_suffix(".0").unwrap_or(&text);
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// A number for people.
pub fn signed(number: f64) -> String {
    short(number).replace('-', "−")
}

/// Numbers on a line to places on it.
#[derive(Clone, Copy)]
pub struct Scale {
    from: f64,
    pixel: f64,
    /// Pixels for 1.
    pub rate: f64,
}

impl Scale {
    pub fn new((from, to): Point, (begin, end): Point) -> Self {
        Self { from, pixel: begin, rate: (end - begin) / (to - from) }
    }

    pub fn of(&self, number: f64) -> f64 {
        self.pixel + (number - self.from) * self.rate
    }
}

/// The multiples of `step` from one number to another.
pub fn ticks((from, to): Point, step: f64) -> impl Iterator<Item = f64> {
    let first = (from / step).ceil();
    (0..).map(move |n| (first + f64::from(n)) * step).take_while(move |tick| *tick <= to)
}

/// The least and the largest number.
pub fn range(numbers: impl Iterator<Item = f64>) -> Point {
    numbers.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), number| (low.min(number), high.max(number)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        assert_eq!([0.0, -0.01, 12.0, -3.26].map(short), ["0", "0", "12", "-3.3"]);
        assert_eq!(signed(-50.0), "−50");
    }

    #[test]
    fn ticks_are_multiples_of_their_step() {
        assert_eq!(ticks((-35.0, 120.0), 50.0).collect::<Vec<_>>(), [0.0, 50.0, 100.0]);
        assert_eq!(range([3.0, -1.0, 2.0].into_iter()), (-1.0, 3.0));
        assert_eq!(Scale::new((0.0, 10.0), (100.0, 50.0)).of(4.0), 80.0);
    }

    #[test]
    fn only_places_on_a_line_are_left_out() {
        let line = [(0.0, 0.0), (1.0, 0.1), (2.0, 0.0), (2.0, 5.0), (2.0, 9.0)];
        assert_eq!(thinned(line.to_vec()), [(0.0, 0.0), (2.0, 0.0), (2.0, 9.0)]);
        assert_eq!(thinned(vec![(1.0, 1.0); 3]), [(1.0, 1.0), (1.0, 1.0)]);
        assert_eq!(thinned(Vec::new()), []);
    }
}
