//! An exhaustive search: two clients, one session, and a line that loses and repeats what it carries. Rules F-4, F-6, F-7, F-13.
//!
//! Each client opens a file, reads it in two requests, and ends its session. Before each step the line may deliver the request of
//! either client, deliver it twice, or lose the request or its answer; then the client repeats it. Time passes only while no
//! request is under way. The search visits every order up to a number of steps.

use super::*;
use mavstack::Instant;
use std::collections::BTreeSet;

#[derive(mavstack::Stack)]
#[stack(vehicle: TestVehicle, links: 1, commands: { slots: 2 }, files: { sessions: 1 })]
struct Small;

/// What a client does, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Doing {
    Open,
    Read(u32),
    End,
    Done,
}

/// What the line does with a client's next request.
#[derive(Clone, Copy, Debug)]
enum Fate {
    Delivers,
    DeliversTwice,
    LosesRequest,
    LosesAnswer,
    /// The request before is delivered once more, late; its answer is ignored.
    DeliversLate,
}

/// A client: what it does, the number of its request, and what it has read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct State {
    doing: Doing,
    seq: u16,
    is_open: bool,
}

const START: State = State { doing: Doing::Open, seq: 0, is_open: false };
const CONTENT: &[u8] = b"MIT";

/// One way through the search: each step is a client and what the line does, or time.
type Path = Vec<Option<(usize, Fate)>>;

struct Run {
    world: World<1, Small>,
    clients: [State; 2],
}

impl Run {
    fn new() -> Self {
        let link = LinkConfig::unlimited().with_streams(StreamProfile::Off);
        let mut world = World::<1, Small>::of(Setup { links: [link], ..Setup::new() });
        world.vehicle.files.content.insert("f".to_string(), CONTENT.to_vec());
        Self { world, clients: [START; 2] }
    }

    fn request(&self, number: usize, state: State) -> Option<(Address, FileTransferProtocol)> {
        use MavFtpOpcode as Op;
        let (opcode, offset, data) = match state.doing {
            Doing::Open => (Op::OPENFILERO, 0, &b"f"[..]),
            Doing::Read(offset) => (Op::READFILE, offset, &b""[..]),
            Doing::End => (Op::TERMINATESESSION, 0, &b""[..]),
            Doing::Done => return None,
        };
        let size = if data.is_empty() { 2 } else { 1 };
        Some(([STATION, OTHER_STATION][number], request(state.seq, 0, opcode, size, offset, data)))
    }

    /// Delivers a request, and returns the answers.
    fn deliver(&mut self, from: Address, message: &FileTransferProtocol) -> Vec<Packet> {
        let now = self.world.now();
        let frame = self.world.gcs[0].frame_from(from, message);
        self.world.stack.receive(now, LinkId(0), &frame, &mut self.world.vehicle);
        self.world.pulse.tick();
        self.world.stack.poll(now, &mut self.world.vehicle);
        let mut packets = Vec::new();
        loop {
            let bytes = self.world.stack.transmit(now, LinkId(0), &mut self.world.vehicle).to_vec();
            if bytes.is_empty() {
                return packets;
            }
            self.world.stack.transmitted(LinkId(0), bytes.len());
            if bytes[7] == 110 {
                let mut payload = bytes[10..bytes.len() - 2].to_vec();
                payload.resize(254, 0);
                let message = <FileTransferProtocol as mavstack::Message>::decode(&payload);
                assert_eq!(message.target_system, from.system.wire(), "an answer to somebody else");
                packets.push(Packet::of(&message));
            }
        }
    }

    fn step(&mut self, step: Option<(usize, Fate)>) {
        let Some((number, line)) = step else {
            // Long enough to take over a session.
            let now: Instant = self.world.now();
            self.world.clock.set(now + millis(3_000));
            return;
        };
        let state = self.clients[number];
        if let Fate::DeliversLate = line {
            let before = match state.doing {
                Doing::Open => return,
                Doing::Read(0) => Doing::Open,
                Doing::Read(_) => Doing::Read(0),
                Doing::End => Doing::Read(2),
                Doing::Done => Doing::End,
            };
            let late = State { doing: before, seq: state.seq - 1, ..state };
            let (from, message) = self.request(number, late).expect("a request");
            self.deliver(from, &message);
            return;
        }
        let Some((from, message)) = self.request(number, state) else { return };
        let answers = match line {
            Fate::LosesRequest => return,
            Fate::Delivers | Fate::LosesAnswer | Fate::DeliversLate => self.deliver(from, &message),
            Fate::DeliversTwice => {
                let first = self.deliver(from, &message);
                let second = self.deliver(from, &message);
                let are_same = first == second;
                assert!(are_same, "F-4: {first:?}, {second:?}");
                first
            }
        };
        let [answer] = &answers[..] else { panic!("one answer to {state:?}: {answers:?}") };
        assert_eq!(answer.seq, state.seq.wrapping_add(1));
        if matches!(line, Fate::LosesAnswer) {
            return;
        }
        let next = match (state.doing, answer.error()) {
            (Doing::Open, None) => Doing::Read(0),
            // It tries again.
            (Doing::Open, Some(error)) => {
                assert_eq!(error, MavFtpErr::NOSESSIONSAVAILABLE);
                Doing::Open
            }
            (Doing::Read(offset), None) => {
                let end = CONTENT.len().min(offset as usize + 2);
                assert_eq!(answer.data, &CONTENT[offset as usize..end], "what is read is right");
                if offset == 0 { Doing::Read(2) } else { Doing::End }
            }
            // Its session was taken over: it begins again.
            (Doing::Read(_), Some(error)) => {
                assert_eq!(error, MavFtpErr::INVALIDSESSION);
                Doing::Open
            }
            (Doing::End, None) => Doing::Done,
            (doing, error) => panic!("{doing:?} {error:?}"),
        };
        self.clients[number] = State { doing: next, seq: state.seq + 1, is_open: next != Doing::Open };
    }

    fn check(&self) {
        assert!(self.world.vehicle.files.open.len() <= 1, "F-6");
    }

    /// From here on the line is good and time passes: both clients end.
    fn finish(mut self, path: &Path) {
        for _ in 0..40 {
            for number in 0..2 {
                self.step(Some((number, Fate::Delivers)));
                self.check();
            }
            self.step(None);
        }
        let is_done = self.clients.iter().all(|client| client.doing == Doing::Done);
        assert!(is_done, "{path:?}: {:?}", self.clients);
        for _ in 0..5 {
            self.step(None);
            let now = self.world.now();
            self.world.stack.poll(now, &mut self.world.vehicle);
        }
        assert!(self.world.vehicle.files.open.is_empty(), "{path:?}");
    }
}

/// Every order of six steps, and what follows each.
#[test]
fn every_order_of_two_clients_ends_well() {
    use Fate::*;
    let steps: Vec<_> = [Delivers, DeliversTwice, LosesRequest, LosesAnswer, DeliversLate]
        .into_iter()
        .flat_map(|line| [Some((0, line)), Some((1, line))])
        .chain([None])
        .collect();
    let mut paths: Vec<Path> = vec![Vec::new()];
    let mut seen = BTreeSet::new();
    let mut visited = 0;
    for depth in 0..7 {
        let mut next = Vec::new();
        for path in paths {
            for step in &steps {
                let mut longer = path.clone();
                longer.push(*step);
                let mut run = Run::new();
                for step in &longer {
                    run.step(*step);
                    run.check();
                }
                visited += 1;
                // What follows depends on the clients, on the open files, and on the time only.
                let idle = longer.iter().rev().take_while(|step| step.is_none()).count().min(4);
                let key = (run.clients, run.world.vehicle.files.open.len(), idle, last_touched(&longer));
                if !seen.insert(key) {
                    continue;
                }
                run.finish(&longer);
                next.push(longer);
            }
        }
        paths = next;
        assert!(depth > 5 || !paths.is_empty());
    }
    assert!(visited > 2_000, "{visited} orders");
}

/// For each client, how many pauses ago its last request was delivered.
fn last_touched(path: &Path) -> [usize; 2] {
    [0, 1].map(|number| {
        let is_it = |step: &&Option<(usize, Fate)>| {
            step.is_some_and(|(client, line)| client == number && !matches!(line, Fate::LosesRequest))
        };
        let after = path.iter().rev().take_while(|step| !is_it(step));
        after.filter(|step| step.is_none()).count().min(4)
    })
}
