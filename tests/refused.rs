//! Configuration that cannot work does not compile, and the compiler's message says what is wrong with it. Each case is a
//! firmware that the compiler is given; it must say the words beside it. One that is as it should be must compile.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What every firmware has in front.
const FRONT: &str = "
#![allow(dead_code, unused)]
use mavstack::dialect::*;
use mavstack::*;
use std::ops::DerefMut as _;
static PULSE: Pulse = Pulse::new();
";

/// A vehicle: `{vehicle}`, `{commands}` and `{telemetry}` are what a case adds to these traits. Then `{main}`.
const VEHICLE: &str = r#"
const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);
const UART: LinkConfig = LinkConfig::uart(57_600);
struct Rover;
impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> { None }
    {vehicle}
}
impl Commands for Rover {
    fn command(&mut self, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
    {commands}
}
impl Plans for Rover {
    const MISSION_COMMANDS: &'static [CommandRule] = &[];
    fn plan_changed(&mut self, _: PlanChange<'_>) {}
    fn progress(&self) -> Progress { Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false } }
}
impl Telemetry for Rover { {telemetry} }
impl Parameters for Rover { type Table = NoParams; }
fn run<const L: usize, P: PlanStorage, const A: usize, const B: usize, const C: usize>(mut stack: Stack<L, P, A, B, C>) {
    stack.poll(Instant::ZERO, &mut Rover);
    stack.receive(Instant::ZERO, LinkId(0), &[0], &mut Rover);
    stack.transmit(Instant::ZERO, LinkId(0), &mut Rover);
}
fn main() { {main} }
"#;

/// A constant of its own.
fn constant(text: &str) -> String {
    format!("{FRONT}{text}\nfn main() {{}}\n")
}

/// What `main` does with a stack.
fn main_does(text: &str) -> String {
    vehicle("", "", "", text)
}

fn vehicle(vehicle: &str, commands: &str, telemetry: &str, main: &str) -> String {
    let text = VEHICLE.replace("{vehicle}", vehicle).replace("{commands}", commands);
    let main = if main.is_empty() { "run(Stack::<1>::new(CONFIG, [UART]))" } else { main };
    format!("{FRONT}{}", text.replace("{telemetry}", telemetry).replace("{main}", main))
}

fn commands(text: &str) -> String {
    vehicle("", text, "", "")
}

fn telemetry(text: &str) -> String {
    vehicle("", "", text, "")
}

/// Firmwares, and what the compiler says of them.
fn cases() -> Vec<(&'static str, String, &'static str)> {
    let config = |system, component| {
        constant(&format!("const CONFIG: Config = Config::new(Address::new({system}, {component}), &PULSE);"))
    };
    let address = "a system id is 1 to 254 (255: ground stations), a component id 1 to 255";
    let links = "a stack has 1 to 16 links";
    let streams = |list: &str| telemetry(&format!("const STREAMS: &'static [Stream] = &[{list}];"));
    let modes = |list: &str| commands(&format!("const MODES: &'static [FlightMode] = &[{list}];"));
    let parameters = |list: &str| constant(&format!("parameters! {{ pub struct Tuning {{ {list} }} }}"));
    let many: String = (0..33).fold(String::new(), |mut list, mode| {
        let _ = write!(list, "FlightMode::new({mode}, \"M\"),");
        list
    });
    vec![
        ("system_0", config(0, 1), address),
        ("system_255", config(255, 1), address),
        ("component_0", config(1, 0), address),
        ("baud_0", constant("const LINK: LinkConfig = LinkConfig::uart(0);"), "a UART has a baud rate"),
        (
            "budget",
            constant("const BUDGET: PollBudget = PollBudget::for_line(3_000_000, Duration::from_secs(600));"),
            "poll the link more often",
        ),
        ("links_0", main_does("run(Stack::<0>::new(CONFIG, []))"), links),
        ("links_17", main_does("run(Stack::<17>::new(CONFIG, [UART; 17]))"), links),
        ("peers_0", main_does("run(Stack::<1, NoPlans, 0>::with_capacities(CONFIG, [UART]))"), "needs room for a peer"),
        (
            "items_65535",
            main_does("run(Stack::<1, plan_memory!(mission: 65_535)>::new(CONFIG, [UART]))"),
            "a plan has at most 65,534 items",
        ),
        ("items_0", main_does("run(Stack::<1, plan_memory!(mission: 0)>::new(CONFIG, [UART]))"), "use NoPlans"),
        ("items_order", main_does("type Plans = plan_memory!(rally: 16);"), "what stands behind may be left out"),
        (
            "staging",
            main_does("run(Stack::<1, PlanMemory<9, 0, 0, 8>>::new(CONFIG, [UART]))"),
            "the staging area is as large as the largest plan: use plan_memory!",
        ),
        ("queue_285", main_does("ForwardQueues::<2, 285>::new();"), "a queue must hold the longest frame: 286 bytes"),
        ("queue_links", main_does("ForwardQueues::<1>::new();"), "frames pass between 2 to 16 links"),
        ("queue_memory", main_does("ForwardQueues::<2, 512, 0>::new();"), "what was forwarded must be remembered"),
        ("slots_0", main_does("CommandSlots::<0>::new();"), "command memory needs a place"),
        ("clocks_0", main_does("TimeSlots::<0>::new();"), "time memory needs a link"),
        ("signing_0", main_does("SigningMemory::<0>::new();"), "signing memory needs room for a stream"),
        (
            "streams_room",
            vehicle(
                "",
                "",
                "const STREAMS: &'static [Stream] = &[Stream::of::<Attitude>(), Stream::of::<VfrHud>()];",
                "run(Stack::<1, NoPlans, 8, 4, 1>::with_capacities(CONFIG, [UART]))",
            ),
            "more `STREAMS` than the stack has room for",
        ),
        (
            "streams_twice",
            streams("Stream::of::<Attitude>(), Stream::of::<Attitude>()"),
            "a message stands once in `STREAMS`",
        ),
        ("streams_heartbeat", streams("Stream::of::<Heartbeat>()"), "the stack sends this message by itself"),
        (
            "announce",
            main_does("Stack::<1>::new(CONFIG, [UART]).announce::<Attitude, Rover>()"),
            "the vehicle does not declare this message in `STREAMS`",
        ),
        ("modes_33", modes(&many), "a vehicle has at most 32 modes"),
        (
            "modes_twice",
            modes("FlightMode::new(1, \"A\"), FlightMode::new(1, \"B\")"),
            "two modes with the same custom_mode",
        ),
        ("modes_name", modes("FlightMode::new(1, \"\")"), "a mode's name has 1 to 34 bytes"),
        ("param_name", parameters("A_NAME_OF_17_BYTES: u8 = 0, 0..=1, \"\";"), "a parameter's name has 1 to 16 bytes"),
        ("param_twice", parameters("A: u8 = 0, 0..=1, \"\"; A: u8 = 0, 0..=1, \"\";"), "each name once"),
        ("param_default", parameters("A: u8 = 2, 0..=1, \"\";"), "a parameter's default lies within its range"),
        ("message_order", constant("message! { struct M: M = 53_000 { a: u8, b: u32, } }"), "must stand in wire order"),
        ("message_id", constant("message! { struct M: M = 16_777_216 { a: u8, } }"), "a message id has 24 bits"),
        ("message_long", constant("message! { struct M: M = 53_000 { a: [u64; 32], } }"), "at most 255 bytes"),
        (
            "message_taken",
            constant(
                "message! { struct M: M = 30 { a: u8, } }
                 dialect! { struct D: [M] + Common; }
                 const ROWS: MessageTable = D::MESSAGES;",
            ),
            "two messages of the dialect have one id",
        ),
        (
            "deaf",
            vehicle("const MESSAGES: MessageTable = <D as Dialect>::MESSAGES;", "", "", "")
                + "message! { struct M: M = 53_000 { a: u8, } } dialect! { struct D: [M]; }",
            "put all of common beside your own",
        ),
    ]
}

/// A package with a firmware for each case, which Cargo builds against this crate.
fn package(cases: &[(&str, String, &str)]) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("refused");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest = format!(
        "[package]\nname = \"refused\"\nversion = \"0.0.0\"\nedition = \"2024\"\n\n[dependencies]\n\
         mavstack = {{ path = {:?}, features = [\"signing\"] }}\n\n[profile.dev]\ndebug = 0\n\n[workspace]\n",
        root.display().to_string()
    );
    // What was there is of another state of this test.
    let _ = std::fs::remove_dir_all(folder.join("src"));
    std::fs::create_dir_all(folder.join("src/bin")).expect("a folder");
    std::fs::write(folder.join("Cargo.toml"), manifest).expect("written");
    std::fs::copy(root.join("Cargo.lock"), folder.join("Cargo.lock")).expect("the lock file");
    for (name, text, _) in cases {
        std::fs::write(folder.join(format!("src/bin/{name}.rs")), text).expect("written");
    }
    folder
}

/// What Cargo says of all of them: a line of JSON for each message and each firmware that was built.
fn build(folder: &Path) -> Vec<String> {
    let output = Command::new(env!("CARGO"))
        .args(["build", "--quiet", "--bins", "--keep-going", "--message-format", "json"])
        .current_dir(folder)
        .env("CARGO_TARGET_DIR", folder.join("target"))
        .env_remove("RUSTFLAGS")
        .output()
        .expect("cargo runs");
    let lines = String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect::<Vec<_>>();
    assert!(!lines.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
    lines
}

#[test]
fn what_cannot_work_is_refused_with_words() {
    let mut cases = cases();
    cases.push(("right", main_does("run(Stack::<2, plan_memory!(mission: 9)>::new(CONFIG, [UART; 2]))"), ""));
    let lines = build(&package(&cases));
    let mut wrong = String::new();
    for (name, _, says) in &cases {
        let of_case = || lines.iter().filter(|line| line.contains(&format!("\"name\":\"{name}\"")));
        let is_built = of_case().any(|line| line.contains("\"reason\":\"compiler-artifact\""));
        let complaints: Vec<_> = of_case().filter(|line| line.contains("\"level\":\"error\"")).collect();
        let is_as_expected = match says.is_empty() {
            true => is_built,
            false => !is_built && complaints.iter().any(|line| line.contains(says)),
        };
        if !is_as_expected {
            let _ = writeln!(wrong, "{name}: built: {is_built}; expected `{says}`, the compiler said {complaints:#?}");
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}
