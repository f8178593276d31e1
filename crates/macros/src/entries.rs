//! The entries of `#[stack(…)]`: what each declares.

use proc_macro::{Span, TokenStream};

use crate::Mistake;
use crate::read::{Declaration, Row, placed, sizes};
use crate::write::{Values, fill, tokens};

/// All entries, each as it is written.
const ENTRIES: [&str; 21] = [
    "vehicle: Rover",
    "links: 1",
    "peers: 8",
    "texts: 4",
    "plans: { mission: 100, fence: 64, rally: 16 }",
    "parameters: Table",
    "storage: { records: 2 }",
    "signing: { streams: 16 }",
    "forwarding: { bytes: 512, seen: 256 }",
    "streams",
    "messages",
    "modes",
    "commands: { slots: 2 }",
    "command_client: { slots: 2 }",
    "components",
    "events: { history: 16, checks }",
    "logs",
    "manual_control",
    "operator_control",
    "files: { sessions: 2, upload: 276 }",
    "crate: mavstack",
];

/// The library's services that are fields, each with its type.
const FIELDS: [(&str, &str); 8] = [
    ("time", "clock::Time"),
    ("setpoints", "setpoints::Setpoints"),
    ("camera", "camera::CameraControl<[mavstack::camera::Image; 16]>"),
    ("ext_parameters", "ext_parameters::ExtParamServer"),
    ("gimbal_manager", "gimbal::ManagerService"),
    ("gimbal_device", "gimbal::DeviceService"),
    ("high_latency", "high_latency::HighLatency"),
    ("log_streaming", "logs::LogStreamer"),
];

/// Returns the name of an entry that is written like this.
fn name_of(example: &str) -> &str {
    example.split(':').next().unwrap_or(example)
}

/// The entries of a declaration, by name.
pub struct Entries<'a> {
    rows: &'a [Row],
    name: Span,
}

impl<'a> Entries<'a> {
    /// Checks the names of the entries, and that each has a value if it needs one.
    pub fn of(declaration: &'a Declaration) -> Result<Self, Mistake> {
        for row in &declaration.entries {
            let name = row.name.to_string();
            if let Some((_, service)) = FIELDS.iter().find(|(field, _)| *field == name) {
                let text = format!("`{name}` is a field of the struct: `{name}: mavstack::{service}`");
                return Err(Mistake::new(row.name.span(), text));
            }
            let Some(example) = ENTRIES.iter().find(|example| name_of(example) == name) else {
                let names: Vec<_> = ENTRIES.iter().map(|example| format!("`{}`", name_of(example))).collect();
                let text = format!("`{name}` is no entry of a stack. These are: {}", names.join(", "));
                return Err(Mistake::new(row.name.span(), text));
            };
            if example.contains(':') == row.value.is_empty() && !may_stand_alone(&name) {
                return Err(Mistake::new(row.name.span(), format!("write `{example}`")));
            }
        }
        Ok(Self { rows: &declaration.entries, name: declaration.name.span() })
    }

    /// Returns an entry, if it is declared.
    pub fn get(&self, name: &str) -> Option<&'a Row> {
        self.rows.iter().find(|row| row.name.to_string() == name)
    }

    /// Returns the value of an entry that every declaration has.
    fn required(&self, name: &str, example: &str) -> Result<TokenStream, Mistake> {
        let missing = || Mistake::new(self.name, format!("`#[stack({example})]` is missing: say it above the struct"));
        self.get(name).map(|row| row.value.clone()).ok_or_else(missing)
    }

    /// Returns a size of an entry: what `{ size: value }` has, or `default`; `None` if there is neither.
    fn size(&self, entry: &str, size: &str, default: Option<&str>) -> Result<Option<TokenStream>, Mistake> {
        let default = default.map(tokens);
        let Some(row) = self.get(entry).filter(|row| !row.value.is_empty()) else { return Ok(default) };
        let example = ENTRIES.iter().find(|example| name_of(example) == entry).copied().unwrap_or(entry);
        let rows = sizes(row, example)?;
        Ok(rows.into_iter().find(|row| row.name.to_string() == size).map(|row| row.value).or(default))
    }

    /// Returns a size that has no default.
    fn required_size(&self, entry: &str, size: &str) -> Result<TokenStream, Mistake> {
        let row = self.get(entry);
        let missing = || {
            let example = ENTRIES.iter().find(|example| name_of(example) == entry).copied().unwrap_or(entry);
            Mistake::new(row.map_or(self.name, |row| row.name.span()), format!("write `{example}`"))
        };
        self.size(entry, size, None)?.ok_or_else(missing)
    }

    /// Returns `with`, filled in and reported at the entry, if it is declared; otherwise `without`.
    fn choose(&self, entry: &str, with: &str, without: &str, values: &Values) -> TokenStream {
        match self.get(entry) {
            Some(row) => placed(fill(with, values), row.place()),
            None => fill(without, values),
        }
    }

    /// Returns what the template of [`write`](crate::write) needs.
    pub fn values(&self) -> Result<Values, Mistake> {
        let mut values = Values::new();
        let put = |values: &mut Values, name: &str, tokens: TokenStream| {
            values.insert(name.to_owned(), tokens);
        };
        put(&mut values, "library", self.get("crate").map_or_else(|| tokens("::mavstack"), |row| row.value.clone()));
        put(&mut values, "vehicle", self.required("vehicle", "vehicle: Rover, links: 1")?);
        put(&mut values, "links", self.required("links", "vehicle: Rover, links: 1")?);
        put(&mut values, "peers", self.get("peers").map_or_else(|| tokens("8"), |row| row.value.clone()));
        put(&mut values, "texts", self.get("texts").map_or_else(|| tokens("4"), |row| row.value.clone()));
        put(&mut values, "has_modes", is(self.get("modes").is_some()));
        put(&mut values, "has_forwarding", is(self.get("forwarding").is_some()));
        put(&mut values, "slows_streams", is(self.get("files").is_some() && self.get("streams").is_some()));
        self.put_plans(&mut values)?;
        self.put_sizes(&mut values)?;
        let services = [
            ("Stream", "streams", "StreamService<{ <$vehicle as $library::Telemetry>::STREAMS.len() }>"),
            ("Messages", "messages", "Messages"),
            ("Mode", "modes", "ModeService"),
            ("Commands", "commands", "CommandSlots<{ $slots }>"),
            ("Client", "command_client", "Client<{ $client }>"),
            ("Components", "components", "ComponentService"),
            ("Logs", "logs", "LogServer"),
            ("ManualControl", "manual_control", "ManualInput"),
            ("OperatorControl", "operator_control", "OperatorControl"),
            ("Forwarding", "forwarding", "Forwarding<{ $links }, { $bytes }, { $seen }>"),
        ];
        for (name, entry, with) in services {
            let without = if name == "Commands" { "NoSlots" } else { "Absent" };
            let [with, without] = [with, without].map(|service| format!("$library::__private::{service}"));
            let service = self.choose(entry, &with, &without, &values);
            put(&mut values, name, service);
        }
        let with_feature = [
            ("Signing", "signing", "$library::__signing!($signed)", "$library::__private::WithoutSigning"),
            ("Storage", "storage", "$library::__storage!()", "$library::__private::Absent"),
        ];
        for (name, entry, with, without) in with_feature {
            let service = self.choose(entry, with, without, &values);
            put(&mut values, name, service);
        }
        let records = match values.get("records").is_some_and(|records| !records.is_empty()) {
            true => self.choose("storage", "$library::__storage!($records)", "", &values),
            false => fill("$library::__private::Absent", &values),
        };
        put(&mut values, "Records", records);
        let events = match self.has_checks()? {
            true => "$library::__private::EventService<$library::__private::Checking<{ $history }>>",
            false => "$library::__private::EventService<$library::__private::Unchecked<{ $history }>>",
        };
        let events = self.choose("events", events, "$library::__private::Absent", &values);
        put(&mut values, "Events", events);
        self.put_checks(&mut values);
        let hooks = "
            const COMPONENTS: &'static [$library::Component] = <$vehicle as $library::Components>::COMPONENTS;
            const HAS_OPTIONAL_COMPONENTS: bool = <$vehicle as $library::Components>::OPTIONAL;
            fn component_command(
                vehicle: &mut $vehicle,
                cx: &mut $library::Context<'_>,
                command: &$library::Command,
            ) -> $library::Outcome {
                <$vehicle as $library::Components>::component_command(vehicle, cx, command.component, command)
            }";
        let hooks = self.choose("components", hooks, "", &values);
        put(&mut values, "component_hooks", hooks);
        let files = "$library::__private::FileServer<{ $library::__private::file_sessions($sessions) }, { $upload },
            $library::__one_of!({ $uploads }; $Param, $Mission, $Logs,)>";
        let files = self.choose("files", files, "$library::__private::Absent", &values);
        put(&mut values, "Files", files);
        Ok(values)
    }

    fn put_plans(&self, values: &mut Values) -> Result<(), Mistake> {
        let upload = self.size("files", "upload", Some("0"))?.unwrap_or_default();
        let uploads =
            if self.get("files").is_some() { fill_one("($upload) > 0", "upload", &upload) } else { is(false) };
        values.insert("upload".into(), upload);
        values.insert("uploads".into(), uploads);
        if self.get("plans").is_some() {
            values.insert("mission".into(), self.required_size("plans", "mission")?);
            for plan in ["fence", "rally"] {
                values.insert(plan.into(), self.size("plans", plan, Some("0"))?.unwrap_or_default());
            }
        }
        let memory = "<$library::plan_memory!(mission: $mission, fence: $fence, rally: $rally)
            as $library::__private::PlanMemoryOf<{ $uploads }>>::Memory";
        let plans = self.choose("plans", memory, "$library::__private::NoPlans", values);
        values.insert("Plans".into(), plans);
        let [with, without] = ["$library::__private::Missions", "$library::__private::WithoutPlans"];
        let mission = self.choose("plans", with, without, values);
        values.insert("Mission".into(), mission);
        let table = self
            .get("parameters")
            .map_or_else(|| fill("$library::__private::NoParams", values), |row| row.value.clone());
        values.insert("Parameters".into(), table);
        let service = "<$Parameters as $library::__private::ParamMemory>::Service";
        let param = self.choose("parameters", service, "$library::__private::Absent", values);
        values.insert("Param".into(), param);
        Ok(())
    }

    fn put_sizes(&self, values: &mut Values) -> Result<(), Mistake> {
        let sizes = [
            ("signed", "signing", "streams", "16"),
            ("bytes", "forwarding", "bytes", "512"),
            ("seen", "forwarding", "seen", "256"),
            ("records", "storage", "records", ""),
        ];
        for (name, entry, size, default) in sizes {
            values.insert(name.into(), self.size(entry, size, Some(default))?.unwrap_or_default());
        }
        let required = [
            ("slots", "commands", "slots"),
            ("client", "command_client", "slots"),
            ("history", "events", "history"),
            ("sessions", "files", "sessions"),
        ];
        for (name, entry, size) in required {
            let size = if self.get(entry).is_some() { self.required_size(entry, size)? } else { tokens("0") };
            values.insert(name.into(), size);
        }
        let queues = if self.get("messages").is_some() { fill("$links", values) } else { tokens("0") };
        values.insert("message_queues".into(), queues);
        values.insert("client_queues".into(), tokens(if self.get("command_client").is_some() { "1" } else { "0" }));
        Ok(())
    }

    fn has_checks(&self) -> Result<bool, Mistake> {
        let Some(row) = self.get("events") else { return Ok(false) };
        let rows = sizes(row, "events: { history: 16, checks }")?;
        Ok(rows.iter().any(|row| row.name.to_string() == "checks"))
    }

    /// The checks of single entries, each reported at its entry.
    fn put_checks(&self, values: &mut Values) {
        let modes = "$library::FlightMode::check(<$vehicle as $library::Modes>::MODES);";
        let streams = "$library::Stream::check(<$vehicle as $library::Telemetry>::STREAMS, $has_modes);";
        let slots =
            "$library::command::CommandPolicy::check_without_slots(<$vehicle as $library::Commands>::POLICIES);";
        let checks: TokenStream = [
            self.choose("modes", modes, "", values),
            self.choose("streams", streams, "", values),
            self.choose("commands", "", slots, values),
        ]
        .into_iter()
        .collect();
        values.insert("checks".into(), checks);
    }
}

/// Whether an entry may have a value or none.
fn may_stand_alone(name: &str) -> bool {
    matches!(name, "forwarding" | "signing" | "storage")
}

fn is(condition: bool) -> TokenStream {
    tokens(if condition { "true" } else { "false" })
}

fn fill_one(template: &str, name: &str, value: &TokenStream) -> TokenStream {
    fill(template, &Values::from([(name.to_owned(), value.clone())]))
}
