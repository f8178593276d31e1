//! MAV_CMD_PREFLIGHT_STORAGE, and when there is something to write (P-17, SEC-12).

use super::*;

const ACCEPTED: Option<MavResult> = Some(MavResult::ACCEPTED);
const DENIED: Option<MavResult> = Some(MavResult::DENIED);
const NONE: f32 = f32::NAN;

fn with_storage() -> Bench {
    let mut bench = Bench::new();
    bench.params.saving(&mut bench.table, |saving| saving.loaded(true));
    bench
}

impl Bench {
    /// Returns after how many ms a write begins, within two minutes.
    fn begins(&mut self) -> Option<u64> {
        (0..120_000 / 100).find_map(|step| {
            let job = self.params.pending_write(self.now, &mut self.table);
            if job.is_none() {
                self.wait(100);
            }
            job.map(|_| step * 100)
        })
    }

    fn is_due(&mut self) -> bool {
        self.params.pending_write(self.now, &mut self.table).is_some()
    }

    /// Reports that storage failed.
    fn not_saved(&mut self) {
        let (params, mut cx, _) = self.parts();
        params.on_save_failed(&mut cx);
    }

    fn set_byte(&mut self, value: u32) {
        self.send(A, &set("BYTE", MavParamType::UINT8, value));
    }
}

/// P-17: action 2 resets parameters that are not read-only, 4 all of them. Changed values are reported to the vehicle first,
/// then sent on all links.
#[test]
fn all_are_reset() {
    for (action, locked) in [(2.0, 5), (4.0, 4_000_000_000)] {
        let mut bench = Bench::new();
        bench.table.set(Table::LOCKED, 5);
        bench.table.set(Table::SMALL, 3);
        bench.table.set(Table::ALT_MIN, 3.0);
        bench.poll();
        bench.drain();
        assert_eq!(bench.command([action, -1.0, 0.0, 0.0]), ACCEPTED);
        assert_eq!(bench.drain(), [vec![], vec![]], "the next poll begins (X-6)");
        bench.poll();
        let indices = if action == 2.0 { vec![0, 5] } else { vec![0, 3, 5] };
        assert_eq!(bench.vehicle.changed.iter().map(|(index, _)| *index).collect::<Vec<_>>(), indices);
        let values: Vec<_> = indices.into_iter().map(|index| bench.value(index)).collect();
        assert_eq!(bench.drain(), [values.clone(), values]);
        assert_eq!((bench.table.get(Table::SMALL), bench.table.get(Table::LOCKED)), (-1, locked));
    }
}

/// P-17, X-6: a reset of all parameters stays one when a reset of fewer is requested meanwhile: both are answered ACCEPTED.
#[test]
fn a_reset_of_all_stays_one() {
    let mut bench = Bench::new();
    bench.table.set(Table::LOCKED, 5);
    bench.poll();
    assert_eq!(bench.command([4.0, -1.0, 0.0, 0.0]), ACCEPTED);
    assert_eq!(bench.command([2.0, -1.0, 0.0, 0.0]), ACCEPTED);
    bench.poll();
    assert_eq!(bench.table.get(Table::LOCKED), 4_000_000_000);
    bench.table.set(Table::LOCKED, 5);
    assert_eq!(bench.command([2.0, -1.0, 0.0, 0.0]), ACCEPTED);
    bench.poll();
    assert_eq!(bench.table.get(Table::LOCKED), 5, "the next one is of fewer again");
}

/// C-4, P-17: an unknown or unsupported action is DENIED, and nothing is done.
#[test]
fn unknown_actions_are_denied() {
    let mut bench = with_storage();
    bench.table.set(Table::SMALL, 3);
    for (params, result) in [
        ([3.0, -1.0, 0.0, 0.0], DENIED),
        ([5.0, -1.0, 0.0, 0.0], DENIED),
        ([-2.0, -1.0, 0.0, 0.0], DENIED),
        ([1.5, -1.0, 0.0, 0.0], DENIED),
        ([f32::INFINITY, -1.0, 0.0, 0.0], DENIED),
        // Missions are reset by another command.
        ([2.0, 2.0, 0.0, 0.0], DENIED),
        ([-1.0, f32::INFINITY, 0.0, 0.0], DENIED),
        ([-1.0, -1.0, 0.0, 0.0], ACCEPTED),
        ([NONE, NONE, NONE, NONE], ACCEPTED),
        ([-1.0, 0.0, 0.0, 0.0], ACCEPTED),
        ([-1.0, 1.0, 0.0, 0.0], ACCEPTED),
    ] {
        assert_eq!(bench.command(params), result, "{params:?}");
    }
    assert_eq!(bench.table.get(Table::SMALL), 3);
    assert!(!bench.params.is_reload_requested(&mut bench.table) && !bench.is_due());
    assert_eq!(bench.command_of(MavCmd::PREFLIGHT_CALIBRATION, [2.0, 0.0, 0.0, 0.0]), None);
}

/// P-17: no reset while armed.
#[test]
fn nothing_is_reset_while_armed() {
    let mut bench = Bench::new();
    bench.table.set(Table::SMALL, 3);
    bench.vehicle.is_armed = true;
    assert_eq!(bench.command([2.0, -1.0, 0.0, 0.0]), Some(MavResult::TEMPORARILY_REJECTED));
    assert_eq!(bench.table.get(Table::SMALL), 3);
    // C-5: an invalid action is DENIED, not TEMPORARILY_REJECTED.
    for params in [[0.0, -1.0], [1.0, -1.0], [3.0, -1.0], [0.5, -1.0], [2.0, 2.0]] {
        assert_eq!(bench.command([params[0], params[1], 0.0, 0.0]), Some(MavResult::DENIED), "{params:?}");
    }
}

/// P-17: without storage, nothing can be loaded or stored.
#[test]
fn without_storage_nothing_is_stored() {
    let mut bench = Bench::new();
    for action in [0.0, 1.0] {
        assert_eq!(bench.command([action, -1.0, 0.0, 0.0]), DENIED);
    }
    bench.set_byte(9);
    assert_eq!(bench.begins(), None);
    assert_eq!(bench.deadline(), Instant::NEVER);
}

/// P-17, SEC-12: a write begins a second after the first change and includes all later ones; the next one not within ten
/// seconds.
#[test]
fn changes_are_collected() {
    let mut bench = with_storage();
    assert_eq!(bench.begins(), None);
    bench.set_byte(9);
    assert_eq!(bench.deadline(), bench.now + Duration::from_secs(1));
    bench.wait(500);
    bench.set_byte(10);
    assert_eq!(bench.begins(), Some(500));
    bench.params.on_saved(bench.now, &mut bench.table);
    assert!(!bench.is_due());
    bench.wait(2_000);
    bench.table.set(Table::SMALL, 3);
    assert_eq!(bench.begins(), Some(8_000), "values set by the vehicle are stored too");
}

/// P-17: volatile parameters are not stored.
#[test]
fn a_volatile_change_is_not_written() {
    let mut bench = with_storage();
    bench.table.set(Table::NOISE, 0.75);
    bench.send(A, &set("NOISE", MavParamType::REAL32, 0.25f32.to_bits()));
    assert_eq!(bench.begins(), None);
}

/// P-17: a change during a write does not restart it, but causes another write.
#[test]
fn a_change_during_a_write_is_written_later() {
    let mut bench = with_storage();
    bench.set_byte(9);
    assert_eq!(bench.begins(), Some(1_000));
    let job = bench.params.pending_write(bench.now, &mut bench.table);
    bench.set_byte(10);
    bench.wait(100);
    assert_eq!(bench.params.pending_write(bench.now, &mut bench.table), job);
    bench.params.on_saved(bench.now, &mut bench.table);
    assert_eq!(bench.begins(), Some(10_000));
    assert_ne!(bench.params.pending_write(bench.now, &mut bench.table), job);
}

/// P-17: the operator does not have to wait.
#[test]
fn a_requested_write_begins_at_once() {
    let mut bench = with_storage();
    bench.set_byte(9);
    assert_eq!(bench.command([1.0, -1.0, 0.0, 0.0]), ACCEPTED);
    assert!(bench.is_due());
    bench.params.on_saved(bench.now, &mut bench.table);
    bench.set_byte(10);
    assert!(!bench.is_due());
    assert_eq!(bench.command([1.0, -1.0, 0.0, 0.0]), ACCEPTED);
    assert!(bench.is_due());
    bench.params.on_saved(bench.now, &mut bench.table);
    assert_eq!(bench.command([2.0, -1.0, 0.0, 0.0]), ACCEPTED);
    bench.poll();
    assert!(bench.is_due(), "nor after a reset");
    bench.params.on_saved(bench.now, &mut bench.table);
    assert_eq!(bench.command([1.0, -1.0, 0.0, 0.0]), ACCEPTED);
    assert!(!bench.is_due(), "there is nothing to write");
}

/// P-14, last row: after a failure the value stays, one text reports it, and the write is retried.
#[test]
fn a_failure_is_reported_once_and_retried() {
    let mut bench = with_storage();
    bench.set_byte(9);
    for (attempt, wait) in [1_000, 10_000, 10_000].into_iter().enumerate() {
        assert_eq!(bench.begins(), Some(wait), "attempt {attempt}");
        bench.not_saved();
        let texts = if attempt == 0 { vec!["Parameters not saved"] } else { vec![] };
        assert_eq!(bench.texts(0), texts);
    }
    assert_eq!(bench.begins(), Some(10_000));
    bench.params.on_saved(bench.now, &mut bench.table);
    assert_eq!((bench.begins(), bench.table.get(Table::BYTE)), (None, 9));
    // After a success, the next failure is reported.
    bench.set_byte(10);
    assert!(bench.begins().is_some());
    bench.not_saved();
    assert_eq!(bench.texts(0), ["Parameters not saved"]);
}

/// P-17: the stored values are loaded again.
#[test]
fn the_stored_values_are_loaded_again() {
    let mut bench = with_storage();
    let (_, stored) = bench.table.table_mut().stored(1).expect("exists");
    bench.set_byte(9);
    bench.drain();
    assert!(bench.begins().is_some());
    bench.params.on_saved(bench.now, &mut bench.table);
    assert_eq!(bench.command([0.0, -1.0, 0.0, 0.0]), ACCEPTED);
    assert!(bench.params.is_reload_requested(&mut bench.table));
    let replaced = |saving: &mut Saving| saving.replaced(false);
    assert_eq!(bench.params.saving(&mut bench.table, replaced), Replaced::All);
    let (params, mut cx, _) = bench.parts();
    params.load(&mut cx, 1, &stored, false);
    bench.params.saving(&mut bench.table, |saving| saving.loaded(true));
    assert!(!bench.params.is_reload_requested(&mut bench.table) && !bench.is_due());
    let value = bench.value(1);
    assert_eq!(bench.drain(), [vec![value.clone()], vec![value]]);
    assert_eq!(bench.vehicle.changed, [(1, 9), (1, 7)]);
}

/// C-15: a request for the stored values takes back no value that was acknowledged: it is refused while one is not stored, which is then
/// written at once. What is set between the request and reading stays.
#[test]
fn a_reload_takes_nothing_back() {
    let mut bench = with_storage();
    bench.set_byte(9);
    assert_eq!(bench.command([0.0, -1.0, 0.0, 0.0]), Some(MavResult::TEMPORARILY_REJECTED));
    assert!(!bench.params.is_reload_requested(&mut bench.table) && bench.is_due());
    assert_eq!(bench.command([0.0, -1.0, 0.0, 0.0]), Some(MavResult::TEMPORARILY_REJECTED), "it is being written");
    bench.params.on_saved(bench.now, &mut bench.table);
    assert_eq!(bench.command([0.0, -1.0, 0.0, 0.0]), ACCEPTED);
    bench.set_byte(10);
    let mut replaced = |is_late| bench.params.saving(&mut bench.table, |saving| saving.replaced(is_late));
    assert_eq!([replaced(false), replaced(true)], [Replaced::Nothing, Replaced::Defaults]);
    bench.params.saving(&mut bench.table, |saving| saving.loaded(true));
    assert!(bench.begins().is_some(), "it is stored later");
}
