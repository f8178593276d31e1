"""Plans and arming with MAVSDK."""

import queue
import time

import pytest
from mavsdk import Autopilot
from mavsdk.plugins.action import Action
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw
from mavsdk.plugins.mission_raw.mission_raw import MissionPlan, MissionRawError, MissionRawResult
from plans import FENCE, MISSION, PLANS, RALLY, differences, plan
from transfer import ACCEPTED, as_dict, clear_all, download, ids, upload


@pytest.fixture
def missions(system):
    """The plugin MissionRaw."""
    return MissionRaw(system)


def raw(kind, items):
    return [MissionItem(**item, mission_type=kind) for item in items]


def send(missions, kind, items):
    upload = {
        MISSION: missions.upload_mission,
        FENCE: missions.upload_geofence,
        RALLY: missions.upload_rally_points,
    }
    upload[kind](raw(kind, items))


def fetch(missions, kind):
    download = {
        MISSION: missions.download_mission,
        FENCE: missions.download_geofence,
        RALLY: missions.download_rallypoints,
    }
    return [as_dict(item) for item in download[kind]()]


def result_of(action, *arguments):
    with pytest.raises(MissionRawError) as refusal:
        action(*arguments)
    return refusal.value.result


def test_discovery(system):
    assert system.is_connected() and system.has_autopilot()
    assert system.get_system_id() == 1
    assert system.autopilot_type() not in (Autopilot.PX4, Autopilot.ARDUPILOT)


@pytest.mark.parametrize("count", [3, 50, 100, "capacity"])
def test_plan_is_downloaded_unchanged(missions, capacity, count, figure):
    count = capacity if count == "capacity" else count
    items = plan(count)
    began = time.monotonic()
    send(missions, MISSION, items)
    uploaded = time.monotonic()
    back = fetch(missions, MISSION)
    figure(f"MAVSDK: {count} items up {uploaded - began:.1f} s, down {time.monotonic() - uploaded:.1f} s")
    assert differences(items, back) == []


def test_all_kinds_of_plans(missions, capacities, other):
    """Downloads are equal to uploads, and clearing the mission keeps the other plans."""
    plans = {kind: make(min(capacities[kind], 64)) for kind, make in PLANS.items()}
    for kind, items in plans.items():
        send(missions, kind, items)
    for kind, items in plans.items():
        assert differences(items, fetch(missions, kind)) == []
        assert differences(items, download(other, kind).items) == []
    before = ids(other)
    missions.clear_mission()
    assert ids(other) == [0, *before[1:]]
    assert fetch(missions, MISSION) == []
    clear_all(other)
    for kind in plans:
        assert fetch(missions, kind) == []


def test_plan_that_is_too_long_is_refused(missions, capacities):
    for kind, make in PLANS.items():
        items = make(10)
        send(missions, kind, items)
        too_long = make(capacities[kind] + 1)
        assert result_of(send, missions, kind, too_long) == MissionRawResult.TOO_MANY_MISSION_ITEMS
        assert differences(items, fetch(missions, kind)) == []


def test_refusals_have_their_reasons(missions, other):
    """MAVSDK's results for the vehicle's codes."""
    old = plan(8)
    send(missions, MISSION, old)
    new = plan(9, 1)
    for fields, result in [
        (dict(command=82), MissionRawResult.UNSUPPORTED),
        (dict(frame=1), MissionRawResult.UNSUPPORTED),
        (dict(x=900_000_001), MissionRawResult.INVALID_ARGUMENT),
        (dict(param4=float("inf")), MissionRawResult.INVALID_ARGUMENT),
    ]:
        bad = [dict(item) for item in new]
        bad[3] |= fields
        assert result_of(send, missions, MISSION, bad) == result, fields
    other.mav.mission_count_send(1, 1, 5, MISSION)
    assert other.wait("MISSION_REQUEST_INT")
    assert result_of(send, missions, MISSION, new) == MissionRawResult.DENIED
    assert differences(old, fetch(missions, MISSION)) == []


def test_clear(missions):
    send(missions, MISSION, plan(3))
    missions.clear_mission()
    assert fetch(missions, MISSION) == []


def test_set_current_and_progress(missions):
    progress = queue.SimpleQueue()
    missions.subscribe_mission_progress(lambda told, _: progress.put((told.current, told.total)))

    def wait_for(wanted):
        seen = []
        while wanted not in seen:
            seen.append(progress.get(timeout=3))

    send(missions, MISSION, plan(8))
    wait_for((0, 8))
    missions.set_current_mission_item(5)
    wait_for((5, 8))
    assert result_of(missions.set_current_mission_item, 8) == MissionRawResult.INVALID_ARGUMENT
    missions.set_current_mission_item(0)
    wait_for((0, 8))
    assert not missions.is_mission_finished()


def test_change_by_another_client_is_detected(missions, other):
    changes = queue.SimpleQueue()
    send(missions, MISSION, plan(4))
    missions.subscribe_mission_changed(lambda changed, _: changes.put(changed))
    assert upload(other, plan(5, 1)).type == ACCEPTED
    assert changes.get(timeout=3) is True


def test_upload_is_cancelled(missions, capacity, other):
    """The old plan stays, and the next upload can start at once."""
    old, new = plan(5), plan(capacity, 1)
    send(missions, MISSION, old)
    progress, results = queue.SimpleQueue(), queue.SimpleQueue()

    def told(result, data, _):
        if result == MissionRawResult.NEXT:
            progress.put(data.progress)
        else:
            results.put(result)

    missions.upload_mission_with_progress_async(MissionPlan(raw(MISSION, new)), told)
    while progress.get(timeout=3) < 0.2:
        pass
    missions.cancel_mission_upload()
    assert results.get(timeout=3) == MissionRawResult.TRANSFER_CANCELLED
    assert differences(old, download(other).items) == []
    assert upload(other, plan(6, 2)).type == ACCEPTED
    assert differences(plan(6, 2), fetch(missions, MISSION)) == []


def test_download_is_cancelled(missions, capacity):
    items = plan(capacity)
    send(missions, MISSION, items)
    results = queue.SimpleQueue()
    missions.download_mission_async(lambda result, *_: results.put(result))
    # By then some items have arrived, but not most of them.
    time.sleep(0.1)
    missions.cancel_mission_download()
    assert results.get(timeout=3) == MissionRawResult.TRANSFER_CANCELLED
    assert differences(items, fetch(missions, MISSION)) == []


def test_arm_and_disarm(system):
    action = Action(system)
    action.arm()
    action.disarm()
