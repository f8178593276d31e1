//! Invalid configurations do not compile, and the compiler's message says what is wrong. Each case is a firmware and a part of
//! the expected message. Valid firmwares must compile.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The start of every firmware.
const FRONT: &str = "
#![allow(dead_code, unused)]
use mavstack::config::PollBudget;
use mavstack::dialect::*;
use mavstack::message::{Dialect, MessageTable};
use mavstack::__private::PlanBuffers;
use mavstack::*;
static PULSE: Pulse = Pulse::new();
";

/// A firmware. `{vehicle}`, `{policies}` and `{command}` are additions to these hooks, `{hooks}` the other traits of its vehicle,
/// `{entries}` its declaration, and `{main}` its calls of the stack.
const FIRMWARE: &str = r#"
const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);
const UART: LinkConfig = LinkConfig::uart(57_600);
struct Rover;
impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> { None }
    {vehicle}
}
impl Commands for Rover {
    {policies}
    fn command(&mut self, cx: &mut Context<'_>, _: &Command) -> Outcome { {command} MavResult::UNSUPPORTED.into() }
}
{hooks}
stack! {
    struct Mavlink for Rover { {entries} }
}
fn main() {
    let mut stack = Mavlink::new(CONFIG, std::array::from_fn(|_| UART));
    stack.poll(Instant::ZERO, &mut Rover);
    stack.receive(Instant::ZERO, LinkId(0), &[0], &mut Rover);
    stack.transmit(Instant::ZERO, LinkId(0), &mut Rover);
    {main}
}
"#;

const PLANS: &str = "
impl Plans for Rover {
    const MISSION_COMMANDS: &'static [CommandRule] = &[];
    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {}
    fn progress(&self) -> Progress { Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false } }
}
";

const PARAMETERS: &str = "
parameters! { pub struct Tuning { A: u8 = 0, 0..=1, \"\"; } }
impl Parameters for Rover { type Table = Tuning; }
";

const CLIENT: &str = "
impl CommandClient for Rover {
    fn command_for(&mut self, _: u16) -> Option<OutgoingCommand> { None }
    fn command_answered(&mut self, _: &mut Context<'_>, _: u16, _: CommandReply) {}
}
";

/// A static file.
const FILES: &str = r#"
impl Files for Rover {
    const FILES: &'static [mavstack::files::StaticFile] = &[mavstack::files::StaticFile::new("a.txt", b"a")];
}
"#;

/// Other components of the firmware, with these ids.
fn components(ids: &[u8]) -> String {
    let list: Vec<_> =
        ids.iter().map(|id| format!("Component::new(mavstack::message::ComponentId({id}), MavType::GIMBAL)")).collect();
    let hooks =
        format!("impl Components for Rover {{ const COMPONENTS: &'static [Component] = &[{}]; }}", list.join(", "));
    Firmware { hooks: &hooks, entries: "links: 1, components", ..Firmware::default() }.text()
}

const CAMERA: &str = "
impl Camera for Rover {
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;
    fn camera_information(&self, _: &mut CameraInformation) {}
    fn take_image(&mut self, _: &mut Context<'_>, _: u32) -> mavstack::camera::Shot { mavstack::camera::Shot::Failed }
}
";

/// A camera that is a component.
const CAMERA_100: &str = "
impl Camera for Rover {
    const COMPONENT: Option<mavstack::message::ComponentId> = Some(mavstack::message::ComponentId(100));
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;
    fn camera_information(&self, _: &mut CameraInformation) {}
    fn take_image(&mut self, _: &mut Context<'_>, _: u32) -> mavstack::camera::Shot { mavstack::camera::Shot::Failed }
}
";

const EXT_PARAMETERS: &str = "
impl ExtParameters for Rover {
    fn ext_param_count(&self) -> u16 { 0 }
    fn ext_param(&self, _: u16) -> Option<(&str, mavstack::ext_parameters::ExtValue<'_>)> { None }
    fn set_ext_param(&mut self, _: &mut Context<'_>, _: u16, _: mavstack::ext_parameters::ExtValue<'_>) -> ParamAck {
        ParamAck::FAILED
    }
}
";

const LOGS: &str = "
impl Logs for Rover {
    fn log_count(&self) -> u16 { 0 }
    fn log_info(&self, _: u16) -> Option<mavstack::logs::LogInfo> { None }
    fn read_log(&mut self, _: u16, _: u32, _: &mut [u8]) -> mavstack::logs::LogRead { mavstack::logs::LogRead::Failed }
}
";

const LOG_STREAMING: &str = "
impl LogStreaming for Rover {
    fn start_log_stream(&mut self, _: &mut Context<'_>, _: Peer) -> MavResult { MavResult::ACCEPTED }
    fn stop_log_stream(&mut self, _: &mut Context<'_>) {}
    fn read_log_definitions(&mut self, _: u32, _: &mut [u8]) -> usize { 0 }
    fn log_data_len(&self) -> usize { 0 }
    fn take_log_data(&mut self, _: &mut [u8]) -> usize { 0 }
}
";

const BACKEND: &str = "
impl ParamBackend for Rover {
    fn param_count(&self) -> u16 { 0 }
    fn param_info(&self, _: u16) -> Option<mavstack::param::ParamInfo> { None }
    fn param_bits(&self, _: u16) -> Option<u32> { None }
    fn set_param(&mut self, _: &mut Context<'_>, _: &mavstack::param::ParamWrite) -> Result<(), MavParamError> { Ok(()) }
}
";

/// Returns the hooks of a vehicle that is a gimbal manager and a gimbal device, with these constants.
fn gimbal(manager: &str, device: &str) -> String {
    format!(
        "impl GimbalManager for Rover {{
             {manager}
             fn manager_information(&self) -> GimbalManagerInformation {{ Default::default() }}
             fn manager_flags(&self) -> GimbalManagerFlags {{ GimbalManagerFlags::EMPTY }}
             fn point_gimbal(&mut self, _: &mut Context<'_>, _: &gimbal::GimbalSetpoint) -> MavResult {{
                 MavResult::ACCEPTED
             }}
         }}
         impl GimbalDevice for Rover {{
             {device}
             fn device_information(&self) -> GimbalDeviceInformation {{ Default::default() }}
             fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus> {{ None }}
         }}"
    )
}

/// The parts of [`FIRMWARE`] that a case defines.
#[derive(Clone, Copy, Default)]
struct Firmware<'a> {
    vehicle: &'a str,
    policies: &'a str,
    command: &'a str,
    hooks: &'a str,
    entries: &'a str,
    main: &'a str,
}

impl Firmware<'_> {
    fn text(self) -> String {
        let Self { vehicle, policies, command, hooks, entries, main } = self;
        let text = FIRMWARE.replace("{vehicle}", vehicle).replace("{policies}", policies);
        let text = text.replace("{command}", command).replace("{hooks}", hooks);
        format!("{FRONT}{}", text.replace("{entries}", entries).replace("{main}", main))
    }
}

/// Returns a program with this item only.
fn constant(text: &str) -> String {
    format!("{FRONT}{text}\nfn main() {{}}\n")
}

/// Returns a firmware without further traits that declares `entries`.
fn declares(entries: &str) -> String {
    implements("", entries)
}

/// Returns a firmware with these traits that declares `entries`.
fn implements(hooks: &str, entries: &str) -> String {
    Firmware { hooks, entries, ..Firmware::default() }.text()
}

/// Returns a firmware with a single link that makes these calls.
fn calls(main: &str) -> String {
    Firmware { entries: "links: 1", main, ..Firmware::default() }.text()
}

/// Returns the `Telemetry` hooks of a vehicle with these streams.
fn telemetry(list: &str) -> String {
    format!(
        "impl Telemetry for Rover {{
             const STREAMS: &'static [Stream] = &[{list}];
             fn fill(&mut self, _: u32, _: &mut Fill<'_>) -> bool {{ false }}
         }}"
    )
}

/// Returns a firmware with these entries that sends this message.
fn sends(message: &str, entries: &str) -> String {
    let main = format!("let _ = stack.send::<{message}>(Destination::All, 0);");
    Firmware { hooks: &telemetry(""), entries, main: &main, ..Firmware::default() }.text()
}

/// A vehicle that declares a command like this, without slots.
fn policy(policy: &str) -> String {
    Firmware { policies: &policies(policy), entries: "links: 1", ..Firmware::default() }.text()
}

/// The declarations of a vehicle's commands: one.
fn policies(policy: &str) -> String {
    format!(
        "const POLICIES: &'static [command::CommandPolicy] = &[
             command::CommandPolicy::new(rules::NAV_TAKEOFF),
             command::CommandPolicy::new(rules::DO_REPEAT_SERVO){policy},
         ];"
    )
}

/// Returns the `Modes` hooks of a vehicle with these flight modes.
fn modes(list: &str) -> String {
    format!(
        "impl Modes for Rover {{
             const MODES: &'static [FlightMode] = &[{list}];
             fn set_mode(&mut self, _: &mut Context<'_>, _: &'static FlightMode, _: &ModeRequest) -> Outcome {{
                 MavResult::UNSUPPORTED.into()
             }}
         }}"
    )
}

/// The name of a firmware, its text, and a part of the compiler's message; the part is empty if the firmware is valid.
type Case = (&'static str, String, &'static str);

/// Returns the invalid firmwares.
fn cases() -> Vec<Case> {
    let config = |system, component| {
        constant(&format!("const CONFIG: Config = Config::new(Address::new({system}, {component}), &PULSE);"))
    };
    let address = "a system id is 1 to 254 (255: ground stations), a component id 1 to 255";
    let links = "a stack has 1 to 16 links";
    let form = "write stack! { pub struct Mavlink for Rover { links: 1 } }";
    let once = "`once` and `once_per_press` need slots: add `commands: { slots: 2 }` to `stack!`";
    let streams = |list: &str| implements(&telemetry(list), "links: 1, streams");
    let announces = |command, main| {
        let hooks = &telemetry("Stream::of::<Attitude>()");
        Firmware { command, hooks, entries: "links: 1, streams", main, ..Firmware::default() }.text()
    };
    let modes = |list: &str| implements(&modes(list), "links: 1, modes");
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
        ("no_vehicle", constant("stack! { struct Mavlink { links: 1 } }"), form),
        ("no_struct", constant("struct Rover; stack! { Mavlink for Rover: links: 1 }"), form),
        (
            "entry_unknown",
            declares("links: 1, telemetry"),
            "`telemetry` is no entry of a stack, or not written like this",
        ),
        (
            "entry_form",
            declares("links: 1, commands: 2"),
            "`commands` is no entry of a stack, or not written like this",
        ),
        ("entry_twice", declares("links: 1, peers: 4, links: 2"), "`links` is given twice in `stack!`: remove one"),
        ("flag_twice", declares("links: 1, time, texts: 2, time"), "`time` is given twice in `stack!`: remove one"),
        (
            "entry_twice_in_two_forms",
            declares("links: 1, forwarding, forwarding: { bytes: 512 }"),
            "`forwarding` is given twice in `stack!`: remove one",
        ),
        ("links_missing", declares("peers: 8"), "say how many links the vehicle has: `links: 1`"),
        ("links_0", declares("links: 0"), links),
        ("links_17", declares("links: 17"), links),
        ("peers_0", declares("links: 1, peers: 0"), "a stack needs room for a peer: `peers: 8` will do for most"),
        ("items_65535", implements(PLANS, "links: 1, plans: { mission: 65_535 }"), "a plan has at most 65,534 items"),
        (
            "items_0",
            implements(PLANS, "links: 1, plans: { mission: 0 }"),
            "plan memory without room for an item: leave `plans` out",
        ),
        ("items_order", implements(PLANS, "links: 1, plans: { rally: 16 }"), "fence and rally may be left out"),
        (
            "staging",
            constant("const PLANS: PlanBuffers<9, 0, 0, 8> = PlanBuffers::new();"),
            "the staging area is as large as the largest plan: use plan_memory!",
        ),
        (
            "queue_285",
            declares("links: 2, forwarding: { bytes: 285, seen: 64 }"),
            "a queue must hold the longest frame: 286 bytes, as in `forwarding: { bytes: 512 }`",
        ),
        ("queue_links", declares("links: 1, forwarding"), "with one link, leave `forwarding` out"),
        (
            "queue_memory",
            declares("links: 2, forwarding: { seen: 0 }"),
            "what was forwarded must be remembered: `forwarding: { seen: 256 }`",
        ),
        (
            "slots_0",
            declares("links: 1, commands: { slots: 0 }"),
            "command memory needs a place: `commands: { slots: 2 }`, or leave `commands` out",
        ),
        ("once", policy(".once()"), once),
        ("once_per_press", policy(".no_broadcast().once_per_press()"), once),
        (
            "signing_0",
            declares("links: 1, signing: { streams: 0 }"),
            "no sender could ever be verified: `signing: { streams: 16 }`",
        ),
        ("streams_33", streams(&"Stream::of::<Attitude>(),".repeat(33)), "a vehicle declares at most 32 messages"),
        (
            "streams_twice",
            streams("Stream::of::<Attitude>(), Stream::of::<Attitude>()"),
            "a message is twice in `STREAMS`",
        ),
        ("streams_heartbeat", streams("Stream::of::<Heartbeat>()"), "the stack sends this message by itself"),
        (
            "streams_of_modes",
            implements(
                &(telemetry("Stream::of::<CurrentMode>()") + &self::modes("FlightMode::new(1, \"A\")")),
                "links: 1, streams, modes",
            ),
            "the stack sends this message by itself: see `MODES`",
        ),
        (
            "announce",
            announces("", "stack.announce::<VfrHud>()"),
            "the vehicle does not declare this message in `STREAMS`",
        ),
        (
            "announce_in_a_hook",
            announces("cx.announce::<VfrHud, Self>();", ""),
            "the vehicle does not declare this message in `STREAMS`",
        ),
        (
            "client_0",
            implements(CLIENT, "links: 1, command_client: { slots: 0 }"),
            "a command needs a slot: `command_client: { slots: 2 }`",
        ),
        ("client", implements(CLIENT, "links: 1, command_client: { slots: 2 }"), ""),
        (
            "client_without_hooks",
            declares("links: 1, command_client: { slots: 2 }"),
            "does not implement `CommandClient`",
        ),
        (
            "read_param",
            Firmware {
                hooks: CLIENT,
                entries: "links: 1, command_client: { slots: 1 }",
                main: "let _ = stack.read_param(Address::new(1, 154), 0);",
                ..Firmware::default()
            }
            .text(),
            "the vehicle reads no parameters of others: set `READS_PARAMS`",
        ),
        ("files", implements(FILES, "links: 1, files: { sessions: 2, upload: 64 }"), ""),
        (
            "files_0",
            implements(FILES, "links: 1, files: { sessions: 0 }"),
            "a client needs a session: `files: { sessions: 2 }`",
        ),
        (
            "files_upload",
            implements(FILES, "links: 1, files: { sessions: 1, upload: 70_000 }"),
            "an upload has less than 65,536 bytes",
        ),
        (
            "files_upload_plans",
            implements(
                &[FILES, PLANS].concat(),
                "links: 1, plans: { mission: 1 }, files: { sessions: 1, upload: 275 }",
            ),
            "plans as files need `upload: 276` or more",
        ),
        (
            "files_path",
            implements(&FILES.replace("a.txt", "/a.txt"), "links: 1, files: { sessions: 1 }"),
            "the path of a static file has 1 to 200 bytes",
        ),
        (
            "files_name",
            implements(&FILES.replace("a.txt", "\u{e4}"), "links: 1, files: { sessions: 1 }"),
            "the path of a static file is printable ASCII",
        ),
        ("files_without_hooks", declares("links: 1, files: { sessions: 1 }"), "does not implement `Files`"),
        (
            "files_twice",
            implements(FILES, "files: { sessions: 1 }, links: 1, files: { sessions: 1 }"),
            "`files` is given twice in `stack!`",
        ),
        ("components", components(&[154, 100]), ""),
        ("components_0", components(&[0]), "give each of `COMPONENTS` an id of its own"),
        ("components_twice", components(&[154, 100, 154]), "two of `COMPONENTS` have the same id"),
        (
            "components_4",
            components(&[154, 100, 171, 172]),
            "a firmware has at most 3 components besides the autopilot",
        ),
        ("components_without_hooks", declares("links: 1, components"), "does not implement `Components`"),
        ("send", sends("Tunnel", "links: 1, messages"), ""),
        (
            "send_heartbeat",
            sends("Heartbeat", "links: 1, messages"),
            "the stack sends this message by itself: it cannot be sent by the vehicle",
        ),
        ("send_undeclared", sends("Tunnel", "links: 1"), "Messages"),
        ("messages_without_telemetry", declares("links: 1, messages"), "does not implement `Telemetry`"),
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
        (
            "hook_vehicle",
            constant("struct Rover; stack! { struct Mavlink for Rover { links: 1 } }"),
            "a vehicle of `stack!` needs `impl Vehicle for Rover`",
        ),
        (
            "hook_commands",
            constant(
                "struct Rover;
                 impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
                 stack! { struct Mavlink for Rover { links: 1 } }",
            ),
            "a vehicle of `stack!` needs `impl Commands for Rover`",
        ),
        (
            "hook_plans",
            declares("links: 1, plans: { mission: 9 }"),
            "`plans` in `stack!` needs `impl Plans for Rover`: write it, or leave `plans` out",
        ),
        (
            "hook_streams",
            declares("links: 1, streams"),
            "`streams` in `stack!` needs `impl Telemetry for Rover`: write it, or leave `streams` out",
        ),
        (
            "hook_modes",
            declares("links: 1, modes"),
            "`modes` in `stack!` needs `impl Modes for Rover`: write it, or leave `modes` out",
        ),
        (
            "hook_gimbal_manager",
            declares("links: 1, gimbal_manager"),
            "`gimbal_manager` in `stack!` needs `impl GimbalManager for Rover`: write it, or leave `gimbal_manager` out",
        ),
        (
            "hook_gimbal_device",
            declares("links: 1, gimbal_device"),
            "`gimbal_device` in `stack!` needs `impl GimbalDevice for Rover`: write it, or leave `gimbal_device` out",
        ),
        (
            "manager_of_no_device",
            implements(&gimbal("const DEVICE: u8 = 0;", ""), "links: 1, gimbal_manager"),
            "`GimbalManager::DEVICE` is 1 to 6, or the component id of the gimbal device",
        ),
        (
            "manager_of_no_component",
            implements(&gimbal("const DEVICE: u8 = 6; const IS_REMOTE: bool = true;", ""), "links: 1, gimbal_manager"),
            "a remote gimbal device has a component id above 6",
        ),
        (
            "gimbal_device_id",
            implements(&gimbal("const DEVICE: u8 = 1;", "const ID: u8 = 7;"), "links: 1, gimbal_device"),
            "`GimbalDevice::ID` is 0, or 1 to 6 for a gimbal that is no component of its own",
        ),
        (
            "gimbal_device_of_no_component",
            implements(
                &gimbal(
                    "const DEVICE: u8 = 154;",
                    "const COMPONENT: Option<message::ComponentId> = Some(message::ComponentId(154));",
                ),
                "links: 1, gimbal_device",
            ),
            "`GimbalDevice::COMPONENT` is no component of the firmware: name it in `Components::COMPONENTS`",
        ),
        (
            "gimbal_device_twice",
            implements(
                &gimbal(
                    "const DEVICE: u8 = 1;",
                    "const ID: u8 = 1;
                     const COMPONENT: Option<message::ComponentId> = Some(message::ComponentId(154));",
                ),
                "links: 1, gimbal_device",
            ),
            "a gimbal that is a component of its own has the `GimbalDevice::ID` 0",
        ),
        (
            "hook_parameters",
            implements("parameters! { struct Tuning { A: u8 = 0, 0..=1, \"\"; } }", "links: 1, parameters: Tuning"),
            "`parameters` in `stack!` needs `impl Parameters for Rover`: write it, or leave `parameters` out",
        ),
        (
            "hook_checks",
            declares("links: 1, events: { history: 16, checks }"),
            "`checks` in `events` of `stack!` needs `impl HealthChecks for Rover`: write it, or leave `checks` out",
        ),
        (
            "events_without_history",
            declares("links: 1, events: { history: 0 }"),
            "the history of events has at least one: `events: { history: 16 }`",
        ),
        (
            "events_too_many",
            declares("links: 1, events: { history: 1_001 }"),
            "the history of events is at most 1,000 long: `events: { history: 20 }` is PX4's",
        ),
        (
            "events_twice",
            constant("events! { struct Twice in \"a\" { events { ALow(Info) = \"a\"; A_low(Info) = \"b\"; } } }"),
            "two events have the same name, or names with the same hash: rename one of them",
        ),
        (
            "event_without_argument",
            constant("events! { struct Place in \"a\" { events { Low(Info) { x: u8 } = \"{2}\"; } } }"),
            "a text shows an argument as `{1}` or `{2:.1m}`, counted from 1; put a backslash before any other brace",
        ),
        (
            "event_with_text",
            constant("events! { struct Text in \"a\" { events { Low(Info) { x: f64 } = \"{1}\"; } } }"),
            "`f64` cannot be an argument of an event",
        ),
        (
            "hook_camera",
            declares("links: 1, camera"),
            "`camera` in `stack!` needs `impl Camera for Rover`: write it, or leave `camera` out",
        ),
        (
            "hook_ext_parameters",
            declares("links: 1, ext_parameters"),
            "`ext_parameters` in `stack!` needs `impl ExtParameters for Rover`: write it, or leave `ext_parameters` out",
        ),
        (
            "hook_logs",
            declares("links: 1, logs"),
            "`logs` in `stack!` needs `impl Logs for Rover`: write it, or leave `logs` out",
        ),
        (
            "hook_log_streaming",
            declares("links: 1, log_streaming"),
            "`log_streaming` in `stack!` needs `impl LogStreaming for Rover`: write it, or leave `log_streaming` out",
        ),
        (
            "camera_without_images",
            implements(CAMERA, "links: 1, camera: { images: 0 }"),
            "a camera remembers at least one image: `camera: { images: 16 }`",
        ),
        (
            "camera_of_no_component",
            implements(CAMERA_100, "links: 1, camera"),
            "a service has a `COMPONENT` that the firmware does not: add it to `COMPONENTS`",
        ),
        (
            "other_table",
            implements(
                &(PARAMETERS.to_owned() + "parameters! { struct Other { A: u8 = 0, 0..=1, \"\"; } }"),
                "links: 1, parameters: Other",
            ),
            "<Rover as Parameters>::Table == Other",
        ),
        (
            "hook_backend",
            implements("", "links: 1, parameters: mavstack::param::ExternalParams<9>"),
            "`parameters: ExternalParams<N>` in `stack!` needs `impl ParamBackend for Rover`",
        ),
        (
            "hook_run_time_table",
            implements("", "links: 1, parameters: mavstack::param::RuntimeTable<9>"),
            "`parameters` in `stack!` needs `impl Parameters for Rover`: write it, or leave `parameters` out",
        ),
        (
            "run_time_table_without_room",
            implements(
                "impl Parameters for Rover { type Table = mavstack::param::RuntimeTable<0>; }",
                "links: 1, parameters: mavstack::param::RuntimeTable<0>",
            ),
            "a run-time table has room for 1 to 32,768 parameters: `RuntimeTable<64>`",
        ),
        (
            "backend_without_room",
            implements(BACKEND, "links: 1, parameters: mavstack::param::ExternalParams<0>"),
            "a backend has 1 to 32,768 parameters: `ExternalParams<64>`",
        ),
        (
            "calls_parameters_of_a_backend",
            Firmware {
                hooks: BACKEND,
                entries: "links: 1, parameters: mavstack::param::ExternalParams<9>",
                main: "stack.parameters_mut();",
                ..Firmware::default()
            }
            .text(),
            "ExternalParams<9>: ParamTable`",
        ),
        ("no_table", implements("struct Tuning;", "links: 1, parameters: Tuning"), "declare it with `parameters!`"),
        ("calls_commands", calls("stack.long_commands_mut();"), "Declares>::Commands = "),
        ("calls_plans", calls("stack.mission_item_reached(Instant::ZERO, 0);"), "Declares>::Mission = "),
        ("calls_parameters", calls("stack.parameters_mut();"), "NoParams: ParamTable`"),
        ("calls_time", calls("stack.ask_time(LinkId(0));"), "Declares>::Time = "),
        ("calls_manual_control", calls("stack.manual_input_mut();"), "Declares>::ManualControl = "),
        ("calls_setpoints", calls("stack.setpoints_mut();"), "Declares>::Setpoints = "),
        ("calls_operator_control", calls("stack.operator_control_mut();"), "Declares>::OperatorControl = "),
        ("calls_camera", calls("stack.camera_mut();"), "Declares>::Camera = "),
        ("calls_ext_parameters", calls("stack.ext_parameters_mut();"), "Declares>::ExtParameters = "),
        ("calls_logs", calls("stack.logs();"), "Declares>::Logs = "),
        ("calls_log_streaming", calls("stack.log_streaming();"), "Declares>::LogStreaming = "),
        ("calls_gimbal_manager", calls("stack.release_gimbal();"), "Declares>::GimbalManager = "),
        ("calls_gimbal_device", calls("stack.gimbal_device();"), "Declares>::GimbalDevice = "),
        ("calls_high_latency", calls("stack.high_latency_mut();"), "Declares>::HighLatency = "),
        ("calls_forwarding", calls("stack.forward_counters(LinkId(0));"), "Declares>::Forwarding = "),
        ("calls_signing", calls("stack.signing_mut();"), "Declares>::Signing = "),
        ("calls_streams", calls("stack.announce::<Attitude>();"), "Declares>::Stream = "),
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
            Firmware {
                vehicle: "const MESSAGES: MessageTable = <D as Dialect>::MESSAGES;",
                hooks: "message! { struct M: M = 53_000 { a: u8, } } dialect! { struct D: [M]; }",
                entries: "links: 1",
                ..Firmware::default()
            }
            .text(),
            "put all of common beside your own",
        ),
    ]
}

/// Writes a package with a firmware for each case, which Cargo builds against this crate.
fn package(cases: &[Case]) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("refused");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest = format!(
        "[package]\nname = \"refused\"\nversion = \"0.0.0\"\nedition = \"2024\"\n\n\
         [features]\ndefault = [\"signing\"]\nsigning = [\"mavstack/signing\"]\n\n\
         [dependencies]\nmavstack = {{ path = {:?}, features = [\"embedded-io-async\"] }}\n\n[profile.dev]\ndebug = 0\n\n[workspace]\n",
        root.display().to_string()
    );
    // Remove the files of earlier runs of this test.
    let _ = std::fs::remove_dir_all(folder.join("src"));
    std::fs::create_dir_all(folder.join("src/bin")).expect("a folder");
    std::fs::write(folder.join("Cargo.toml"), manifest).expect("written");
    std::fs::copy(root.join("Cargo.lock"), folder.join("Cargo.lock")).expect("the lock file");
    for (name, text, _) in cases {
        std::fs::write(folder.join(format!("src/bin/{name}.rs")), text).expect("written");
    }
    folder
}

/// Returns Cargo's output: a line of JSON for each message and each firmware that was built.
fn cargo(folder: &Path, arguments: &[&str]) -> Vec<String> {
    let output = Command::new(env!("CARGO"))
        .args(arguments)
        .args(["--quiet", "--message-format", "json"])
        .current_dir(folder)
        .env("CARGO_TARGET_DIR", folder.join("target"))
        .env_remove("RUSTFLAGS")
        .output()
        .expect("cargo runs");
    let lines = String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect::<Vec<_>>();
    assert!(!lines.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
    lines
}

/// Appends the cases to `wrong` for which Cargo's output differs from the expected one.
fn judge(cases: &[Case], lines: &[String], wrong: &mut String) {
    for (name, _, says) in cases {
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
}

#[test]
fn invalid_configurations_do_not_compile() {
    let everything =
        "links: 2, plans: { mission: 9 }, parameters: Tuning, streams, modes, commands: { slots: 1 }, forwarding,
                      signing, time, manual_control, setpoints, operator_control, camera, ext_parameters, gimbal_manager,
                      gimbal_device, high_latency, logs, log_streaming,
                      peers: 1, texts: 0";
    let gimbal = gimbal("const DEVICE: u8 = 1;", "const ID: u8 = 1;");
    let hooks = [
        PLANS,
        PARAMETERS,
        CAMERA,
        EXT_PARAMETERS,
        LOGS,
        LOG_STREAMING,
        &telemetry("Stream::of::<Attitude>()"),
        &modes("FlightMode::new(1, \"A\")"),
        &gimbal,
    ]
    .concat();
    let main = "stack.announce::<Attitude>(); stack.ask_time(LinkId(1)); stack.forward_counters(LinkId(1));
                stack.long_commands_mut(); stack.parameters_mut(); stack.manual_input_mut(); stack.setpoints_mut();
                stack.operator_control_mut(); stack.camera_mut(); stack.ext_parameters_mut();
                stack.gimbal_manager(); stack.gimbal_device(); stack.release_gimbal();
                stack.point_gimbal(Instant::ZERO, &Item::default(), &mut Rover);
                stack.high_latency_mut(); stack.logs(); stack.log_streaming();
                stack.signing_mut(); stack.mission_item_reached(Instant::ZERO, 0);";
    let once = &policies(".once()");
    let right = Firmware { policies: once, hooks: &hooks, entries: everything, main, ..Firmware::default() };
    let signs = || declares("links: 1, signing");
    let calls = |main| Firmware { entries: "links: 1", main, ..Firmware::default() }.text();
    let mut cases = cases();
    cases.push((
        "receiver_0",
        calls("mavstack::io::AsyncReceiver::new(&[0_u8][..], &mut []);"),
        "the buffer of a receiver must hold bytes: `[0; 64]`",
    ));
    cases.push((
        "transmitter_0",
        calls("mavstack::io::AsyncTransmitter::new(&mut [0_u8][..], &mut []);"),
        "the buffer of a transmitter must hold bytes: `[0; 64]`",
    ));
    cases.extend([("right", right.text(), ""), ("least", declares("links: 1"), "")]);
    cases.extend([("policy", policy(".no_broadcast()"), ""), ("signs", signs(), "")]);
    let folder = package(&cases);
    let mut wrong = String::new();
    judge(&cases, &cargo(&folder, &["build", "--bins", "--keep-going"]), &mut wrong);
    let unsigned = [("signs", signs(), "`signing` in `stack!` needs the feature `signing` of mavstack")];
    judge(&unsigned, &cargo(&folder, &["check", "--no-default-features", "--bin", "signs"]), &mut wrong);
    assert!(wrong.is_empty(), "{wrong}");
}
