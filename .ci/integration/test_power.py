"""After a power cut at any moment, each plan is the old one or the new one (SEC-11, M-1, M-44)."""

import functools
import math
import time
from collections import Counter

import pytest
from plans import ALL, FENCE, MISSION, PLANS, RALLY, differences
from transfer import (
    ACCEPTED,
    ask_count,
    clear_all,
    download,
    ids,
    next_word,
    plan_id,
    upload,
    upload_part,
)

# In QEMU the vehicle starts 25 times in a test, with an upload and a download each time.
pytestmark = pytest.mark.timeout(600)

# The number of moments at which the power is cut.
POSITIONS = {"qemu": 22, "sitl": 12}
# The sizes of the plans that do not change.
RESIDENT = {MISSION: 100, FENCE: 64, RALLY: 16}
# The sizes of plans whose commit takes long.
LONG = {"qemu": {MISSION: 250, FENCE: 64, RALLY: 16}, "sitl": {MISSION: 500, FENCE: 256, RALLY: 64}}


def store(gcs, kind, items):
    """Uploads a plan. Returns its id, and the time from the last item to the acknowledgement (s)."""
    started = upload_part(gcs, items, len(items), kind)
    sent = time.monotonic()
    ack = started.next(10)
    assert ack and ack.get_type() == "MISSION_ACK" and ack.type == ACCEPTED
    return plan_id(ack), time.monotonic() - sent


def is_accepted(messages):
    """Returns whether an ACCEPTED is among the messages."""
    return any(message.get_type() == "MISSION_ACK" and message.type == ACCEPTED for message in messages)


# The moment of a cut after the acknowledgement.
ACKNOWLEDGED = math.inf


def spread(positions, duration, is_early):
    """Yields moments (s) from the start to after the usual end, and the one after the acknowledgement. On a busy machine all cuts may be
    late. Then it yields the start again until `is_early` returns true for a cut."""
    yield from (1.4 * duration * position / (positions - 2) for position in range(positions - 1))
    yield ACKNOWLEDGED
    for _ in range(20):
        if is_early():
            return
        yield 0.0


def cut_at(vehicle, moment, next_answer):
    """Cuts the power after this time, or after the acknowledgement. Returns whether the vehicle has sent ACCEPTED."""
    if moment == ACKNOWLEDGED:
        answers = [next_answer(timeout=10)]
    else:
        time.sleep(moment)
        answers = []
    return is_accepted([*answers, *vehicle.cut()])


def test_all_plans_survive(vehicle):
    """All fields and ids survive. Cleared plans are removed from storage."""
    plans = {kind: make(12) for kind, make in PLANS.items()}
    stored = {kind: store(vehicle.gcs, kind, items)[0] for kind, items in plans.items()}
    assert len({0, *stored.values()}) == 4
    for _ in range(2):
        vehicle.cut()
        for kind, items in plans.items():
            back = download(vehicle.gcs, kind)
            assert back.id == stored[kind]
            assert differences(items, back.items) == []
    current = vehicle.gcs.wait("MISSION_CURRENT")
    assert (current.seq, current.total) == (0, 12)
    assert [plan_id(current, kind) for kind in plans] == list(stored.values())
    clear_all(vehicle.gcs)
    vehicle.cut()
    assert ids(vehicle.gcs) == [0, 0, 0]


def test_power_cut_during_an_upload_leaves_the_old_plan(vehicle, target, figure):
    """The power is cut at moments from before the first item to after the last but one."""
    counts = {MISSION: 50, FENCE: 40, RALLY: 16}
    old = {kind: make(counts[kind]) for kind, make in PLANS.items()}
    stored = [store(vehicle.gcs, kind, items)[0] for kind, items in old.items()]
    positions = POSITIONS[target]
    for position in range(positions):
        kind = list(PLANS)[position % 3]
        sent = position * counts[kind] // positions
        upload_part(vehicle.gcs, PLANS[kind](counts[kind], 1 + position), sent, kind)
        assert not is_accepted(vehicle.cut())
        assert ids(vehicle.gcs) == stored, f"cut after {sent} of {counts[kind]} items"
        assert differences(old[kind], download(vehicle.gcs, kind).items) == []
    # The interrupted uploads do not block the next one.
    assert upload(vehicle.gcs, PLANS[MISSION](counts[MISSION], 999)).type == ACCEPTED
    figure(f"cut in the middle of an upload: {positions} times, the old plan each time")


@pytest.mark.parametrize("kind", PLANS, ids=["mission", "fence", "rally"])
def test_power_cut_during_a_commit_leaves_a_whole_plan(vehicle, target, kind, figure):
    """The power is cut at moments from the last item to after the acknowledgement."""
    gcs, count, make = vehicle.gcs, LONG[target][kind], PLANS[kind]
    stored = {}
    for other, size in RESIDENT.items():
        if other != kind:
            stored[other] = store(gcs, other, PLANS[other](size))[0]
    old = make(count)
    times = []
    for variant in (1001, 1002, 0):
        # As in the runs below, the vehicle was just switched on.
        vehicle.cut()
        stored[kind], took = store(vehicle.gcs, kind, make(count, variant))
        times.append(took)
    duration = sorted(times)[1]
    outcomes = Counter()
    for variant, moment in enumerate(spread(POSITIONS[target], duration, lambda: outcomes["old"]), 1):
        gcs, new = vehicle.gcs, make(count, variant)
        accepted = cut_at(vehicle, moment, upload_part(gcs, new, count, kind).next)
        back = download(vehicle.gcs, kind)
        is_new = differences(new, back.items) == []
        where = f"cut {1000 * moment:.1f} ms after the last item"
        assert is_new or differences(old, back.items) == [], f"{where}: neither the old plan nor the new one"
        assert is_new or not accepted, f"{where}: ACCEPTED was sent, but the old plan is stored"
        assert is_new == (back.id != stored[kind]) and back.id != 0, f"{where}: the id does not belong to the plan"
        if is_new:
            old, stored[kind] = new, back.id
        assert ids(vehicle.gcs) == [stored[each] for each in PLANS], f"{where}: the other plans have changed"
        outcomes["new, acknowledged" if accepted else "new" if is_new else "old"] += 1
    figure(f"cut in the middle of a commit of {count} items, {1000 * duration:.1f} ms: {dict(outcomes)}")
    assert outcomes["old"] and outcomes["new, acknowledged"], "the cuts do not cover the whole commit"


@pytest.mark.parametrize("kind", [MISSION, ALL], ids=["mission", "all"])
def test_power_cut_during_a_clear_leaves_all_or_nothing(vehicle, target, kind, figure):
    plans = {each: make(RESIDENT[each]) for each, make in PLANS.items()}
    meant = list(plans) if kind == ALL else [kind]

    def begin():
        vehicle.gcs.mav.mission_clear_all_send(1, 1, kind)

    stored = {}
    times = []
    for _ in range(3):
        for each, items in plans.items():
            if not stored.get(each) or each in meant:
                stored[each], _ = store(vehicle.gcs, each, items)
        # As in the runs below, the vehicle was just switched on.
        vehicle.cut()
        began = time.monotonic()
        begin()
        assert next_word(vehicle.gcs, kind, 10).type == ACCEPTED
        times.append(time.monotonic() - began)
    duration = sorted(times)[1]
    cleared = [0 if each in meant else stored[each] for each in plans]
    whole = list(stored.values())
    outcomes = Counter()
    for moment in spread(POSITIONS[target], duration, lambda: outcomes["whole"]):
        for each in meant:
            if ask_count(vehicle.gcs, each).count == 0:
                assert store(vehicle.gcs, each, plans[each])[0] == stored[each]
        begin()
        accepted = cut_at(vehicle, moment, functools.partial(next_word, vehicle.gcs, kind))
        found = ids(vehicle.gcs)
        where = f"cut {1000 * moment:.1f} ms after the request"
        assert found in (whole, cleared), f"{where}: {found} is neither {whole} nor {cleared}"
        assert found == cleared or not accepted, f"{where}: ACCEPTED was sent, but the plans are stored"
        for each, items in plans.items():
            expected = [] if found == cleared and each in meant else items
            assert differences(expected, download(vehicle.gcs, each).items) == []
        outcomes["cleared, acknowledged" if accepted else "cleared" if found == cleared else "whole"] += 1
    figure(f"cut in the middle of a clear, {1000 * duration:.1f} ms: {dict(outcomes)}")
    assert outcomes["whole"] and outcomes["cleared, acknowledged"], "the cuts do not cover the whole clear"
