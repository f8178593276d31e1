//! Invalid configurations do not compile, and the compiler's message says what is wrong. Each case is a firmware and a part of
//! the expected message. Valid firmwares must compile.

mod cases;

use cases::cases;
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
#[derive(Stack)]
#[stack(vehicle: Rover, {entries})]
struct Mavlink {{fields}}
fn main() {
    let mut stack = StackOf::<Mavlink>::new(CONFIG, std::array::from_fn(|_| UART));
    stack.poll(Instant::ZERO, &mut Rover);
    stack.receive(Instant::ZERO, LinkId(0), &[0], &mut Rover);
    stack.transmit(Instant::ZERO, LinkId(0), &mut Rover);
    {main}
}
"#;

/// The hooks that every vehicle has.
const HOOKS: &str = "
struct Rover;
impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
impl Commands for Rover {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
}
";

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
    let list: Vec<_> = ids
        .iter()
        .map(|id| format!("Component::new(mavstack::message::ComponentId::new({id}), MavType::GIMBAL)"))
        .collect();
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
    const COMPONENT: Option<mavstack::message::ComponentId> = Some(mavstack::message::ComponentId::new(100));
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;
    fn camera_information(&self, _: &mut CameraInformation) {}
    fn take_image(&mut self, _: &mut Context<'_>, _: u32) -> mavstack::camera::Shot { mavstack::camera::Shot::Failed }
}
";

const EXT_PARAMETERS: &str = "
impl ExtParameters for Rover {
    fn ext_param_count(&self) -> u16 { 0 }
    fn ext_param(&self, _: u16) -> Option<(&str, mavstack::ext_parameters::ExtValue<'_>)> { None }
    fn set_ext_param(&mut self, _: &mut Context<'_>, _: u16, _: mavstack::ext_parameters::ExtValue<'_>, _: mavstack::Peer) -> ParamAck {
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
    fields: &'a str,
    main: &'a str,
}

impl Firmware<'_> {
    fn text(self) -> String {
        let Self { vehicle, policies, command, hooks, entries, fields, main } = self;
        let text = FIRMWARE.replace("{vehicle}", vehicle).replace("{policies}", policies);
        let text = text.replace("{command}", command).replace("{hooks}", hooks);
        format!("{FRONT}{}", text.replace("{entries}", entries).replace("{fields}", fields).replace("{main}", main))
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

/// Returns a firmware with these traits whose stack has this field.
fn has(hooks: &str, field: &str) -> String {
    Firmware { hooks, entries: "links: 1", fields: field, ..Firmware::default() }.text()
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
        "links: 2, plans: { mission: 1 << 3, fence: 2 }, parameters: Tuning, streams, modes, commands: { slots: 1 }, forwarding,
                      signing, manual_control, operator_control, logs, peers: 1, texts: 0";
    let fields =
        "time: clock::Time, setpoints: setpoints::Setpoints, camera: camera::CameraControl<[camera::Image; 1]>,
                  ext_parameters: ext_parameters::ExtParamServer, gimbal_manager: gimbal::ManagerService,
                  gimbal_device: gimbal::DeviceService, high_latency: high_latency::HighLatency,
                  log_streaming: logs::LogStreamer";
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
    let main = "stack.announce::<Attitude>(); stack.time.ask(LinkId(1)); stack.forward_counters(LinkId(1));
                stack.long_commands_mut(); stack.parameters_mut(); stack.manual_input_mut(); stack.setpoints.counters();
                stack.operator_control_mut(); stack.camera.image_count(); stack.gimbal_device.counters();
                stack.with_services(Instant::ZERO, &mut Rover, |services, cx| {
                    services.gimbal_manager.point(cx, &Item::default())
                });
                stack.high_latency.counters(); stack.logs(); stack.log_streaming.counters();
                stack.signing_mut(); stack.mission_item_reached(Instant::ZERO, 0);";
    let once = &policies(".once()");
    let right = Firmware { policies: once, hooks: &hooks, entries: everything, fields, main, ..Firmware::default() };
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
    let unsigned = [("signs", signs(), "`signing` in `#[stack]` needs the feature `signing` of mavstack")];
    judge(&unsigned, &cargo(&folder, &["check", "--no-default-features", "--bin", "signs"]), &mut wrong);
    assert!(wrong.is_empty(), "{wrong}");
}
