//! The ends of a link in async tasks: any future may be dropped at any `await`, and nothing waits for a link that is stuck.
//! Rules D-2, D-3, D-4, H-5, S-16, S-20.

mod lab;

use core::pin::pin;
use core::task::{Context, Waker};
use std::rc::Rc;

use crate::support::*;
use lab::{Executor, Firmware, Scissors, select};
use mavstack::config::PollBudget;
use mavstack::dialect::*;
use mavstack::frame::{Decoder, MAX_FRAME_LEN};
use mavstack::io::{AsyncReceiver, AsyncTransmitter};
use mavstack::message::Dialect;
use mavstack::network::LinkError;
use mavstack::{Instant, LinkId, Message};
use proptest::prelude::{prop_assert, prop_assert_eq, proptest};

const LINK: LinkId = LinkId(0);

/// The frames of a ground station.
fn station() -> Gcs {
    Gcs::new(Line::new(&Clock::default(), LineConfig::default(), 1).ends().1)
}

/// Sends `message` to the firmware.
fn send<M: Message, const N: usize>(firmware: &Firmware<N>, link: usize, gcs: &mut Gcs, message: &M) {
    let frame = gcs.frame_from(STATION, message);
    firmware.uarts[link].with(|uart| uart.received.extend(frame));
}

/// Returns the id and the sequence number of each frame, and the number of bytes outside of frames.
fn frames(bytes: &[u8]) -> (Vec<(u32, u8)>, u32) {
    let mut decoder = Decoder::default();
    let (mut found, mut rest) = (Vec::new(), bytes);
    while !rest.is_empty() {
        rest = &rest[decoder.push(rest, Instant::ZERO)..];
        let mut budget = u32::MAX;
        while let Some(frame) = decoder.next(Instant::ZERO, Common::MESSAGES, &mut budget, |_| false) {
            found.push((frame.id(), frame.header().seq));
        }
    }
    (found, decoder.counters().skipped)
}

/// Asserts that whole frames were sent, without a gap (S-16), and returns their ids.
fn whole_frames(bytes: &[u8]) -> Vec<u32> {
    let (found, skipped) = frames(bytes);
    assert_eq!(skipped, 0);
    for (at, (_, seq)) in found.iter().enumerate() {
        assert_eq!(usize::from(*seq), at % 256, "{found:?}");
    }
    found.into_iter().map(|(id, _)| id).collect()
}

fn count(ids: &[u32], id: u32) -> usize {
    ids.iter().filter(|other| **other == id).count()
}

/// Runs until all pending bytes were sent, while time stands still.
fn settle(firmware: &Firmware<1>, transmitting: &mut Executor) {
    for _ in 0..1_000 {
        transmitting.run();
        firmware.uarts[0].drain(7);
    }
    assert_eq!(firmware.uarts[0].with(|uart| uart.received.len() + uart.fifo.len()), 0);
}

/// Runs rounds of requests, with time standing still in each, first received and then answered. Returns what the vehicle was told,
/// and the bytes that were sent.
fn rounds<const RX: usize, const TX: usize>(seed: u64, awkward: Option<(u64, usize, f64)>) -> (Vec<Call>, Vec<u8>) {
    let firmware = Firmware::<1>::new(seed);
    let (piece, capacity, chance) = awkward.unwrap_or((1_000, 1_000, 0.0));
    firmware.uarts[0].with(|uart| {
        (uart.piece, uart.capacity, uart.stumbles) = (piece, capacity, awkward.is_some());
    });
    let scissors = Scissors::new(seed, chance);
    let mut receiving = Executor::default();
    receiving.spawn(Rc::clone(&firmware).receive::<RX>(LINK, Rc::clone(&scissors)));
    let mut transmitting = Executor::default();
    transmitting.spawn(Rc::clone(&firmware).transmit::<TX>(LINK, Rc::clone(&scissors)));
    let (mut gcs, mut requests) = (station(), Rng::new(seed));
    for round in 0..4 {
        for step in 1..=3 {
            firmware.pulse.tick();
            firmware.set_time(Instant::from_millis(round * 1_200 + step * 400));
            firmware.wake_transmitters();
            settle(&firmware, &mut transmitting);
        }
        for _ in 0..requests.below(6) {
            match requests.below(3) {
                0 => send(&firmware, 0, &mut gcs, &Ping { seq: round as u32, ..Ping::default() }),
                1 => {
                    let command = gcs.long(MavCmd::NAV_LAND, [round as f32; 7]);
                    send(&firmware, 0, &mut gcs, &command);
                }
                _ => firmware.uarts[0].with(|uart| uart.received.extend([0xFD, 9, 0, 0xFE])),
            }
        }
        receiving.run();
        // Frames that exceed the budget of a call; the transmit task would handle them between its frames.
        for _ in 0..20 {
            let (stack, vehicle) = &mut *firmware.stack.borrow_mut();
            stack.receive(firmware.now(), LINK, &[], vehicle);
        }
        settle(&firmware, &mut transmitting);
    }
    assert!(awkward.is_none_or(|(_, _, chance)| chance == 0.0) || scissors.cuts.get() > 0);
    assert_eq!(*firmware.errors.borrow(), []);
    (firmware.stack.borrow().1.calls.clone(), firmware.uarts[0].with(|uart| uart.sent.clone()))
}

proptest! {
    #![proptest_config(cases(96))]

    /// S-16, S-20: the vehicle is told the same and the same bytes are sent, whichever futures are dropped at whichever `await`,
    /// and however few bytes a read or a write takes.
    #[test]
    fn dropped_futures_lose_no_byte_and_send_none_twice(
        seed: u64, piece in 1..80u64, capacity in 1..90usize, chance in 0.0..0.7f64,
    ) {
        let awkward = Some((piece, capacity, chance));
        let undisturbed = rounds::<300, MAX_FRAME_LEN>(seed, None);
        prop_assert!(count(&whole_frames(&undisturbed.1), Heartbeat::ID) >= 4);
        prop_assert_eq!(&rounds::<64, 64>(seed, awkward), &undisturbed);
        prop_assert_eq!(&rounds::<1, MAX_FRAME_LEN>(seed, awkward), &undisturbed);
        prop_assert_eq!(&rounds::<300, 1>(seed, awkward), &undisturbed);
    }

    /// S-16: the same with everything at once: all tasks of two links, whose sleep is cut short too. Each command is carried out
    /// and answered once.
    #[test]
    fn tasks_that_are_disturbed_answer_each_request_once(seed: u64, piece in 1..40u64, chance in 0.0..0.5f64) {
        let firmware = Firmware::<2>::new(seed);
        let (scissors, mut executor) = (Scissors::new(seed, chance), Executor::default());
        for link in [LinkId(0), LinkId(1)] {
            firmware.uarts[usize::from(link.0)].with(|uart| (uart.piece, uart.stumbles) = (piece, true));
            executor.spawn(Rc::clone(&firmware).receive::<16>(link, Rc::clone(&scissors)));
            executor.spawn(Rc::clone(&firmware).transmit::<32>(link, Rc::clone(&scissors)));
        }
        let mut stations = [station(), station()];
        for round in 0..20 {
            for (link, gcs) in stations.iter_mut().enumerate() {
                let command = gcs.long(MavCmd::NAV_LAND, [round as f32; 7]);
                send(&firmware, link, gcs, &command);
            }
            firmware.run_for(&mut executor, 50, 11);
        }
        firmware.run_for(&mut executor, 300, 11);
        for uart in &firmware.uarts {
            let ids = uart.with(|uart| whole_frames(&uart.sent));
            prop_assert_eq!(count(&ids, CommandAck::ID), 20);
        }
        prop_assert_eq!(firmware.stack.borrow().1.commands().len(), 40);
        prop_assert_eq!(&*firmware.errors.borrow(), &[]);
    }

    /// S-13: a UART whose dropped writes have sent an unknown part of their bytes. The peer loses at most one frame for each, and
    /// the others are whole.
    #[test]
    fn a_write_with_an_unknown_end_costs_at_most_one_frame(seed: u64, chance in 0.01..0.1f64) {
        let firmware = Firmware::<1>::new(seed);
        firmware.uarts[0].with(|uart| (uart.piece, uart.is_sloppy, uart.stumbles) = (5, true, true));
        let (scissors, mut executor) = (Scissors::new(seed, chance), Executor::default());
        executor.spawn(Rc::clone(&firmware).transmit::<MAX_FRAME_LEN>(LINK, Rc::clone(&scissors)));
        firmware.run_for(&mut executor, 20_000, 20);
        let (found, _) = firmware.uarts[0].with(|uart| frames(&uart.sent));
        let missing = 20usize.saturating_sub(found.len());
        prop_assert!(missing <= scissors.cuts.get() as usize, "{} cuts, {found:?}", scissors.cuts.get());
        prop_assert!(found.len() > 2 && found.is_sorted_by(|one, other| one.1 < other.1), "{found:?}");
    }
}

/// Both ends and a timer in a single `select`: whenever one of them is ready, the others are dropped.
#[test]
fn one_task_may_select_both_ends_and_a_timer() {
    async fn serve(firmware: Rc<Firmware<1>>) {
        let (mut received, mut to_send) = ([0; 16], [0; 16]);
        let mut receiver = AsyncReceiver::new(firmware.uarts[0].clone(), &mut received);
        let mut transmitter = AsyncTransmitter::new(firmware.uarts[0].clone(), &mut to_send);
        loop {
            firmware.take_from(LINK, &mut receiver).expect("no error");
            let (has_bytes, deadline) = firmware.give_to(LINK, &mut transmitter);
            let sleep_or_send =
                async { if has_bytes { transmitter.send().await } else { firmware.sleep(LINK, deadline).await } };
            select(receiver.wait(), sleep_or_send).await;
        }
    }
    let firmware = Firmware::<1>::new(1);
    let (mut executor, mut gcs) = (Executor::default(), station());
    firmware.uarts[0].with(|uart| uart.piece = 3);
    executor.spawn(serve(Rc::clone(&firmware)));
    for round in 0..50 {
        let command = gcs.long(MavCmd::NAV_LAND, [round as f32; 7]);
        send(&firmware, 0, &mut gcs, &command);
        firmware.run_for(&mut executor, 20, 11);
    }
    firmware.run_for(&mut executor, 100, 11);
    assert_eq!(count(&firmware.uarts[0].with(|uart| whole_frames(&uart.sent)), CommandAck::ID), 50);
}

/// D-3: while a UART sends nothing, its own link receives and other links do both. Afterwards the answers are sent.
#[test]
fn a_transmitter_that_is_stuck_delays_nothing_else() {
    let firmware = Firmware::<2>::new(1);
    let (scissors, mut executor) = (Scissors::new(1, 0.0), Executor::default());
    for link in [LinkId(0), LinkId(1)] {
        executor.spawn(Rc::clone(&firmware).receive::<16>(link, Rc::clone(&scissors)));
        executor.spawn(Rc::clone(&firmware).transmit::<MAX_FRAME_LEN>(link, Rc::clone(&scissors)));
    }
    firmware.uarts[0].with(|uart| uart.capacity = 5);
    let mut stations = [station(), station()];
    for (round, command) in [MavCmd::NAV_LAND, MavCmd::NAV_TAKEOFF].into_iter().enumerate() {
        for (link, gcs) in stations.iter_mut().enumerate() {
            let command = gcs.long(command, [round as f32; 7]);
            send(&firmware, link, gcs, &command);
        }
        for _ in 0..3_000 {
            firmware.pulse.tick();
            firmware.uarts[1].drain(11);
            firmware.set_time(firmware.now() + millis(1));
            executor.run();
        }
    }
    assert_eq!(firmware.stack.borrow().1.commands().len(), 4);
    let ids = firmware.uarts[1].with(|uart| whole_frames(&uart.sent));
    assert_eq!((count(&ids, CommandAck::ID), count(&ids, Heartbeat::ID)), (2, 6));
    assert_eq!(firmware.uarts[0].with(|uart| uart.sent.len()), 0);
    // The tasks of both links slept meanwhile.
    assert!(executor.polls() < 200, "{} polls", executor.polls());
    firmware.run_for(&mut executor, 100, 11);
    let ids = firmware.uarts[0].with(|uart| whole_frames(&uart.sent));
    assert_eq!(count(&ids, CommandAck::ID), 2);
}

/// H-5: a UART with a long buffer holds one frame at most. So no heartbeat is sent that is older than that, when flight has
/// stopped.
#[test]
fn no_heartbeat_waits_behind_another_frame() {
    let firmware = Firmware::<1>::new(1);
    let mut executor = Executor::default();
    firmware.uarts[0].with(|uart| uart.capacity = 10_000);
    executor.spawn(Rc::clone(&firmware).transmit::<MAX_FRAME_LEN>(LINK, Scissors::new(1, 0.0)));
    firmware.run_for(&mut executor, 5_000, 0);
    for _ in 0..3_000 {
        firmware.step(&mut executor, 11);
    }
    let ids = firmware.uarts[0].with(|uart| whole_frames(&uart.sent));
    assert_eq!(count(&ids, Heartbeat::ID), 1);
}

/// H-5: nor if the wait for the UART is dropped: the transmitter takes no other frame before the last one has left it.
#[test]
fn a_dropped_flush_is_awaited_again() {
    let firmware = Firmware::<1>::new(1);
    let mut executor = Executor::default();
    firmware.uarts[0].with(|uart| uart.capacity = 10_000);
    // Each `send` is dropped, as soon as it is pending.
    executor.spawn(Rc::clone(&firmware).transmit_impatiently(LINK));
    firmware.run_for(&mut executor, 5_000, 0);
    let queued = firmware.uarts[0].with(|uart| uart.fifo.iter().copied().collect::<Vec<_>>());
    assert_eq!(whole_frames(&queued), [Heartbeat::ID]);
    firmware.run_for(&mut executor, 3_000, 11);
    assert!(count(&firmware.uarts[0].with(|uart| whole_frames(&uart.sent)), Heartbeat::ID) >= 3);
}

/// D-3: a task whose transport fails at once, or whose backlog is long, lets the other tasks of its executor run.
#[test]
fn a_receiver_that_never_waits_lets_other_tasks_run() {
    for fail in [true, false] {
        let firmware = Firmware::<1>::new(1);
        let (ran, mut executor) = (Rc::new(std::cell::Cell::new(0)), Executor::default());
        let (receiving, counted) = (Rc::clone(&firmware), Rc::clone(&ran));
        firmware.uarts[0].with(|uart| uart.received.extend([0; 64]));
        executor.spawn(async move {
            let mut buffer = [0; 64];
            let mut receiver = AsyncReceiver::new(receiving.uarts[0].clone(), &mut buffer).with_piece(1);
            for round in 0..50 {
                if fail {
                    receiving.uarts[0].with(|uart| uart.read_error = Some(LineError::Injected));
                }
                receiver.wait().await;
                let _ = receiving.take_from(LINK, &mut receiver);
                assert!(counted.get() >= round, "the other task did not run");
            }
        });
        executor.spawn(async move {
            loop {
                ran.set(ran.get() + 1);
                lab::pending_once().await;
                if ran.get() == 60 {
                    return;
                }
            }
        });
        executor.run();
        assert_eq!(firmware.errors.borrow().len(), if fail { 50 } else { 0 });
    }
}

/// D-4: tasks that have nothing to do sleep until their own link's deadline, and do not wake each other.
#[test]
fn idle_tasks_sleep() {
    let firmware = Firmware::<3>::new(1);
    let (scissors, mut executor) = (Scissors::new(1, 0.0), Executor::default());
    for link in (0..3).map(LinkId) {
        executor.spawn(Rc::clone(&firmware).receive::<16>(link, Rc::clone(&scissors)));
        executor.spawn(Rc::clone(&firmware).transmit::<MAX_FRAME_LEN>(link, Rc::clone(&scissors)));
    }
    firmware.run_for(&mut executor, 500, 11);
    let before = executor.polls();
    firmware.run_for(&mut executor, 10_000, 11);
    for uart in &firmware.uarts {
        assert!(uart.with(|uart| count(&whole_frames(&uart.sent), Heartbeat::ID)) >= 10);
    }
    // A heartbeat wakes its task by the timer, and when it has left the UART.
    let polls = executor.polls() - before;
    assert!(polls <= 3 * 10 * 8, "{polls} polls");
}

/// D-4: a link's deadline is its own: an answer that is pending on another link is not in it.
#[test]
fn the_deadline_of_a_link_is_its_own() {
    let firmware = Firmware::<2>::new(1);
    let frame = {
        let mut gcs = station();
        let command = gcs.long(MavCmd::NAV_LAND, [1.0; 7]);
        gcs.frame_from(STATION, &command)
    };
    let (stack, vehicle) = &mut *firmware.stack.borrow_mut();
    // The links wait no longer for a heartbeat.
    stack.poll(firmware.now(), vehicle);
    let now = Instant::from_millis(500);
    for (at, link) in [firmware.now(), now].into_iter().flat_map(|at| [(at, LinkId(0)), (at, LinkId(1))]) {
        assert_eq!(stack.transmit(at, link, vehicle), [0_u8; 0]);
    }
    stack.receive(now, LinkId(1), &frame, vehicle);
    stack.poll(now, vehicle);
    assert!(stack.link_deadline(now, LinkId(0)) > now);
    assert_eq!((stack.link_deadline(now, LinkId(1)), stack.next_deadline(now)), (now, now));
}

/// D-2: a call says that frames are pending which exceed its budget, although the stack has taken all bytes.
#[test]
fn a_call_says_that_frames_are_pending() {
    let firmware = Firmware::<1>::with_budget(1, PollBudget { frames: 1, ..PollBudget::DEFAULT });
    let (mut executor, mut gcs) = (Executor::default(), station());
    for _ in 0..3 {
        send(&firmware, 0, &mut gcs, &Gcs::heartbeat());
    }
    let shared = Rc::clone(&firmware);
    executor.spawn(async move {
        let mut buffer = [0; 64];
        let mut receiver = AsyncReceiver::new(shared.uarts[0].clone(), &mut buffer);
        receiver.wait().await;
        let results = [(); 3].map(|()| shared.take_from(LINK, &mut receiver));
        assert_eq!(results, [Ok(true), Ok(true), Ok(false)]);
    });
    executor.run();
    assert_eq!(firmware.stack.borrow().0.rx_counters(LINK).map(|counters| counters.frames), Some(3));
}

/// D-2: frames that exceed the budget of a call are handled without another byte being received.
#[test]
fn a_backlog_is_handled() {
    let firmware = Firmware::<1>::with_budget(1, PollBudget { frames: 1, ..PollBudget::DEFAULT });
    let (scissors, mut executor) = (Scissors::new(1, 0.0), Executor::default());
    executor.spawn(Rc::clone(&firmware).receive::<300>(LINK, Rc::clone(&scissors)));
    executor.spawn(Rc::clone(&firmware).transmit::<64>(LINK, scissors));
    let mut gcs = station();
    for _ in 0..100 {
        send(&firmware, 0, &mut gcs, &Gcs::heartbeat());
    }
    firmware.run_for(&mut executor, 1, 11);
    let counters = firmware.stack.borrow().0.rx_counters(LINK).expect("the link");
    assert_eq!((counters.frames, counters.skipped), (100, 0));
}

/// D-2: a call takes at most a piece, and says whether more is pending. The last call takes what is left.
#[test]
fn a_piece_bounds_one_call() {
    let firmware = Firmware::<1>::new(1);
    let (mut executor, mut gcs) = (Executor::default(), station());
    for _ in 0..4 {
        send(&firmware, 0, &mut gcs, &Gcs::heartbeat());
    }
    let calls = Rc::new(std::cell::Cell::new(0));
    let counted = (Rc::clone(&firmware), Rc::clone(&calls));
    executor.spawn(async move {
        let (firmware, calls) = counted;
        let mut buffer = [0; 64];
        let mut receiver = AsyncReceiver::new(firmware.uarts[0].clone(), &mut buffer).with_piece(16);
        receiver.wait().await;
        while firmware.take_from(LINK, &mut receiver).expect("no error") {
            calls.set(calls.get() + 1);
            let received = firmware.stack.borrow().0.rx_counters(LINK).expect("the link").frames;
            assert!(received <= calls.get() * 16 / 21);
            receiver.wait().await;
        }
    });
    firmware.run_for(&mut executor, 1, 11);
    assert_eq!(calls.get(), 3);
    assert_eq!(firmware.uarts[0].with(|uart| uart.received.len()), 4 * 21 - 64, "the task has ended");
}

/// S-20: an overrun is reported and counted once, and reception continues. The end of the stream ends the task.
#[test]
fn read_errors_are_counted_and_the_end_is_reported() {
    let firmware = Firmware::<1>::new(1);
    let mut executor = Executor::default();
    executor.spawn(Rc::clone(&firmware).receive::<16>(LINK, Scissors::new(1, 0.0)));
    let mut gcs = station();
    for expected in 1..=3 {
        firmware.uarts[0].with(|uart| uart.read_error = Some(LineError::Overrun));
        let command = gcs.long(MavCmd::NAV_LAND, [expected as f32; 7]);
        send(&firmware, 0, &mut gcs, &command);
        firmware.run_for(&mut executor, 1, 11);
        assert_eq!(firmware.errors.take(), [(LINK, LinkError::Read(LineError::Overrun))]);
        let (stack, vehicle) = &*firmware.stack.borrow();
        assert_eq!(stack.link_counters(LINK).map(|counters| counters.read_errors), Some(expected));
        assert_eq!(vehicle.commands().len(), expected as usize);
    }
    firmware.uarts[0].with(|uart| uart.closed = true);
    firmware.run_for(&mut executor, 10, 11);
    assert_eq!(*firmware.errors.borrow(), [(LINK, LinkError::Closed)]);
    assert_eq!(firmware.stack.borrow().0.link_counters(LINK).map(|counters| counters.read_errors), Some(3));
}

/// A write that fails is reported and counted once, and costs one frame. The next ones are sent.
#[test]
fn write_errors_are_counted_and_cost_one_frame() {
    type Fail = fn(&mut lab::State);
    // The last number: the bytes of the frame that were sent, behind its first one. Its rest is not.
    let failures: [(Fail, LinkError<LineError>, u32); 3] = [
        (|uart| uart.write_error = Some(LineError::Injected), LinkError::Write(LineError::Injected), 0),
        (|uart| uart.flush_error = Some(LineError::Injected), LinkError::Write(LineError::Injected), 15),
        (|uart| uart.closed = true, LinkError::Closed, 0),
    ];
    for (fail, expected, bytes) in failures {
        let firmware = Firmware::<1>::new(1);
        let mut executor = Executor::default();
        executor.spawn(Rc::clone(&firmware).transmit::<16>(LINK, Scissors::new(1, 0.0)));
        firmware.run_for(&mut executor, 1_500, 11);
        firmware.uarts[0].with(fail);
        firmware.run_for(&mut executor, 1_000, 11);
        assert_eq!(*firmware.errors.borrow(), [(LINK, expected)]);
        firmware.uarts[0].with(|uart| uart.closed = false);
        firmware.run_for(&mut executor, 3_000, 11);
        let stack = &firmware.stack.borrow().0;
        assert_eq!(stack.link_counters(LINK).map(|counters| counters.write_errors), Some(1));
        let (found, skipped) = firmware.uarts[0].with(|uart| frames(&uart.sent));
        assert_eq!(skipped, bytes, "{expected:?}");
        let sent = stack.link_counters(LINK).expect("the link").tx_frames as usize;
        assert_eq!(found.len(), sent - 1, "{expected:?}");
    }
}

/// A transport that was opened again gets new ends. A heartbeat is sent first (H-17), then the frame that was cut off,
/// from its start.
#[test]
fn a_transport_that_is_opened_again_gets_whole_frames() {
    let firmware = Firmware::<1>::new(1);
    let mut executor = Executor::default();
    let scissors = Scissors::new(1, 0.0);
    executor.spawn(Rc::clone(&firmware).transmit::<16>(LINK, Rc::clone(&scissors)));
    firmware.run_for(&mut executor, 1_500, 11);
    let mut gcs = station();
    let ping = gcs.frame_from(STATION, &Ping { seq: 7, ..Ping::default() });
    {
        let (stack, vehicle) = &mut *firmware.stack.borrow_mut();
        stack.receive(firmware.now(), LINK, &ping, vehicle);
    }
    firmware.wake_transmitters();
    firmware.uarts[0].with(|uart| uart.sent.clear());
    firmware.run_for(&mut executor, 2, 11);
    let begun = firmware.uarts[0].with(|uart| std::mem::take(&mut uart.sent));
    assert!((1..20).contains(&begun.len()), "the frame is cut off");

    drop(executor);
    firmware.uarts[0].with(|uart| uart.fifo.clear());
    firmware.stack.borrow_mut().0.restart_link(LINK);
    let mut executor = Executor::default();
    executor.spawn(Rc::clone(&firmware).transmit::<16>(LINK, scissors));
    firmware.run_for(&mut executor, 100, 11);
    let (found, skipped) = firmware.uarts[0].with(|uart| frames(&uart.sent));
    let ids: Vec<u32> = found.into_iter().map(|frame| frame.0).collect();
    assert_eq!((&ids[..], skipped), (&[Heartbeat::ID, Ping::ID][..], 0));
}

/// A link that the stack does not have is reported, and no byte is sent.
#[test]
fn a_missing_link_is_reported() {
    const MISSING: LinkId = LinkId(1);
    let firmware = Firmware::<1>::new(1);
    let (mut received, mut to_send) = ([0; 4], [0; 4]);
    let mut receiver = AsyncReceiver::new(firmware.uarts[0].clone(), &mut received);
    let mut transmitter = AsyncTransmitter::new(firmware.uarts[0].clone(), &mut to_send);
    assert_eq!(firmware.take_from(MISSING, &mut receiver), Err(LinkError::NoSuchLink));
    assert!(!firmware.give_to(MISSING, &mut transmitter).0);
    assert_eq!(*firmware.errors.borrow(), [(MISSING, LinkError::NoSuchLink); 2]);
}

/// SEC-15: received bytes may be a key, so none of them is shown.
#[test]
fn the_ends_show_no_bytes() {
    let mut buffer = [77; 4];
    let receiver = AsyncReceiver::new(lab::Uart::new(1), &mut buffer);
    assert_eq!(format!("{receiver:?}"), "AsyncReceiver { pending: 0, .. }");
    let mut buffer = [77; 4];
    let transmitter = AsyncTransmitter::new(lab::Uart::new(1), &mut buffer);
    assert_eq!(format!("{transmitter:?}"), "AsyncTransmitter { pending: 0, .. }");
}

/// while a UART fails, its task gets one error every 100 ms, and nothing to send in between, however much is pending.
#[test]
fn failing_uart_does_not_keep_its_task_awake() {
    let firmware = Firmware::<1>::new(1);
    let mut buffer = [0; 16];
    let mut transmitter = AsyncTransmitter::new(firmware.uarts[0].clone(), &mut buffer);
    firmware.uarts[0].with(|uart| uart.closed = true);
    let (stack, vehicle) = &mut *firmware.stack.borrow_mut();
    let (mut errors, mut sent) = (0, 0);
    for ms in 0..2_000 {
        let now = Instant::from_millis(ms);
        firmware.pulse.tick();
        stack.poll(now, vehicle);
        stack.text(now, MavSeverity::INFO, &format!("Text {ms}"));
        // A task that does not sleep.
        for _ in 0..10 {
            match stack.transmit_to(now, LINK, &mut transmitter, vehicle) {
                Ok(true) => {
                    sent += 1;
                    assert!(pin!(transmitter.send()).poll(&mut Context::from_waker(Waker::noop())).is_ready());
                }
                Ok(false) => {
                    let deadline = stack.link_deadline(now, LINK);
                    assert!(errors == 0 || deadline > now, "{deadline:?} at {now:?}");
                }
                Err(error) => {
                    assert_eq!(error, LinkError::Closed);
                    errors += 1;
                }
            }
        }
    }
    assert!((18..=20).contains(&errors) && sent == errors, "{errors} errors, {sent} frames");
}
