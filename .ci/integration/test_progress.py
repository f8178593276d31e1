"""Mission progress with pymavlink."""

import math
import time

import pytest
from conftest import is_armed
from plans import FENCE, HOME, MISSION, NAV_LAND, NAV_WAYPOINT, PLANS, RALLY, differences, plan
from pymavlink import mavutil
from transfer import ACCEPTED, clear, clear_all, download, plan_id, upload

mavlink = mavutil.mavlink

SET_CURRENT = mavlink.MAV_CMD_DO_SET_MISSION_CURRENT
NO_MISSION, NOT_STARTED, ACTIVE, PAUSED, COMPLETE = range(1, 6)


@pytest.fixture
def client(other):
    """The client that is already connected, for tests that need only one."""
    return other


def current(gcs, timeout=3.0):
    message = gcs.wait("MISSION_CURRENT", timeout)
    assert message, "no MISSION_CURRENT"
    return message


def test_mission_current_describes_the_plans(client):
    """M-90: all fields of MISSION_CURRENT, without a plan, with one plan, and with all three."""
    clear_all(client)
    empty = current(client)
    assert (empty.seq, empty.total, empty.mission_state) == (0, 65535, NO_MISSION)
    assert [plan_id(empty, kind) for kind in PLANS] == [0, 0, 0]
    stored = {MISSION: 0, FENCE: 0, RALLY: 0}
    for kind in (RALLY, FENCE, MISSION):
        client.drain()
        stored[kind] = plan_id(upload(client, PLANS[kind](12), kind))
        # At once, and then every second.
        for timeout in (0.3, 1.5, 1.5):
            told = current(client, timeout)
            assert [plan_id(told, each) for each in PLANS] == list(stored.values())
            assert told.mission_mode == 2
            if kind == MISSION:
                assert (told.seq, told.total, told.mission_state) == (0, 12, NOT_STARTED)
            else:
                assert (told.seq, told.total, told.mission_state) == (0, 65535, NO_MISSION)


def test_download_marks_the_current_item(client):
    """M-67"""
    assert upload(client, plan(6)).type == ACCEPTED
    assert client.command(SET_CURRENT, 4) == mavlink.MAV_RESULT_ACCEPTED
    assert [item["current"] for item in download(client).items] == [0, 0, 0, 0, 1, 0]


def test_set_current_by_command(client):
    """M-92"""
    assert client.command(SET_CURRENT, 0) == mavlink.MAV_RESULT_FAILED, "there is no item 0"
    assert upload(client, plan(12)).type == ACCEPTED
    for params, result, seq in [
        ((3,), "ACCEPTED", 3),
        ((11, 0), "ACCEPTED", 11),
        ((-1, 1), "ACCEPTED", 11),
        ((-1, math.nan), "ACCEPTED", 11),
        ((12,), "FAILED", 11),
        ((65536,), "FAILED", 11),
        ((1.5,), "DENIED", 11),
        ((-2,), "DENIED", 11),
        ((math.nan,), "DENIED", 11),
        ((5, 2), "DENIED", 11),
        ((0, 1), "ACCEPTED", 0),
    ]:
        client.drain()
        assert client.command(SET_CURRENT, *params) == getattr(mavlink, f"MAV_RESULT_{result}"), params
        assert current(client, 0.3 if result == "ACCEPTED" else 1.5).seq == seq, params


def test_set_current_by_message(client):
    """M-93: the answer is MISSION_CURRENT, with a text on failure."""
    assert upload(client, plan(12)).type == ACCEPTED
    # Messages about the upload may still be in flight.
    client.mav.mission_set_current_send(1, 1, 7)
    assert client.wait("MISSION_CURRENT", 0.5, lambda message: message.seq == 7)
    client.mav.mission_set_current_send(1, 1, 12)
    told = {}
    while len(told) < 2:
        message = client.wait(["STATUSTEXT", "MISSION_CURRENT"], 1.5)
        assert message, f"only {list(told)} came"
        told[message.get_type()] = message
    assert told["MISSION_CURRENT"].seq == 7
    assert told["STATUSTEXT"].text == "Mission item 12 cannot be made current"


def test_current_item_after_an_upload(client):
    """M-39, M-94: the same plan keeps the current item. Another plan selects it, and it is never beyond the end."""
    items = plan(12)
    assert upload(client, items).type == ACCEPTED
    assert client.command(SET_CURRENT, 9) == mavlink.MAV_RESULT_ACCEPTED
    ack = upload(client, items)
    assert ack.type == ACCEPTED
    client.drain()
    told = current(client)
    assert (told.seq, plan_id(told)) == (9, plan_id(ack))
    assert upload(client, plan(3, 1)).type == ACCEPTED
    client.drain()
    assert (current(client).seq, current(client).total) == (0, 3)
    items = [dict(item, current=int(item["seq"] == 5)) for item in plan(12, 2)]
    assert upload(client, items).type == ACCEPTED
    client.drain()
    assert current(client).seq == 5
    assert differences(items, download(client).items) == []


def test_mission_start_is_refused(client):
    """M-95: there is no mission, the items do not exist, or the vehicle is disarmed on the ground."""
    start = mavlink.MAV_CMD_MISSION_START
    assert client.command(start, 0, 0) == mavlink.MAV_RESULT_FAILED
    assert upload(client, plan(4)).type == ACCEPTED
    for params in [(4, 0), (0, 4), (2, 1), (0.5, 0), (-1, 0)]:
        assert client.command(start, *params) == mavlink.MAV_RESULT_DENIED, params
    assert client.command(start, 0, 0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED


def wait_until(gcs, condition, timeout):
    """Waits for a heartbeat that meets the condition."""
    heartbeat = gcs.wait("HEARTBEAT", timeout, condition)
    assert heartbeat, f"it does not happen within {timeout} s"
    return heartbeat


def test_vehicle_flies_a_mission_and_lands(gcs, other):
    """Two ground stations observe arming, take-off, a plan with a jump, and the landing (M-90, M-91)."""
    waypoint = dict(plan(2)[1], param1=0.0, param2=0.0, param4=math.nan, z=6.0)
    near = [(HOME[0] + 900, HOME[1]), (HOME[0] + 900, HOME[1] + 900)]
    items = [dict(waypoint, seq=seq, x=x, y=y) for seq, (x, y) in enumerate(near)]
    items.append(dict(waypoint, seq=2, command=mavlink.MAV_CMD_DO_JUMP, param1=0.0, param2=1.0, x=0, y=0))
    items.append(dict(waypoint, seq=3, command=NAV_LAND, x=HOME[0], y=HOME[1]))
    assert items[0]["command"] == NAV_WAYPOINT
    assert upload(gcs, items).type == ACCEPTED

    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED
    wait_until(gcs, is_armed, 3)
    assert gcs.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5) == mavlink.MAV_RESULT_ACCEPTED
    # In the air, a normal disarm command is refused.
    time.sleep(2)
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    for client in (gcs, other):
        client.drain()
    assert gcs.command(mavlink.MAV_CMD_MISSION_START, 0, 0) == mavlink.MAV_RESULT_ACCEPTED
    assert gcs.wait("MISSION_CURRENT", 3, lambda told: (told.mission_state, told.mission_mode) == (ACTIVE, 1))
    for client in (gcs, other):
        # Both clients are informed, and MISSION_ITEM_REACHED precedes the next current item.
        log, current = [], None
        while not log or log[-1] != "Mission complete":
            message = client.wait(["MISSION_CURRENT", "MISSION_ITEM_REACHED", "STATUSTEXT"], 60)
            assert message, f"no message after {log}"
            match message.get_type():
                case "STATUSTEXT":
                    log.append(message.text)
                case "MISSION_ITEM_REACHED":
                    log.append(("reached", message.seq))
                # A periodic one may repeat the item that was just reached.
                case _ if message.mission_state == ACTIVE and message.seq != current:
                    current = message.seq
                    log.append(current)
        # The jump is taken at once, so it may or may not be reported as the current item.
        steps = [step for step in log if step != 2 and not isinstance(step, str)]
        expected = [[seq, ("reached", seq)] for seq in (0, 1, 0, 1, 3)]
        assert steps == sum(expected, [])
    wait_until(gcs, lambda heartbeat: not is_armed(heartbeat), 3)
    assert gcs.wait("MISSION_CURRENT", 3, lambda told: told.mission_state == COMPLETE), "no MISSION_CURRENT with COMPLETE"
    assert clear(gcs) == ACCEPTED
