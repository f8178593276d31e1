//! This library beside others, from what `cargo measure compare` printed.

use super::svg::{Scale, Svg, WIDTH, range, short};
use xtask_common::system::Result;

/// The libraries by the names that the picture has for them, and those of their columns.
const LIBRARIES: [(&str, &str); 4] =
    [("mavstack", "mavstack"), ("rust-mavlink", "mavlink"), ("mavio", "mavio"), ("C library", "C -O")];

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

/// What the picture shows of an output of `cargo measure compare`.
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
    /// Reads the printed tables.
    pub fn parse(text: &str) -> Result<Self> {
        let recovery = Table::find(text, "Recovery: ", 16)?;
        let firmware = Table::find(text, "Firmware, ", 18)?;
        let least = |row: &[(String, f64)]| LIBRARIES.map(|(_, name)| range(of(row, name)).0);
        let most = |row: &[(String, f64)]| LIBRARIES.map(|(_, name)| range(of(row, name)).1);
        let [work, flash] = [firmware.row("all of it, pieces of 64")?, firmware.row("flash")?];
        let mut lost = [0.0_f64; LIBRARIES.len()];
        for row in &recovery.rows {
            let found = least(&recovery.cells(row)?);
            lost.iter_mut().zip(found).for_each(|(lost, found)| *lost = lost.max(100.0 - found));
        }
        let [work, flash] = [work, flash].map(|row| [most(&row), least(&row)]);
        let all = [work.as_flattened(), flash.as_flattened(), &lost].concat();
        if all.iter().any(|number| !number.is_finite()) {
            return Err("the comparison lacks a library".to_owned());
        }
        Ok(Self { work, flash, lost })
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

/// Those of a library: some have several columns.
fn of<'a>(row: &'a [(String, f64)], name: &'a str) -> impl Iterator<Item = f64> + 'a {
    row.iter().filter(move |(column, _)| column.starts_with(name)).map(|(_, number)| *number)
}

/// With commas between thousands.
fn grouped(number: f64) -> String {
    let number = number.round() as u32;
    if number < 1_000 { number.to_string() } else { format!("{},{:03}", number / 1_000, number % 1_000) }
}

/// A table that `cargo measure compare` printed.
struct Table<'a> {
    columns: Vec<String>,
    rows: Vec<&'a str>,
    width: usize,
}

impl<'a> Table<'a> {
    /// The one below this title, whose columns are so wide.
    fn find(text: &'a str, title: &str, width: usize) -> Result<Self> {
        // Between the title and the table it may have been said what is installed.
        let below = text.lines().skip_while(|line| !line.starts_with(title));
        let mut lines = below.skip_while(|line| !line.trim_start().starts_with(LIBRARIES[0].1));
        let head = lines.next().ok_or_else(|| format!("no table \"{title}…\""))?;
        let rows = lines.take_while(|line| !line.is_empty()).collect();
        Ok(Self { columns: cells(head.trim_start(), head, width), rows, width })
    }

    /// The columns' names and the first number of each cell.
    fn cells(&self, row: &str) -> Result<Vec<(String, f64)>> {
        let from = row.chars().count().saturating_sub(self.width * self.columns.len());
        let numbers: String = row.chars().skip(from).collect();
        let cells = cells(&numbers, &numbers, self.width);
        self.columns
            .iter()
            .zip(cells)
            .map(|(column, cell)| {
                let number = cell.split(' ').next().and_then(|word| word.parse().ok());
                Ok((column.clone(), number.ok_or_else(|| format!("{cell} is no number: {row}"))?))
            })
            .collect()
    }

    fn row(&self, label: &str) -> Result<Vec<(String, f64)>> {
        let row = self.rows.iter().find(|row| row.starts_with(label));
        self.cells(row.ok_or_else(|| format!("no row \"{label}…\""))?)
    }
}

/// Cells of a line, aligned to the right in columns of this width, as many as `content` needs.
fn cells(content: &str, line: &str, width: usize) -> Vec<String> {
    let (len, needed) = (line.chars().count(), content.chars().count().div_ceil(width));
    let from = len.saturating_sub(needed * width);
    let chars: Vec<char> = line.chars().skip(from).collect();
    chars.chunks(width).map(|cell| cell.iter().collect::<String>().trim().to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const OUTPUT: &str = "
Recovery: of 20,000 frames on a bad line, intact ones that are found, and false accepts
                                            mavstack  mavlink no_std     mavlink std           mavio           C -O2
bits flipped in 10 % of the frames       100.00 %, 0     100.00 %, 0     100.00 %, 0      98.23 %, 0      98.48 %, 0
bytes lost from 10 %                     100.00 %, 0     100.00 %, 0     100.00 %, 0      84.87 %, 0      92.32 %, 0
bursts of garbage in 10 %                100.00 %, 0     100.00 %, 0     100.00 %, 0      90.36 %, 0      95.22 %, 0
all three                                100.00 %, 0     100.00 %, 0     100.00 %, 0      76.52 %, 0      86.85 %, 0
1 % of bytes changed, garbage between     100.00 %, 0     100.00 %, 0     100.00 %, 0      73.99 %, 0      83.52 %, 0

Firmware, Cortex-M4F, 12 messages in and 8 out, less one that only reads; and how often ours goes into it
Toolchain: rustc 1.95.0 with thumbv7em-none-eabihf
                                              mavstack      mavlink enum      mavlink lean        mavio enum        mavio lean             C -Os        C -Os lean              goal
flash, bytes                                    3320.0  71432.0 = 21.52x    8872.0 = 2.67x 134592.0 = 40.54x   11632.0 = 3.50x    6432.0 = 1.94x    2196.0 = 0.66x              4000
all of it, pieces of 64                           31.9      48.9 = 1.53x      38.8 = 1.22x     181.6 = 5.70x     151.7 = 4.76x     116.9 = 3.67x     115.2 = 3.61x                42
reading the line alone takes 4.5 instructions a byte in pieces, 34.0 byte by byte
";

    #[test]
    fn the_output_of_compare_is_read() {
        let Comparison { work, flash, lost } = Comparison::parse(OUTPUT).unwrap();
        assert_eq!(work, [[31.9, 48.9, 181.6, 116.9], [31.9, 38.8, 151.7, 115.2]]);
        assert_eq!(flash, [[3320.0, 71_432.0, 134_592.0, 6432.0], [3320.0, 8872.0, 11_632.0, 2196.0]]);
        assert_eq!(lost.map(short), ["0", "0", "26", "16.5"]);
        assert!(Comparison::parse("").is_err());
    }

    #[test]
    fn thousands_have_commas() {
        assert_eq!([999.0, 1_000.0, 122_700.0].map(grouped), ["999", "1,000", "122,700"]);
    }
}
