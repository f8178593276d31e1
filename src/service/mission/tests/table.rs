//! Every event in every state of an upload.

use super::*;

/// The sender's relation to the upload: the columns of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Column {
    Idle,
    Client,
    Other,
    OtherType,
    /// The client whose plan is being written.
    Committing,
    /// Another client meanwhile.
    OtherCommitting,
}

const COLUMNS: [Column; 6] =
    [Column::Idle, Column::Client, Column::Other, Column::OtherType, Column::Committing, Column::OtherCommitting];

/// The events: the rows of the table.
#[derive(Clone, Copy, Debug)]
enum Event {
    Count,
    CountZero,
    CountTooMany,
    CountBadType,
    CountUnservedType,
    ItemNext,
    ItemBefore,
    ItemAfter,
    AckCancelled,
    AckError,
    AckAccepted,
    List,
    Request,
    Clear,
    ClearAll,
}

const EVENTS: [Event; 15] = [
    Event::Count,
    Event::CountZero,
    Event::CountTooMany,
    Event::CountBadType,
    Event::CountUnservedType,
    Event::ItemNext,
    Event::ItemBefore,
    Event::ItemAfter,
    Event::AckCancelled,
    Event::AckError,
    Event::AckAccepted,
    Event::List,
    Event::Request,
    Event::Clear,
    Event::ClearAll,
];

const BAD: MavMissionType = MavMissionType(7);
const RALLY: MavMissionType = MavMissionType::RALLY;
const ALL: MavMissionType = MavMissionType::ALL;
const INVALID: MavMissionResult = MavMissionResult::INVALID;
const NO_SPACE: MavMissionResult = MavMissionResult::NO_SPACE;

/// The state of the upload after the event.
#[derive(Clone, Copy, Debug, PartialEq)]
enum After {
    /// Unchanged.
    Same,
    /// No upload.
    Idle,
    /// One more item was received.
    Further,
    /// A new upload of this plan, by the sender.
    New(MavMissionType),
}

/// The answer, the state of the upload, and which plans are empty afterwards.
type Cell = (Option<(MavMissionType, Out)>, After, &'static [MavMissionType]);

/// The live plans before: two mission items, one fence item.
fn live_mission() -> Vec<Item> {
    plan(100, 2)
}

fn live_fence() -> Vec<Item> {
    fence(101, 1)
}

/// The plan that the sender's messages name.
fn subject(column: Column) -> MavMissionType {
    if column == Column::OtherType { FENCE } else { MISSION }
}

fn expected(column: Column, event: Event) -> Cell {
    use After::*;
    let subject = subject(column);
    let ack = |result| Some((subject, Ack(result, 0)));
    let empty: &[_] = if subject == FENCE { &[FENCE] } else { &[MISSION] };
    let live = if subject == FENCE { live_fence() } else { live_mission() };
    match (event, column) {
        // M-25: for any sender.
        (Event::CountBadType, _) => (Some((BAD, Ack(INVALID, 0))), Same, &[]),
        (Event::CountUnservedType, _) => (Some((RALLY, Ack(UNSUPPORTED, 0))), Same, &[]),
        // M-62
        (Event::List, _) => (Some((subject, Out::Count(live.len() as u16, id_of(&live)))), Same, &[]),
        (Event::Request, _) => {
            let current = u8::from(subject == MISSION);
            (Some((subject, Part(0, current, live[0]))), Same, &[])
        }
        // M-35
        (Event::AckCancelled | Event::AckError, Column::Client) => (None, Idle, &[]),
        (Event::AckCancelled | Event::AckError | Event::AckAccepted, _) => (None, Same, &[]),
        // M-44: the answer is sent when the plan is written.
        (Event::Clear, Column::Committing) => (ack(DENIED), Same, &[]),
        (Event::ClearAll, Column::Committing | Column::OtherCommitting) => (Some((ALL, Ack(DENIED, 0))), Same, &[]),
        (_, Column::Committing) => (None, Same, &[]),
        (_, Column::OtherCommitting) => (ack(DENIED), Same, &[]),
        // M-23, M-33, M-51
        (Event::ClearAll, Column::Other) => (Some((ALL, Ack(DENIED, 0))), Same, &[]),
        (_, Column::Other) => (ack(DENIED), Same, &[]),
        (Event::Count, _) => (Some((subject, Ask(0))), New(subject), &[]),
        (Event::CountZero | Event::Clear, _) => (ack(ACCEPTED), Idle, empty),
        (Event::ClearAll, _) => (Some((ALL, Ack(ACCEPTED, 0))), Idle, &[MISSION, FENCE]),
        (Event::CountTooMany, _) => (ack(NO_SPACE), Idle, &[]),
        // M-30 to M-32, M-36
        (Event::ItemNext, Column::Client) => (Some((MISSION, Ask(2))), Further, &[]),
        (Event::ItemNext | Event::ItemBefore | Event::ItemAfter, Column::Idle) => (ack(ERROR), Same, &[]),
        (Event::ItemNext | Event::ItemBefore | Event::ItemAfter, _) => (None, Same, &[]),
    }
}

fn sender(column: Column) -> Peer {
    if matches!(column, Column::Other | Column::OtherCommitting) { B } else { A }
}

fn send(bench: &mut Bench, column: Column, event: Event) {
    let from = sender(column);
    let subject = subject(column);
    match event {
        Event::Count => bench.send(from, &count(subject, 2)),
        Event::CountZero => bench.send(from, &count(subject, 0)),
        Event::CountTooMany => bench.send(from, &count(subject, 6)),
        Event::CountBadType => bench.send(from, &count(BAD, 3)),
        Event::CountUnservedType => bench.send(from, &count(RALLY, 3)),
        Event::ItemNext => bench.send(from, &int(subject, 1, &item(1, 1))),
        Event::ItemBefore => bench.send(from, &int(subject, 0, &item(1, 0))),
        Event::ItemAfter => bench.send(from, &int(subject, 2, &item(1, 2))),
        Event::AckCancelled => bench.send(from, &ack(subject, CANCELLED)),
        Event::AckError => bench.send(from, &ack(subject, ERROR)),
        Event::AckAccepted => bench.send(from, &ack(subject, ACCEPTED)),
        Event::List => bench.send(from, &list(subject)),
        Event::Request => bench.send(from, &request(subject, 0)),
        Event::Clear => bench.send(from, &clear(subject)),
        Event::ClearAll => bench.send(from, &clear(ALL)),
    }
}

/// The whole table: answer, upload and live plans after each event in each state. It includes: one upload at a time, while any
/// client may download (M-12); a COUNT of another type ends the client's upload (M-24); every answer names its plan (M-26).
#[test]
fn every_event_in_every_state() {
    for column in COLUMNS {
        for event in EVENTS {
            let name = std::format!("{event:?} from {column:?}");
            let mut bench = Bench::new();
            assert_eq!(bench.upload(B, MISSION, &live_mission()), Ack(ACCEPTED, id_of(&live_mission())));
            assert_eq!(bench.upload(B, FENCE, &live_fence()), Ack(ACCEPTED, id_of(&live_fence())));
            bench.now += Duration::from_secs(20);
            let is_committing = matches!(column, Column::Committing | Column::OtherCommitting);
            if is_committing {
                // A has sent both items of a mission.
                bench.missions.attach_storage(Durability::Durable);
                assert_eq!(bench.ask(A, &count(MISSION, 2)), [to_a(Ask(0))], "{name}");
                assert_eq!(bench.ask(A, &int(MISSION, 0, &item(1, 0))), [to_a(Ask(1))], "{name}");
                assert_eq!(bench.ask(A, &int(MISSION, 1, &item(1, 1))), [], "{name}");
            } else if column != Column::Idle {
                // A has sent the first of three mission items.
                assert_eq!(bench.ask(A, &count(MISSION, 3)), [to_a(Ask(0))], "{name}");
                assert_eq!(bench.ask(A, &int(MISSION, 0, &item(1, 0))), [to_a(Ask(1))], "{name}");
            }
            let from = sender(column);
            let (answer, after, empty) = expected(column, event);

            send(&mut bench, column, event);

            let answer: Vec<Sent> =
                answer.into_iter().map(|(mission_type, out)| (from.address, mission_type, out)).collect();
            assert_eq!(bench.drain(), answer, "{name}");
            for (plan, items) in [(MISSION, live_mission()), (FENCE, live_fence())] {
                let items = if empty.contains(&plan) { Vec::new() } else { items };
                let live = bench.live(PlanType::from_mission_type(plan).unwrap());
                assert_eq!(live, (&items[..], id_of(&items)), "{name}");
            }
            // The next repeated request shows the state of the upload.
            let expected = match (after, column) {
                (After::Idle, _) | (After::Same, Column::Idle) => None,
                (After::Same, _) if is_committing => None,
                (After::Same, _) => Some((A.address, MISSION, Ask(1))),
                (After::Further, _) => Some((A.address, MISSION, Ask(2))),
                (After::New(plan), _) => Some((from.address, plan, Ask(0))),
            };
            let asked = bench.wait(300);
            assert_eq!(asked.first().map(|(_, sent)| *sent), expected, "{name}");
            if is_committing {
                let written = [item(1, 0), item(1, 1)];
                bench.saved();
                assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, id_of(&written)))], "{name}");
                assert_eq!(bench.live(PlanType::Mission), (&written[..], id_of(&written)), "{name}");
            }
        }
    }
}

/// The client's column before the first item. There, the pending request answers a COUNT (M-22 a), and UNSUPPORTED selects the
/// other form (M-37).
#[test]
fn events_before_the_first_item() {
    for (event, asked) in [
        (Event::Count, Some(Ask(0))),
        (Event::CountBadType, Some(Ask(0))),
        (Event::AckAccepted, Some(Ask(0))),
        (Event::ItemNext, Some(Ask(0))),
        (Event::AckCancelled, None),
        (Event::CountTooMany, None),
        (Event::Clear, None),
    ] {
        let mut bench = Bench::new();
        assert_eq!(bench.ask(A, &count(MISSION, 2)), [to_a(Ask(0))]);
        send(&mut bench, Column::Client, event);
        bench.drain();
        assert_eq!(bench.wait(300).first().map(|(_, sent)| sent.2), asked, "{event:?}");
    }
}
