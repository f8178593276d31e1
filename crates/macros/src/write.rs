//! Writes what a declaration stands for.

use proc_macro::{Group, TokenStream, TokenTree};
use std::collections::BTreeMap;

use crate::Mistake;
use crate::entries::Entries;
use crate::read::{Declaration, placed};

/// What stands in a template for each `$name`.
pub type Values = BTreeMap<String, TokenStream>;

/// What every declaration becomes.
const TEMPLATE: &str = "
    const _: () = {
        use $library::__private as library;

        impl library::Firmware for $name {
            type Vehicle = $vehicle;
            type Plans = $Plans;
            type Parameters = $Parameters;
            type Credits =
                [library::Credits; library::credits(<Self as library::ServiceList<Self>>::ABOUT, $has_forwarding)];
            const HAS_MODES: bool = $has_modes;
            const HAS_TEXTS: bool = ($texts) > 0;
            const HAS_CONTROL: bool = <$OperatorControl as library::ControlGate>::IS_SOME;
            const SLOWS_STREAMS: bool = $slows_streams;
            $component_hooks
        }

        impl library::Declaration for $name {
            type Stack = $library::Stack<Self, { $links }>;
        }

        impl library::Declares for $name {
            type Services = Self;
            type Peers = library::PeerTable<{ $peers }>;
            type Texts = library::TextQueue<{ $texts }>;
            type Requests = library::Requests<[library::RequestQueue; { ($message_queues) + $client_queues }]>;
            type EventLog = library::EventHistory<{ $history }>;
            const LINKS: usize = $links;
            const MESSAGE_QUEUES: usize = $message_queues;
            type Commands = $Commands;
            type Components = $Components;
            type Mission = $Mission;
            type Param = $Param;
            type Stream = $Stream;
            type Messages = $Messages;
            type Client = $Client;
            type Events = $Events;
            type Logs = $Logs;
            type Mode = $Mode;
            type ManualControl = $ManualControl;
            type OperatorControl = $OperatorControl;
            type Signing = $Signing;
            type Files = $Files;
            type Forwarding = $Forwarding;
            type Records = $Records;
            type Storage = $Storage;
            const CHECKED: () = { $checks };
        }

        #[derive(Debug)]
        $visibility struct Links {
            $fields_of_links
        }

        impl library::ServiceList<$name> for $name {
            type Links = Links;
            const NEW: Self = Self { $new };
            const VACANT: Links = Links { $vacant };
            const ABOUT: &'static [library::About] = &[$about];

            #[inline(always)]
            fn visit(&mut self, links: &mut Links, visit: &mut impl library::Visit<$name>) -> bool {
                let _ = (&self, &links, &visit);
                false $visits
            }

            #[inline(always)]
            fn look(&self, links: &Links, look: &mut impl library::Look<$name>) {
                let _ = (links, &look);
                $looks
            }

            #[inline(always)]
            fn visit_all<T>(
                &mut self,
                states: &mut [T],
                of: impl Fn(&mut T) -> &mut Links + Copy,
                visit: &mut impl library::VisitAll<$name>,
            ) {
                let _ = (&states, of, &visit);
                $visits_of_all
            }

            #[inline(always)]
            fn look_all(&self, look: &mut impl library::LookAll<$name>) {
                let _ = &look;
                $looks_at_all
            }
        }

        // Reported by `cargo check`, which does not build the stack.
        const _: () = <$name as library::Declares>::CHECKED;
        $checked_fields
    };
";

/// What each field adds, by the name in [`TEMPLATE`].
const OF_FIELD: [(&str, &str); 9] = [
    ("fields_of_links", "$field: <$type as library::Service<$name>>::Link,"),
    ("new", "$field: <$type as library::Service<$name>>::NEW,"),
    ("vacant", "$field: <$type as library::Service<$name>>::VACANT,"),
    ("about", "<$type as library::Service<$name>>::ABOUT,"),
    ("visits", "|| library::Visit::<$name>::visit(visit, &mut self.$field, &mut links.$field)"),
    ("looks", "library::Look::<$name>::look(look, &self.$field, &links.$field);"),
    (
        "visits_of_all",
        "library::VisitAll::<$name>::visit(
            visit,
            &mut self.$field,
            states.iter_mut().map(move |state| &mut of(state).$field),
        );",
    ),
    ("looks_at_all", "library::LookAll::<$name>::look(look, &self.$field);"),
    ("checked_fields", "const _: () = <$type as library::Service<$name>>::CHECK;"),
];

/// Returns what stands for a declaration.
pub fn declaration(declaration: &Declaration) -> Result<TokenStream, Mistake> {
    let mut values = Entries::of(declaration)?.values()?;
    values.insert("name".into(), TokenTree::Ident(declaration.name.clone()).into());
    values.insert("visibility".into(), declaration.visibility.clone());
    for (name, template) in OF_FIELD {
        let mut all = TokenStream::new();
        for field in &declaration.fields {
            let mut of_field = values.clone();
            of_field.insert("field".into(), TokenTree::Ident(field.name.clone()).into());
            of_field.insert("type".into(), field.value.clone());
            all.extend(placed(fill(template, &of_field), field.place()));
        }
        values.insert(name.into(), all);
    }
    Ok(fill(TEMPLATE, &values))
}

/// Returns a template as tokens, with a value for each `$name`.
pub fn fill(template: &str, values: &Values) -> TokenStream {
    put(tokens(template), values)
}

fn put(template: TokenStream, values: &Values) -> TokenStream {
    let mut filled = TokenStream::new();
    let mut template = template.into_iter();
    while let Some(token) = template.next() {
        match token {
            TokenTree::Punct(punct) if punct.as_char() == '$' => {
                let name = template.next().map(|name| name.to_string()).unwrap_or_default();
                filled.extend(values.get(&name).cloned().unwrap_or_default());
            }
            TokenTree::Group(group) => {
                let mut inner = Group::new(group.delimiter(), put(group.stream(), values));
                inner.set_span(group.span());
                filled.extend([TokenTree::Group(inner)]);
            }
            token => filled.extend([token]),
        }
    }
    filled
}

/// Returns the tokens of a text of the library's own.
pub fn tokens(text: &str) -> TokenStream {
    text.parse().unwrap_or_default()
}
