"""The vehicle as MAVSDK sees it."""

import time

import pytest
from mavsdk import Autopilot
from mavsdk.plugins.action import Action
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw
from mavsdk.plugins.mission_raw.mission_raw import MissionRawError, MissionRawResult
from plans import differences, plan

FIELDS = ("seq", "frame", "command", "current", "autocontinue", "param1", "param2", "param3", "param4", "x", "y", "z")


@pytest.fixture
def missions(system):
    """The plugin, once MAVSDK knows the vehicle's capabilities: until then it refuses."""
    return MissionRaw(system)


def as_dict(item):
    return {field: getattr(item, field) for field in FIELDS}


def test_discovery(system):
    assert system.is_connected() and system.has_autopilot()
    assert system.get_system_id() == 1
    assert system.autopilot_type() not in (Autopilot.PX4, Autopilot.ARDUPILOT)


@pytest.mark.parametrize("count", [3, 50, 100, "capacity"])
def test_a_plan_comes_back_as_it_was_sent(missions, capacity, count, figure):
    count = capacity if count == "capacity" else count
    items = plan(count)
    began = time.monotonic()
    missions.upload_mission([MissionItem(**item) for item in items])
    uploaded = time.monotonic()
    back = [as_dict(item) for item in missions.download_mission()]
    figure(f"MAVSDK: {count} items up {uploaded - began:.1f} s, down {time.monotonic() - uploaded:.1f} s")
    assert differences(items, back) == []


def test_a_plan_that_is_too_long_is_refused_and_the_old_one_stays(missions, capacity):
    items = plan(3)
    missions.upload_mission([MissionItem(**item) for item in items])
    with pytest.raises(MissionRawError) as refusal:
        missions.upload_mission([MissionItem(**item) for item in plan(capacity + 1)])
    assert refusal.value.result == MissionRawResult.TOO_MANY_MISSION_ITEMS
    assert differences(items, [as_dict(item) for item in missions.download_mission()]) == []


def test_clear(missions):
    missions.upload_mission([MissionItem(**item) for item in plan(3)])
    missions.clear_mission()
    assert missions.download_mission() == []


def test_arm_and_disarm(system):
    action = Action(system)
    action.arm()
    action.disarm()
