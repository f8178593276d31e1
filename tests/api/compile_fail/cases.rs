//! The invalid firmwares, and what the compiler says of each.

use super::*;

/// Tables of parameters with one wrong row: its name is too long, it is out of order, or its default is outside its range.
const LONG: &str = "ALT: u8 = 0, 0..=1, \"\";\nA_NAME_OF_17_BYTE: u8 = 0, 0..=1, \"\";";
const UNSORTED: &str = "BAT: u8 = 0, 0..=1, \"\";\nALT: u8 = 0, 0..=1, \"\";\nSPEED: u8 = 0, 0..=1, \"\";";
const OUTSIDE: &str = "ALT: u8 = 0, 0..=1, \"\";\nBAT: u8 = 2, 0..=1, \"\";\nSPEED: u8 = 0, 0..=1, \"\";";

/// Returns the invalid firmwares.
pub fn cases() -> Vec<Case> {
    let config = |system, component| {
        constant(&format!("const CONFIG: Config = Config::new(Address::new({system}, {component}), &PULSE);"))
    };
    let address = "a system id is 1 to 254 (255: ground stations), a component id 1 to 255";
    let links = "a stack has 1 to 16 links";
    let once = "`once` and `once_per_press` need slots: add `commands: { slots: 2 }` to `#[stack]`";
    let streams = |list: &str| implements(&telemetry(list), "links: 1, streams");
    let announces = |command, main| {
        let hooks = &telemetry("Stream::of::<Attitude>()");
        Firmware { command, hooks, entries: "links: 1, streams", main, ..Firmware::default() }.text()
    };
    let modes = |list: &str| implements(&modes(list), "links: 1, modes");
    let parameters = |list: &str| constant(&format!("parameters! {{ pub struct Tuning {{ {list} }} }}"));
    let attribute = |row: &str, attributes: &str| {
        parameters(&format!("ALT: u8 = 0, 0..=1, \"\";\nBAT: {row}, \"\" {{ {attributes} }};"))
    };
    let many: String = (0..33).fold(String::new(), |mut list, mode| {
        let _ = write!(list, "FlightMode::new({mode}, \"M\"),");
        list
    });
    vec![
        ("system_0", config(0, 1), address),
        ("system_255", config(255, 1), address),
        ("component_0", config(1, 0), address),
        ("baud_0", constant("const LINK: LinkConfig = LinkConfig::uart(0);"), "a UART has a baud rate"),
        ("rate_0", constant("const LINK: LinkConfig = LinkConfig::limited(0);"), "a limited link has a rate"),
        (
            "budget",
            constant("const BUDGET: PollBudget = PollBudget::for_link(3_000_000, Duration::from_secs(600));"),
            "poll the link more often",
        ),
        (
            "no_vehicle",
            constant("#[derive(Stack)] #[stack(links: 1)] struct Mavlink;"),
            "`#[stack(vehicle: Rover, links: 1)]` is missing: say it above the struct",
        ),
        (
            "no_struct",
            constant("struct Rover; #[derive(Stack)] #[stack(vehicle: Rover, links: 1)] enum Mavlink {}"),
            "`Stack` is derived for a struct: its fields are the services",
        ),
        (
            "tuple_struct",
            constant("struct Rover; #[derive(Stack)] #[stack(vehicle: Rover, links: 1)] struct Mavlink(u8);"),
            "`Mavlink` must have named fields and no parameters",
        ),
        (
            "field_is_no_service",
            constant(&(HOOKS.to_owned() + "#[derive(Stack)] #[stack(vehicle: Rover, links: 1)] struct Mavlink { depth: u8 }")),
            "`u8` is no service of this vehicle",
        ),
        (
            "entry_unknown",
            declares("links: 1, telemetry"),
            "`telemetry` is no entry of a stack. These are: `vehicle`, `links`",
        ),
        (
            "entry_form",
            declares("links: 1, commands: 2"),
            "write `commands: { slots: 2 }`",
        ),
        ("entry_no_name", declares("links: 1, 5"), "an entry begins with its name"),
        ("size_unknown", implements(PLANS, "links: 1, plans: { mission: 4, fenc: 3 }"), "`plans` has no `fenc`: write"),
        ("size_without_value", implements(PLANS, "links: 1, plans: { mission, fence: 4 }"), "write `plans: { mission: 100"),
        ("size_with_value", declares("links: 1, events: { history: 16, checks: 5 }"), "write `events: { history: 16, checks }`"),
        ("size_misspelt", declares("links: 1, events: { history: 16, check }"), "`events` has no `check`: write"),
        ("entry_open", declares("links: 1 << 3, peers: 4"), "a `<` of `links` has no `>`"),
        ("entry_twice", declares("links: 1, peers: 4, links: 2"), "`links` is given twice: remove one"),
        ("flag_twice", declares("links: 1, modes, texts: 2, modes"), "`modes` is given twice: remove one"),
        (
            "entry_twice_in_two_forms",
            declares("links: 1, forwarding, forwarding: { bytes: 512 }"),
            "`forwarding` is given twice: remove one",
        ),
        ("links_missing", declares("peers: 8"), "`#[stack(vehicle: Rover, links: 1)]` is missing"),
        ("links_0", declares("links: 0"), links),
        ("links_17", declares("links: 17"), links),
        ("peers_0", declares("links: 1, peers: 0"), "a stack needs room for a peer: `peers: 8` will do for most"),
        ("items_65535", implements(PLANS, "links: 1, plans: { mission: 65_535 }"), "a plan has at most 65,534 items"),
        (
            "items_0",
            implements(PLANS, "links: 1, plans: { mission: 0 }"),
            "plan memory without room for an item: leave `plans` out",
        ),
        ("items_order", implements(PLANS, "links: 1, plans: { rally: 16 }"), "write `plans: { mission: 100, fence: 64, rally: 16 }`"),
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
            "forwarded frames must be remembered: `forwarding: { seen: 256 }`",
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
        (
            "files_parent",
            implements(&FILES.replace("a.txt", "a/../b"), "links: 1, files: { sessions: 1 }"),
            "no part of the path of a static file is `..`",
        ),
        (
            "files_empty_part",
            implements(&FILES.replace("a.txt", "a//b"), "links: 1, files: { sessions: 1 }"),
            "no part of the path of a static file is `..`, `.` or empty",
        ),
        (
            "files_drive",
            implements(&FILES.replace("a.txt", "C:a"), "links: 1, files: { sessions: 1 }"),
            "the path of a static file is printable ASCII without backslashes and colons",
        ),
        ("files_without_hooks", declares("links: 1, files: { sessions: 1 }"), "does not implement `Files`"),
        (
            "files_twice",
            implements(FILES, "files: { sessions: 1 }, links: 1, files: { sessions: 1 }"),
            "`files` is given twice",
        ),
        ("components", components(&[154, 100]), ""),
        ("components_0", components(&[0]), "give each of `COMPONENTS` an id of its own"),
        ("components_twice", components(&[154, 100, 154]), "two of `COMPONENTS` have the same id"),
        (
            "components_4",
            components(&[154, 100, 171, 172]),
            "a firmware has at most 3 components besides the autopilot",
        ),
        (
            "components_with_a_stream",
            implements(
                &(telemetry("Stream::of::<Attitude>().of_component(mavstack::message::ComponentId::new(154))")
                    + "impl Components for Rover {
                           const COMPONENTS: &'static [Component] =
                               &[Component::new(mavstack::message::ComponentId::new(154), MavType::GIMBAL)];
                           const OPTIONAL: bool = true;
                       }"),
                "links: 1, streams, components",
            ),
            "a stream of a component that is `Components::OPTIONAL`",
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
        ("param_name", parameters(LONG), "the name of the parameter `A_NAME_OF_17_BYTE` is not valid"),
        // The error is shown at the row, which is in the line behind that of `parameters!`.
        ("param_name_row", parameters(LONG), "param_name_row.rs:10:"),
        ("param_reserved", parameters("_HASH_CHECK: u8 = 0, 0..=1, \"\";"), "the parameter `_HASH_CHECK` is not valid"),
        ("param_twice", parameters("A: u8 = 0, 0..=1, \"\"; A: u8 = 0, 0..=1, \"\";"), "each name once"),
        ("param_order", parameters(UNSORTED), "the parameter `ALT` is not in order"),
        ("param_order_row", parameters(UNSORTED), "param_order_row.rs:10:"),
        ("param_default", parameters(OUTSIDE), "the default of the parameter `BAT` is not within its range"),
        ("param_default_row", parameters(OUTSIDE), "param_default_row.rs:10:"),
        ("param_values", attribute("i32 = 0, 0..=1", "values: { 0 => \"Off\", 2 => \"On\" }"), "the `values` of the parameter `BAT`"),
        ("param_values_twice", attribute("i32 = 0, 0..=1", "values: { 0 => \"Off\", 0 => \"On\" }"), "`values` of the parameter `BAT`"),
        // The error is shown at the row, as those above.
        ("param_values_row", attribute("i32 = 0, 0..=1", "values: { 2 => \"On\" }"), "param_values_row.rs:10:"),
        ("param_values_type", attribute("u8 = 0, 0..=1", "values: { -1 => \"Off\" }"), "cannot apply unary operator `-` to type `u8`"),
        ("param_values_form", attribute("u8 = 0, 0..=1", "values: { 0 = \"Off\" }"), "invalid left-hand side of assignment"),
        ("param_bitmask", attribute("i32 = 0, 0..=7", "bitmask: { 3 => \"Sonar\" }"), "the `bitmask` of the parameter `BAT`"),
        ("param_bitmask_32", attribute("i32 = 0, 0..=7", "bitmask: { 32 => \"Sonar\" }"), "the `bitmask` of the parameter `BAT`"),
        ("param_bitmask_float", attribute("f32 = 0.0, 0.0..=7.0", "bitmask: { 0 => \"GPS\" }"), "the `bitmask` of the parameter `BAT`"),
        ("param_decimals", attribute("i32 = 0, 0..=7", "decimals: 2"), "the `decimals` or the `increment` of the parameter `BAT`"),
        ("param_increment", attribute("f32 = 0.0, 0.0..=7.0", "increment: 0.0"), "the `increment` of the parameter `BAT`"),
        ("param_unknown", attribute("i32 = 0, 0..=7", "hidden"), "no method named `hidden` found for struct `mavstack::__private::ParamAttributes`"),
        ("param_unknown_row", attribute("i32 = 0, 0..=7", "hidden"), "param_unknown_row.rs:10:"),
        ("param_system_255", attribute("u8 = 1, 1..=255", "system_id"), "the parameter `BAT` cannot be the system id"),
        ("param_system_0", attribute("u8 = 1, 0..=254", "system_id"), "255 is a ground station's"),
        ("param_system_float", attribute("f32 = 1.0, 1.0..=9.0", "system_id"), "the parameter `BAT` cannot be the system id"),
        ("param_system_volatile", attribute("u8 = 1, 1..=254", "system_id, volatile"), "`BAT` cannot be the system id"),
        (
            "param_system_twice",
            parameters("A: u8 = 1, 1..=9, \"\" { system_id }; B: u8 = 1, 1..=9, \"\" { system_id };"),
            "the parameter `A` cannot be the system id",
        ),
        (
            "hook_vehicle",
            constant("struct Rover; #[derive(Stack)] #[stack(vehicle: Rover, links: 1)] struct Mavlink;"),
            "a vehicle of `#[stack]` needs `impl Vehicle for Rover`",
        ),
        (
            "hook_commands",
            constant(
                "struct Rover;
                 impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
                 #[derive(Stack)] #[stack(vehicle: Rover, links: 1)] struct Mavlink;",
            ),
            "a vehicle of `#[stack]` needs `impl Commands for Rover`",
        ),
        (
            "hook_plans",
            declares("links: 1, plans: { mission: 9 }"),
            "`plans` in `#[stack]` needs `impl Plans for Rover`: write it, or leave `plans` out",
        ),
        (
            "hook_streams",
            declares("links: 1, streams"),
            "`streams` in `#[stack]` needs `impl Telemetry for Rover`: write it, or leave `streams` out",
        ),
        (
            "hook_modes",
            declares("links: 1, modes"),
            "`modes` in `#[stack]` needs `impl Modes for Rover`: write it, or leave `modes` out",
        ),
        (
            "hook_gimbal_manager",
            has("", "gimbal_manager: gimbal::ManagerService"),
            "`ManagerService` in the struct of a stack needs `impl GimbalManager for Rover`: write it, or leave the field out",
        ),
        (
            "hook_gimbal_device",
            has("", "gimbal_device: gimbal::DeviceService"),
            "`DeviceService` in the struct of a stack needs `impl GimbalDevice for Rover`: write it, or leave the field out",
        ),
        (
            "manager_of_no_device",
            has(&gimbal("const DEVICE: u8 = 0;", ""), "gimbal_manager: gimbal::ManagerService"),
            "`GimbalManager::DEVICE` is 1 to 6, or the component id of the gimbal device",
        ),
        (
            "manager_of_no_component",
            has(&gimbal("const DEVICE: u8 = 6; const IS_REMOTE: bool = true;", ""), "gimbal_manager: gimbal::ManagerService"),
            "a remote gimbal device has a component id above 6",
        ),
        (
            "gimbal_device_id",
            has(&gimbal("const DEVICE: u8 = 1;", "const ID: u8 = 7;"), "gimbal_device: gimbal::DeviceService"),
            "`GimbalDevice::ID` is 0, or 1 to 6 for a gimbal that is no component of its own",
        ),
        (
            "gimbal_device_of_no_component",
            has(
                &gimbal(
                    "const DEVICE: u8 = 154;",
                    "const COMPONENT: Option<message::ComponentId> = Some(message::ComponentId::new(154));",
                ),
                "gimbal_device: gimbal::DeviceService",
            ),
            "`GimbalDevice::COMPONENT` is no component of the firmware: name it in `Components::COMPONENTS`",
        ),
        (
            "gimbal_device_twice",
            has(
                &gimbal(
                    "const DEVICE: u8 = 1;",
                    "const ID: u8 = 1;
                     const COMPONENT: Option<message::ComponentId> = Some(message::ComponentId::new(154));",
                ),
                "gimbal_device: gimbal::DeviceService",
            ),
            "a gimbal that is a component of its own has the `GimbalDevice::ID` 0",
        ),
        (
            "hook_parameters",
            implements("parameters! { struct Tuning { A: u8 = 0, 0..=1, \"\"; } }", "links: 1, parameters: Tuning"),
            "`parameters` in `#[stack]` needs `impl Parameters for Rover`: write it, or leave `parameters` out",
        ),
        (
            "hook_checks",
            declares("links: 1, events: { history: 16, checks }"),
            "`checks` in `events` of `#[stack]` needs `impl HealthChecks for Rover`: write it, or leave `checks` out",
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
            "a text shows an argument as `{1}` or `{2:.1m}`, counted from 1, and from 3 in a check",
        ),
        (
            "check_with_place_of_modes",
            constant(
                "events! { struct Place in \"a\" { modes M { /** m */ A = [1] } components C { /** c */ B }
                    arming_checks { Low(Error) { x: u8 } = \"{1}\"; } } }",
            ),
            "counted from 1, and from 3 in a check",
        ),
        (
            "component_without_name",
            constant(
                "events! { struct Named in \"a\" { modes M { /** m */ A = [1] } components C { B } arming_checks {} } }",
            ),
            "an entry of an enumeration, of `modes` or of `components` needs a doc comment, which ground stations show",
        ),
        (
            "checks_without_history",
            implements(
                "events! { struct Checked in \"a\" { modes M { /** m */ A = [1] } components C { /** c */ B } arming_checks {} } }
                impl HealthChecks for Rover {
                    type Events = Checked;
                    fn checks(&self, _: &Context<'_>, _: &mut mavstack::events::HealthReport<'_>) {}
                }",
                "links: 1, events: { history: 7, checks }",
            ),
            "with `checks`, the history has at least 8 events",
        ),
        (
            "check_as_event",
            constant(
                "events! { struct Both in \"a\" { modes M { /** m */ A = [1] } components C { /** c */ B }
                    arming_checks { Low(Error) = \"low\"; } } }
                fn send(cx: &mut Context<'_>) { cx.event(&Low) }",
            ),
            "`Low` is not an event",
        ),
        (
            "event_as_check",
            constant(
                "events! { struct Both in \"a\" { modes M { /** m */ A = [1] } components C { /** c */ B }
                    arming_checks {} events { Low(Error) = \"low\"; } } }
                fn fail(report: &mut mavstack::events::HealthReport<'_>) { report.fails(M::A, C::B, &Low) }",
            ),
            "`Low` is not a check",
        ),
        (
            "event_with_text",
            constant("events! { struct Text in \"a\" { events { Low(Info) { x: f64 } = \"{1}\"; } } }"),
            "`f64` cannot be an argument of an event",
        ),
        (
            "hook_camera",
            has("", "camera: camera::CameraControl<[camera::Image; 16]>"),
            "`CameraControl` in the struct of a stack needs `impl Camera for Rover`: write it, or leave the field out",
        ),
        (
            "hook_ext_parameters",
            has("", "ext_parameters: ext_parameters::ExtParamServer"),
            "`ExtParamServer` in the struct of a stack needs `impl ExtParameters for Rover`: write it, or leave the field out",
        ),
        (
            "hook_logs",
            declares("links: 1, logs"),
            "`logs` in `#[stack]` needs `impl Logs for Rover`: write it, or leave `logs` out",
        ),
        (
            "hook_log_streaming",
            has("", "log_streaming: logs::LogStreamer"),
            "`LogStreamer` in the struct of a stack needs `impl LogStreaming for Rover`: write it, or leave the field out",
        ),
        (
            "camera_without_images",
            has(CAMERA, "camera: camera::CameraControl<[camera::Image; 0]>"),
            "a camera remembers at least one image: `CameraControl<[Image; 16]>`",
        ),
        (
            "camera_of_no_component",
            has(CAMERA_100, "camera: camera::CameraControl<[camera::Image; 16]>"),
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
            "`parameters: ExternalParams<N>` in `#[stack]` needs `impl ParamBackend for Rover`",
        ),
        (
            "hook_run_time_table",
            implements("", "links: 1, parameters: mavstack::param::RuntimeTable<9>"),
            "`parameters` in `#[stack]` needs `impl Parameters for Rover`: write it, or leave `parameters` out",
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
        ("calls_commands", calls("stack.long_commands_mut();"), "`commands: { slots: 2 }` is missing in `#[stack]`"),
        ("calls_plans", calls("stack.mission_item_reached(Instant::ZERO, 0);"), "`plans: { mission: 100 }` is missing in `#[stack]`"),
        ("calls_parameters", calls("stack.parameters_mut();"), "NoParams: ParamTable`"),
        ("calls_manual_control", calls("stack.manual_input_mut();"), "`manual_control` is missing in `#[stack]`"),
        ("calls_operator_control", calls("stack.operator_control_mut();"), "`operator_control` is missing in `#[stack]`"),
        ("calls_logs", calls("stack.logs();"), "`logs` is missing in `#[stack]`"),
        ("calls_a_field", calls("stack.time.ask(LinkId(0));"), "no field `time` on type"),
        (
            "field_as_entry",
            declares("links: 1, camera: { images: 16 }"),
            "`camera` is a field of the struct: `camera: mavstack::camera::CameraControl<[mavstack::camera::Image; 16]>`",
        ),
        ("link_number", calls("const GPS: LinkId = StackOf::<Mavlink>::link(1);"), "the stack has no link with that number"),
        ("calls_forwarding", calls("stack.forward_counters(LinkId(0));"), "`forwarding` is missing in `#[stack]`"),
        ("calls_signing", calls("stack.signing_mut();"), "`signing` is missing in `#[stack]`"),
        ("calls_streams", calls("stack.announce::<Attitude>();"), "`streams` is missing in `#[stack]`"),
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
