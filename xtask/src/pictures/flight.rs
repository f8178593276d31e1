//! A flight from a log of its frames: its path over the plans that were uploaded, and its height.

use mavstack::dialect::{
    CommandInt, GlobalPositionInt, Heartbeat, MavCmd, MavMissionType, MavModeFlag, MavSeverity, MissionItemInt,
    MissionItemReached, Statustext,
};
use mavstack::{Address, Frame};
use mavstack_console::Frames;

use super::svg::{Point, Scale, Svg, WIDTH, range, short, signed, thinned, ticks};
use xtask_common::system::Result;

/// The demo vehicle's address.
const VEHICLE: Address = Address::new(1, 1);

/// A place of a plan.
struct Place {
    seq: u16,
    command: MavCmd,
    /// Parameter 1: a circle's radius, a polygon's number of corners.
    size: f64,
    /// Metres east and north of home.
    at: Point,
}

/// A moment of the flight.
#[derive(Clone, Copy)]
struct Moment {
    /// Seconds since arming.
    time: f64,
    /// Metres east and north of home.
    at: Point,
    /// Metres above home.
    height: f64,
    /// `HEARTBEAT.custom_mode`.
    mode: u32,
}

/// What a log says of a flight.
#[derive(Default)]
pub struct Flight {
    moments: Vec<Moment>,
    mission: Vec<Place>,
    fence: Vec<Place>,
    rally: Vec<Place>,
    /// When an item of the mission was reached: seconds, and its number.
    reached: Vec<(f64, u16)>,
    /// Warnings: what the vehicle said, and when.
    warnings: Vec<(f64, String)>,
    /// Where it was sent last, east and north of home.
    goto: Option<Point>,
}

fn is_goto(command: &CommandInt) -> bool {
    command.command == MavCmd::DO_REPOSITION
}

/// Degrees times 1e7 of latitude and longitude.
struct Home(i32, i32);

impl Home {
    fn local(&self, latitude: i32, longitude: i32) -> Point {
        /// Metres in a degree of latitude, times 1e-7.
        const METRES: f64 = 111_319.5e-7;
        let shrink = (f64::from(self.0) * 1e-7).to_radians().cos();
        let (north, east) = (f64::from(latitude) - f64::from(self.0), f64::from(longitude) - f64::from(self.1));
        (east * METRES * shrink, north * METRES)
    }
}

impl Flight {
    /// Reads a log: before each frame its time in µs, eight bytes, the most significant first.
    pub fn read(mut log: &[u8]) -> Result<Self> {
        let mut flight = Self::default();
        let (mut home, mut items, mut goto) = (None, Vec::new(), None);
        let (mut mode, mut is_armed, mut began) = (0, false, None);
        while let Some((time, rest)) = log.split_first_chunk::<8>() {
            let len = match *rest {
                [0xFD, len, flags, ..] => 12 + usize::from(len) + if flags & 1 == 1 { 13 } else { 0 },
                [0xFE, len, ..] => 8 + usize::from(len),
                _ => return Err("the log is no log of frames".to_owned()),
            };
            let Some((bytes, rest)) = rest.split_at_checked(len) else { break };
            log = rest;
            let micros = u64::from_be_bytes(*time);
            let mut each = |frame: &Frame<'_>| {
                if frame.source() != VEHICLE {
                    // From a ground station an item is part of an upload.
                    if let Some(item) = frame.decode::<MissionItemInt>() {
                        items.push(item);
                    } else if let Some(command) = frame.decode::<CommandInt>().filter(is_goto) {
                        goto = Some((command.x, command.y));
                    }
                    return;
                }
                let since = |began: u64| (micros.saturating_sub(began)) as f64 * 1e-6;
                if let Some(heartbeat) = frame.decode::<Heartbeat>() {
                    mode = heartbeat.custom_mode;
                    is_armed = heartbeat.base_mode.contains(MavModeFlag::SAFETY_ARMED);
                    if is_armed {
                        began.get_or_insert(micros);
                    }
                } else if let Some(position) = frame.decode::<GlobalPositionInt>() {
                    let home = home.get_or_insert(Home(position.lat, position.lon));
                    if let Some(began) = began.filter(|_| is_armed) {
                        let (at, height) =
                            (home.local(position.lat, position.lon), f64::from(position.relative_alt) * 1e-3);
                        flight.moments.push(Moment { time: since(began), at, height, mode });
                    }
                } else if let (Some(reached), Some(began)) = (frame.decode::<MissionItemReached>(), began) {
                    flight.reached.push((since(began), reached.seq));
                } else if let (Some(said), Some(began)) = (frame.decode::<Statustext>(), began)
                    && said.severity.0 <= MavSeverity::WARNING.0
                {
                    flight.warnings.push((since(began), said.text.as_str().unwrap_or_default().to_owned()));
                }
            };
            Frames::default().cut(bytes, &mut each);
        }
        let home = home.ok_or("the log has no position of the vehicle")?;
        items.iter().for_each(|item| flight.add(item, &home));
        flight.goto = goto.map(|(latitude, longitude)| home.local(latitude, longitude));
        // The same frame may have gone over several links.
        flight.reached.dedup_by_key(|(_, seq)| *seq);
        flight.warnings.dedup_by(|a, b| a.1 == b.1);
        if flight.moments.len() < 2 || flight.mission.is_empty() {
            return Err("the log has no flight with a mission".to_owned());
        }
        for plan in [&flight.mission, &flight.fence, &flight.rally] {
            if (0..).zip(plan).any(|(seq, place)| place.seq != seq) {
                return Err("the log lacks an item of a plan".to_owned());
            }
        }
        Ok(flight)
    }

    fn add(&mut self, item: &MissionItemInt, home: &Home) {
        let plan = match item.mission_type {
            MavMissionType::FENCE => &mut self.fence,
            MavMissionType::RALLY => &mut self.rally,
            _ => &mut self.mission,
        };
        let at = home.local(item.x, item.y);
        let place = Place { seq: item.seq, command: item.command, size: f64::from(item.param1), at };
        match plan.iter_mut().find(|known| known.seq == item.seq) {
            Some(known) => *known = place,
            None => plan.push(place),
        }
    }

    /// Where it was then.
    fn at(&self, time: f64) -> Moment {
        let after = self.moments.iter().position(|moment| moment.time >= time).unwrap_or(self.moments.len() - 1);
        self.moments[after]
    }

    /// What it flew in the mode that it was in then.
    fn leg_at(&self, time: f64) -> Option<&[Moment]> {
        self.legs().into_iter().find(|leg| leg.last().is_some_and(|last| last.time >= time))
    }

    /// What it flew in one mode after another; each begins where the one before ends.
    fn legs(&self) -> Vec<&[Moment]> {
        let mut legs: Vec<&[Moment]> = Vec::new();
        let mut begin = 0;
        for at in 1..=self.moments.len() {
            if at == self.moments.len() || self.moments[at].mode != self.moments[begin].mode {
                legs.push(&self.moments[begin..(at + 1).min(self.moments.len())]);
                begin = at;
            }
        }
        legs
    }
}

/// A mode's name, and the class of its lines; the numbers are PX4's, as the demo's.
fn mode(number: u32) -> (&'static str, &'static str) {
    match (number >> 16 & 0xFF, number >> 24) {
        (3, _) => ("Position", "c"),
        (6, _) => ("Offboard", "c"),
        (4, 2) => ("Takeoff", "a"),
        (4, 4) => ("Mission", "a"),
        (4, 5) => ("Return", "b"),
        (4, 6) => ("Land", "b"),
        _ => ("Hold", "c"),
    }
}

impl Flight {
    /// The path over the plans, and below it the height.
    pub fn draw(&self) -> String {
        const LEFT: f64 = 56.0;
        const RIGHT: f64 = WIDTH - 18.0;
        const TOP: f64 = 18.0;
        const STRIP: f64 = 92.0;
        /// Metres beyond what is drawn.
        const MARGIN: f64 = 9.0;

        let places = [&self.mission, &self.fence, &self.rally].into_iter().flatten().map(|place| place.at);
        let all: Vec<Point> = places.chain(self.moments.iter().map(|moment| moment.at)).chain(self.goto).collect();
        let widened = |(low, high): Point| (low - MARGIN, high + MARGIN);
        let (easts, norths) = (widened(range(all.iter().map(|at| at.0))), widened(range(all.iter().map(|at| at.1))));
        let east = Scale::new(easts, (LEFT, RIGHT));
        let bottom = TOP + (norths.1 - norths.0) * east.rate;
        let north = Scale::new(norths, (bottom, TOP));
        let map = |(x, y): Point| (east.of(x), north.of(y));

        let strip = bottom + 66.0;
        let end = self.moments.last().map_or(1.0, |moment| moment.time);
        let time = Scale::new((0.0, end), (LEFT, RIGHT));
        let highest = range(self.moments.iter().map(|moment| moment.height)).1 * 1.15;
        let height = Scale::new((0.0, highest), (strip + STRIP, strip));
        let mut svg =
            Svg::new(WIDTH, strip + STRIP + 44.0, "A flight of the demo firmware over its mission and its geofence");

        svg.rect("plot", (LEFT, TOP), (RIGHT - LEFT, bottom - TOP));
        for x in ticks(easts, 50.0) {
            svg.lines("grid", [(east.of(x), TOP), (east.of(x), bottom)], false);
            svg.text("s q m", (east.of(x), bottom + 15.0), &signed(x));
        }
        for y in ticks(norths, 50.0) {
            svg.lines("grid", [(LEFT, north.of(y)), (RIGHT, north.of(y))], false);
            svg.text("s q e", (LEFT - 6.0, north.of(y) + 4.0), &signed(y));
        }
        svg.text("s q e", (RIGHT, bottom + 31.0), "metres east of home");
        svg.turned("s q e", (16.0, TOP), -90.0, "metres north of home");

        let key = |x: f64| [(LEFT + x, TOP + 16.0), (LEFT + x + 22.0, TOP + 16.0)];
        svg.lines("a", key(12.0), false);
        svg.text("s q", (LEFT + 40.0, TOP + 20.0), "flown");
        svg.lines("plan", key(82.0), false);
        svg.text("s q", (LEFT + 110.0, TOP + 20.0), "planned");

        self.draw_fence(&mut svg, map, east.rate);
        svg.lines("plan", self.mission.iter().map(|place| map(place.at)), false);
        for leg in self.legs() {
            svg.lines(mode(leg[0].mode).1, thinned(leg.iter().map(|moment| map(moment.at)).collect()), false);
        }
        for place in &self.rally {
            let (x, y) = map(place.at);
            svg.lines("disc", [(x, y - 9.0), (x + 9.0, y), (x, y + 9.0), (x - 9.0, y)], true);
            svg.text("s m", (x, y + 4.0), "R");
            svg.text("s q", (x - 22.0, y + 24.0), "rally point");
        }
        for place in &self.mission {
            svg.numbered(map(place.at), 8.5, place.seq);
        }
        let (x, y) = map((0.0, 0.0));
        svg.text("s q e", (x - 13.0, y + 4.0), "home");
        if let Some(goto) = self.goto {
            let (x, y) = map(goto);
            // Where the vehicle stopped on the way there.
            let stops = self.warnings.iter().filter_map(|(time, _)| self.leg_at(*time)?.last());
            stops.for_each(|stop| svg.lines("want", [map(stop.at), (x, y)], false));
            svg.lines("cross", [(x - 5.0, y - 5.0), (x + 5.0, y + 5.0)], false);
            svg.lines("cross", [(x + 5.0, y - 5.0), (x - 5.0, y + 5.0)], false);
            svg.text("s warn", (x + 11.0, y + 4.0), "told to fly here");
        }
        for (time, said) in &self.warnings {
            let (x, y) = map(self.at(*time).at);
            svg.circle("cross", (x, y), 4.0);
            svg.lines("thin", [(x - 4.0, y - 6.0), (x - 20.0, y - 42.0)], false);
            svg.text("s warn e", (x - 14.0, y - 48.0), &format!("“{said}”"));
        }

        svg.rect("plot", (LEFT, strip), (RIGHT - LEFT, STRIP));
        for x in ticks((0.0, end), 30.0) {
            svg.lines("grid", [(time.of(x), strip), (time.of(x), strip + STRIP)], false);
            svg.text("s q m", (time.of(x), strip + STRIP + 15.0), &format!("{}:{:02}", x as u32 / 60, x as u32 % 60));
        }
        for y in ticks((0.0, highest), 10.0) {
            svg.lines("grid", [(LEFT, height.of(y)), (RIGHT, height.of(y))], false);
            svg.text("s q e", (LEFT - 6.0, height.of(y) + 4.0), &short(y));
        }
        svg.text("s q e", (RIGHT, strip + STRIP + 31.0), "minutes since arming");
        svg.turned("s q e", (16.0, strip), -90.0, "height, metres");
        for leg in self.legs() {
            let (name, class) = mode(leg[0].mode);
            let profile = leg.iter().map(|moment| (time.of(moment.time), height.of(moment.height)));
            svg.lines(class, thinned(profile.collect()), false);
            let (from, to) = (time.of(leg[0].time), time.of(leg[leg.len() - 1].time));
            if to - from > 30.0 {
                svg.text(&format!("s m t{class}"), ((from + to) / 2.0, strip - 6.0), name);
            }
        }
        for &(at, seq) in &self.reached {
            svg.numbered((time.of(at), height.of(self.at(at).height)), 7.5, seq);
        }
        svg.end()
    }

    fn draw_fence(&self, svg: &mut Svg, map: impl Fn(Point) -> Point, rate: f64) {
        let mut rest = &self.fence[..];
        while let Some(first) = rest.first() {
            let is_inside = matches!(
                first.command,
                MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION | MavCmd::NAV_FENCE_CIRCLE_INCLUSION
            );
            let is_polygon = matches!(
                first.command,
                MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION | MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION
            );
            let class = if is_inside { "in" } else { "out" };
            let count = if is_polygon { (first.size as usize).clamp(1, rest.len()) } else { 1 };
            let (area, others) = rest.split_at(count);
            rest = others;
            let corners: Vec<Point> = area.iter().map(|place| map(place.at)).collect();
            if is_polygon {
                svg.lines(class, corners.iter().copied(), true);
            } else {
                svg.circle(class, corners[0], first.size * rate);
            }
            if is_inside && is_polygon {
                along_the_longest_edge(svg, &corners, "geofence");
            } else {
                let count = corners.len() as f64;
                let (x, y) = corners.iter().fold((0.0, 0.0), |(x, y), corner| (x + corner.0, y + corner.1));
                svg.text("s warn m", (x / count, y / count + 4.0), if is_inside { "geofence" } else { "keep out" });
            }
        }
    }
}

/// Writes beside the polygon's longest edge, inside.
fn along_the_longest_edge(svg: &mut Svg, corners: &[Point], text: &str) {
    let edges = corners.iter().zip(corners.iter().cycle().skip(1));
    let length = |(a, b): &(&Point, &Point)| (b.0 - a.0).hypot(b.1 - a.1);
    let Some((a, b)) = edges.max_by(|a, b| length(a).total_cmp(&length(b))) else { return };
    // From left to right, so that it stands upright.
    let (a, b) = if a.0 < b.0 { (a, b) } else { (b, a) };
    let centre = corners.iter().fold(0.0, |sum, corner| sum + corner.1) / corners.len() as f64;
    let (x, y) = ((a.0 + b.0) / 2.0, (a.1 + b.1) / 2.0);
    let below = if y < centre { 15.0 } else { -7.0 };
    svg.turned("s warn m", (x, y + below), (b.1 - a.1).atan2(b.0 - a.0).to_degrees(), text);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_log_of_a_flight_is_refused() {
        assert!(Flight::read(b"").is_err_and(|error| error.contains("no position")));
        assert!(Flight::read(b"12345678 and what is no frame").is_err_and(|error| error.contains("no log")));
    }
}
