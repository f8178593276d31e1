//! This library beside others, from the figures of `cargo measure compare`.

use super::svg::{Scale, Svg, WIDTH, range, short};
use crate::figures::{self, FILE};
use crate::system::Result;

/// The libraries by the names that the picture has for them, and by those in the keys of the figures.
const LIBRARIES: [(&str, &str); 4] =
    [("mavstack", "mavstack"), ("rust-mavlink", "mavlink"), ("mavio", "mavio"), ("C library", "c")];

/// A number of each of the libraries.
type Row = [f64; LIBRARIES.len()];

/// Bars of one kind.
struct Panel {
    title: &'static str,
    unit: &'static str,
    /// One bar of each library, or several.
    rows: Vec<Row>,
    format: fn(f64) -> String,
}

/// What the picture shows of the figures.
pub struct Comparison {
    /// Of a firmware with twelve messages in and eight out, as the library is documented, and as lean as it can be used:
    /// instructions for each byte that is received.
    work: [Row; 2],
    /// Of the same firmware, bytes.
    flash: [Row; 2],
    /// Percent of the intact frames that are not found in the worst of the damaged streams.
    lost: Row,
}

impl Comparison {
    /// Takes the figures from the text of [`FILE`].
    pub fn parse(text: &str) -> Result<Self> {
        let section = figures::section(text, "compare")?;
        // The least and the greatest of the figures `begin.library` and `begin.library-use`.
        let of = |begin: &str| {
            LIBRARIES.map(|(_, library)| {
                range(section.iter().filter_map(|(key, value)| {
                    let rest = key.strip_prefix(begin)?.strip_prefix('.')?.strip_prefix(library)?;
                    let is_of_library = rest.is_empty() || rest.starts_with('-') || rest == ".most";
                    is_of_library.then(|| value.parse().ok())?
                }))
            })
        };
        let [work, flash, lost] = ["firmware.whole.pieces", "firmware.flash", "lost"].map(of);
        if [work, flash, lost].as_flattened().iter().any(|(least, most)| !(least.is_finite() && most.is_finite())) {
            return Err(format!("{FILE} lacks a library in the section `compare`"));
        }
        let bars =
            |ranges: [(f64, f64); LIBRARIES.len()]| [ranges.map(|(_, most)| most), ranges.map(|(least, _)| least)];
        Ok(Self { work: bars(work), flash: bars(flash), lost: lost.map(|(_, most)| most) })
    }

    /// Three panels of bars.
    pub fn draw(&self) -> String {
        const NAMES: f64 = 108.0;
        const TOP: f64 = 66.0;
        const PITCH: f64 = 42.0;
        const GAP: f64 = 28.0;
        let height = TOP + PITCH * LIBRARIES.len() as f64 + 30.0;
        let mut svg =
            Svg::new(WIDTH, height, "mavstack beside rust-mavlink, mavio and the C library: time, flash, lost frames");
        let width = (WIDTH - NAMES - 18.0 - 2.0 * GAP) / 3.0;
        let y = |row: usize| TOP + PITCH * row as f64;
        for (row, (name, _)) in LIBRARIES.iter().enumerate() {
            svg.text(if row == 0 { "h e ta" } else { "e" }, (NAMES - 10.0, y(row) + 21.0), name);
        }
        let panels = [
            Panel {
                title: "Work",
                unit: "instructions for each byte received",
                rows: self.work.to_vec(),
                format: |count| format!("{count:.0}"),
            },
            Panel { title: "Flash", unit: "bytes", rows: self.flash.to_vec(), format: grouped },
            Panel {
                title: "Lost frames",
                unit: "% of the intact ones on a bad line",
                rows: vec![self.lost],
                format: short,
            },
        ];
        for (panel, Panel { title, unit, rows, format }) in panels.into_iter().enumerate() {
            let left = NAMES + (width + GAP) * panel as f64;
            svg.text("h", (left, 26.0), title);
            svg.text("s q", (left, 44.0), unit);
            svg.lines("axis", [(left, TOP - 4.0), (left, y(LIBRARIES.len()) - 4.0)], false);
            let (_, most) = range(rows.iter().flat_map(|row| row.iter().copied()));
            // Room for the number at the longest bar's end.
            let scale = Scale::new((0.0, most), (left, left + width - 48.0));
            for at in 0..LIBRARIES.len() {
                // Once where both are the same.
                let is_one = rows.iter().all(|row| row[at] == rows[0][at]);
                let bars = &rows[..if is_one { 1 } else { rows.len() }];
                let thick = if is_one { 18.0 } else { 13.0 };
                let mut top = y(at) + 16.0 - thick * bars.len() as f64 / 2.0;
                for (nth, row) in bars.iter().enumerate() {
                    let colour = if at == 0 { "ours" } else { "theirs" };
                    let class = if !is_one && nth == 0 { format!("{colour} pale") } else { colour.to_owned() };
                    let end = scale.of(row[at]);
                    if row[at] > 0.0 {
                        svg.rect(&class, (left, top), ((end - left).max(1.5), thick - 1.0));
                    }
                    svg.text("s", (end + 6.0, top + thick / 2.0 + 3.5), &format(row[at]));
                    top += thick;
                }
            }
        }
        let foot = height - 16.0;
        svg.text("s q", (NAMES, foot), "Cortex-M4F firmware, 12 messages in, 8 out:");
        svg.rect("theirs pale", (NAMES + 252.0, foot - 8.0), (9.0, 9.0));
        svg.text("s q", (NAMES + 266.0, foot), "as documented");
        svg.rect("theirs", (NAMES + 358.0, foot - 8.0), (9.0, 9.0));
        svg.text("s q", (NAMES + 372.0, foot), "leanest use");
        svg.text("s q", (NAMES + 2.0 * (width + GAP), foot), "worst of five kinds of damage");
        svg.end()
    }
}

/// With commas between thousands.
fn grouped(number: f64) -> String {
    let number = number.round() as u32;
    if number < 1_000 { number.to_string() } else { format!("{},{:03}", number / 1_000, number % 1_000) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "
[work]
firmware.flash.mavstack = \"1\"

[compare]
command = \"cargo measure compare\"
lost.mavstack.least = \"0.0\"
lost.mavstack.most = \"0.0\"
lost.mavlink.most = \"0.0\"
lost.mavio.least = \"1.8\"
lost.mavio.most = \"26.0\"
lost.c.most = \"16.5\"
firmware.flash.mavstack = \"3,156\"
firmware.flash.mavlink-enum = \"71,432\"
firmware.flash.mavlink-lean = \"8,872\"
firmware.flash.mavio-lean = \"11,632\"
firmware.flash.c-os = \"6,432\"
firmware.flash.c-os-lean = \"2,196\"
firmware.whole.pieces.mavstack = \"32.9\"
firmware.whole.pieces.mavlink-enum = \"48.9\"
firmware.whole.pieces.mavio-lean = \"151.7\"
firmware.whole.pieces.c-os = \"116.9\"

[miri]
firmware.flash.mavstack = \"9\"
";

    #[test]
    fn the_figures_of_compare_are_read() {
        let Comparison { work, flash, lost } = Comparison::parse(TEXT).unwrap();
        assert_eq!(work, [[32.9, 48.9, 151.7, 116.9]; 2]);
        assert_eq!(flash, [[3156.0, 71_432.0, 11_632.0, 6432.0], [3156.0, 8872.0, 11_632.0, 2196.0]]);
        assert_eq!(lost.map(short), ["0", "0", "26", "16.5"]);
        assert!(Comparison::parse(&TEXT.replace("whole.pieces.mavio", "whole.bytes.mavio")).is_err());
        assert!(Comparison::parse("").is_err());
    }

    #[test]
    fn the_picture_shows_the_figures() {
        let path = xtask_common::system::root().join("docs/pictures/compare.svg");
        let drawn = std::fs::read_to_string(path).expect("the picture");
        let fresh = Comparison::parse(&figures::read().unwrap()).expect("the figures").draw();
        assert!(fresh == drawn, "draw it again: cargo xtask pictures --compare");
    }

    #[test]
    fn thousands_have_commas() {
        assert_eq!([999.0, 1_000.0, 122_700.0].map(grouped), ["999", "1,000", "122,700"]);
    }
}
