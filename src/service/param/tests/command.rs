//! MAV_CMD_PREFLIGHT_STORAGE, and when there is something to write (P-17, SEC-12).

use super::*;

const ACCEPTED: Option<MavResult> = Some(MavResult::ACCEPTED);
const DENIED: Option<MavResult> = Some(MavResult::DENIED);
const NONE: f32 = f32::NAN;

fn with_storage() -> Bench {
    let mut bench = Bench::new();
    bench.params.loaded(&mut bench.vehicle, true);
    bench
}

impl Bench {
    /// After how many ms a write begins, within two minutes.
    fn begins(&mut self) -> Option<u64> {
        (0..120_000 / 100).find_map(|step| {
            let job = self.params.unsaved(self.now, &mut self.vehicle);
            if job.is_none() {
                self.wait(100);
            }
            job.map(|_| step * 100)
        })
    }

    fn is_due(&mut self) -> bool {
        self.params.unsaved(self.now, &mut self.vehicle).is_some()
    }

    fn set_byte(&mut self, value: u32) {
        self.send(A, &set("BYTE", MavParamType::UINT8, value));
    }
}

/// P-17: 2 resets what can be set, 4 everything; everybody is told of what changed, the vehicle first.
#[test]
fn all_are_reset() {
    for (action, locked) in [(2.0, 5), (4.0, 4_000_000_000)] {
        let mut bench = Bench::new();
        bench.vehicle.table.set(Table::LOCKED, 5);
        bench.vehicle.table.set(Table::SMALL, 3);
        bench.vehicle.table.set(Table::ALT_MIN, 3.0);
        bench.poll();
        bench.drain();
        assert_eq!(bench.command([action, -1.0, 0.0, 0.0]), ACCEPTED);
        let told = if action == 2.0 { vec![0, 5] } else { vec![0, 3, 5] };
        assert_eq!(bench.vehicle.changed.iter().map(|(index, _)| *index).collect::<Vec<_>>(), told);
        let values: Vec<_> = told.into_iter().map(|index| bench.value(index)).collect();
        assert_eq!(bench.drain(), [values.clone(), values]);
        assert_eq!((bench.vehicle.table.get(Table::SMALL), bench.vehicle.table.get(Table::LOCKED)), (-1, locked));
    }
}

/// C-4, P-17: what is no action, or not ours, is DENIED; nothing at all is done.
#[test]
fn what_is_no_action_is_denied() {
    let mut bench = with_storage();
    bench.vehicle.table.set(Table::SMALL, 3);
    for (params, result) in [
        ([3.0, -1.0, 0.0, 0.0], DENIED),
        ([5.0, -1.0, 0.0, 0.0], DENIED),
        ([-2.0, -1.0, 0.0, 0.0], DENIED),
        ([1.5, -1.0, 0.0, 0.0], DENIED),
        ([f32::INFINITY, -1.0, 0.0, 0.0], DENIED),
        // To reset missions is another command's.
        ([2.0, 2.0, 0.0, 0.0], DENIED),
        ([-1.0, f32::INFINITY, 0.0, 0.0], DENIED),
        ([-1.0, -1.0, 0.0, 0.0], ACCEPTED),
        ([NONE, NONE, NONE, NONE], ACCEPTED),
        ([-1.0, 0.0, 0.0, 0.0], ACCEPTED),
        ([-1.0, 1.0, 0.0, 0.0], ACCEPTED),
    ] {
        assert_eq!(bench.command(params), result, "{params:?}");
    }
    assert_eq!(bench.vehicle.table.get(Table::SMALL), 3);
    assert!(!bench.params.wants_reload(&mut bench.vehicle) && !bench.is_due());
    assert_eq!(bench.command_of(MavCmd::PREFLIGHT_CALIBRATION, [2.0, 0.0, 0.0, 0.0]), None);
}

/// P-17: not in flight.
#[test]
fn nothing_is_reset_while_armed() {
    let mut bench = Bench::new();
    bench.vehicle.table.set(Table::SMALL, 3);
    bench.vehicle.is_armed = true;
    assert_eq!(bench.command([2.0, -1.0, 0.0, 0.0]), Some(MavResult::TEMPORARILY_REJECTED));
    assert_eq!(bench.vehicle.table.get(Table::SMALL), 3);
    // C-5: what can never be is not put off.
    for params in [[0.0, -1.0], [1.0, -1.0], [3.0, -1.0], [0.5, -1.0], [2.0, 2.0]] {
        assert_eq!(bench.command([params[0], params[1], 0.0, 0.0]), Some(MavResult::DENIED), "{params:?}");
    }
}

/// P-17: what is not there can be neither read nor written.
#[test]
fn without_storage_nothing_is_stored() {
    let mut bench = Bench::new();
    for action in [0.0, 1.0] {
        assert_eq!(bench.command([action, -1.0, 0.0, 0.0]), DENIED);
    }
    bench.set_byte(9);
    assert_eq!(bench.begins(), None);
    assert_eq!(bench.params.deadline(), Instant::NEVER);
}

/// P-17, SEC-12: a second behind the first change, with all that came since; then not for ten seconds.
#[test]
fn changes_are_collected() {
    let mut bench = with_storage();
    assert_eq!(bench.begins(), None);
    bench.set_byte(9);
    assert_eq!(bench.params.deadline(), bench.now.after(Duration::from_secs(1)));
    bench.wait(500);
    bench.set_byte(10);
    assert_eq!(bench.begins(), Some(500));
    bench.params.saved(bench.now, &mut bench.vehicle);
    assert!(!bench.is_due());
    bench.wait(2_000);
    bench.vehicle.table.set(Table::SMALL, 3);
    assert_eq!(bench.begins(), Some(8_000), "what the vehicle sets is stored as well");
}

/// P-17: what is volatile is not stored.
#[test]
fn a_volatile_change_is_not_written() {
    let mut bench = with_storage();
    bench.vehicle.table.set(Table::NOISE, 0.75);
    bench.send(A, &set("NOISE", MavParamType::REAL32, 0.25f32.to_bits()));
    assert_eq!(bench.begins(), None);
}

/// P-17: a change while a write goes on does not begin it anew, and leads to another one.
#[test]
fn a_change_during_a_write_is_written_later() {
    let mut bench = with_storage();
    bench.set_byte(9);
    assert_eq!(bench.begins(), Some(1_000));
    let job = bench.params.unsaved(bench.now, &mut bench.vehicle);
    bench.set_byte(10);
    bench.wait(100);
    assert_eq!(bench.params.unsaved(bench.now, &mut bench.vehicle), job);
    bench.params.saved(bench.now, &mut bench.vehicle);
    assert_eq!(bench.begins(), Some(10_000));
    assert_ne!(bench.params.unsaved(bench.now, &mut bench.vehicle), job);
}

/// P-17: the operator need not wait.
#[test]
fn a_write_that_was_asked_for_begins_at_once() {
    let mut bench = with_storage();
    bench.set_byte(9);
    assert_eq!(bench.command([1.0, -1.0, 0.0, 0.0]), ACCEPTED);
    assert!(bench.is_due());
    bench.params.saved(bench.now, &mut bench.vehicle);
    bench.set_byte(10);
    assert!(!bench.is_due());
    assert_eq!(bench.command([1.0, -1.0, 0.0, 0.0]), ACCEPTED);
    assert!(bench.is_due());
    bench.params.saved(bench.now, &mut bench.vehicle);
    assert_eq!(bench.command([2.0, -1.0, 0.0, 0.0]), ACCEPTED);
    assert!(bench.is_due(), "nor after a reset");
    bench.params.saved(bench.now, &mut bench.vehicle);
    assert_eq!(bench.command([1.0, -1.0, 0.0, 0.0]), ACCEPTED);
    assert!(!bench.is_due(), "there is nothing to write");
}

/// P-14, last row: the value stays, a text says it once, and it is tried again.
#[test]
fn a_failure_is_told_once_and_tried_again() {
    let mut bench = with_storage();
    bench.set_byte(9);
    for (attempt, wait) in [1_000, 10_000, 10_000].into_iter().enumerate() {
        assert_eq!(bench.begins(), Some(wait), "attempt {attempt}");
        let mut cx = Context { now: bench.now, texts: &mut bench.texts, normal: both_links() };
        bench.params.not_saved(&mut cx, &mut bench.vehicle);
        let told = if attempt == 0 { vec!["Parameters not saved"] } else { vec![] };
        assert_eq!(bench.texts(0), told);
    }
    assert_eq!(bench.begins(), Some(10_000));
    bench.params.saved(bench.now, &mut bench.vehicle);
    assert_eq!((bench.begins(), bench.vehicle.table.get(Table::BYTE)), (None, 9));
    // After a success the next failure is news.
    bench.set_byte(10);
    assert!(bench.begins().is_some());
    let mut cx = Context { now: bench.now, texts: &mut bench.texts, normal: both_links() };
    bench.params.not_saved(&mut cx, &mut bench.vehicle);
    assert_eq!(bench.texts(0), ["Parameters not saved"]);
}

/// P-17: the stored values come back.
#[test]
fn the_stored_values_come_back() {
    let mut bench = with_storage();
    let stored = bench.vehicle.table.table_mut().stored(1).expect("exists");
    bench.set_byte(9);
    bench.drain();
    assert_eq!(bench.command([0.0, -1.0, 0.0, 0.0]), ACCEPTED);
    assert!(bench.params.wants_reload(&mut bench.vehicle));
    bench.params.load(&mut bench.vehicle, &stored, both_links(), false);
    bench.params.loaded(&mut bench.vehicle, true);
    assert!(!bench.params.wants_reload(&mut bench.vehicle) && !bench.is_due());
    let value = bench.value(1);
    assert_eq!(bench.drain(), [vec![value.clone()], vec![value]]);
    assert_eq!(bench.vehicle.changed, [(1, 9), (1, 7)]);
}
