"""Flight modes: the list, the current mode, and the four ways to change it (C-32, Q-10)."""

import math

import newer
import pytest
from pymavlink import mavutil

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
DENIED = mavlink.MAV_RESULT_DENIED
TEMPORARILY_REJECTED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
CUSTOM = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED

# PX4's main modes and sub-modes.
_MODES = [(3, 0), (6, 0), *((4, sub) for sub in range(2, 7))]
POSITION, OFFBOARD, TAKEOFF, HOLD, MISSION, RETURN, LAND = (main << 16 | sub << 24 for main, sub in _MODES)
STANDARD = {
    POSITION: mavlink.MAV_STANDARD_MODE_POSITION_HOLD,
    TAKEOFF: mavlink.MAV_STANDARD_MODE_TAKEOFF,
    MISSION: mavlink.MAV_STANDARD_MODE_MISSION,
    RETURN: mavlink.MAV_STANDARD_MODE_SAFE_RECOVERY,
    LAND: mavlink.MAV_STANDARD_MODE_LAND,
}
# Invalid modes: ArduPilot's GUIDED, LOITER and CIRCLE, an unknown sub-mode, a fraction, NaN, a value that is too large.
NO_MODES = [(4, 0), (5, 0), (7, 0), (4, 99), (4.5, 3), (math.nan, 3), (1 << 24, 1)]


def set_mode(gcs, mode):
    """Sends the old message SET_MODE, which is answered like a command. Returns the result."""
    gcs.mav.set_mode_send(1, CUSTOM, mode)
    ack = gcs.wait("COMMAND_ACK", where=lambda ack: ack.command == mavlink.MAVLINK_MSG_ID_SET_MODE)
    assert ack, "SET_MODE is not answered"
    return ack.result


def ask_modes(gcs, index):
    assert gcs.command(mavlink.MAV_CMD_REQUEST_MESSAGE, newer.AVAILABLE_MODES, index) == ACCEPTED
    first = gcs.wait("AVAILABLE_MODES")
    assert first, "no AVAILABLE_MODES"
    return first


def is_in(gcs, mode, timeout=3.0):
    """Waits for a CURRENT_MODE with this mode, and checks that the heartbeat agrees."""
    current = gcs.wait("CURRENT_MODE", timeout, lambda told: told.custom_mode == mode)
    assert current, f"no CURRENT_MODE with mode {mode:#x}"
    assert current.standard_mode == STANDARD.get(mode, mavlink.MAV_STANDARD_MODE_NON_STANDARD)
    beat = gcs.wait("HEARTBEAT", 3)
    assert beat.custom_mode == mode and beat.base_mode & CUSTOM


def test_list_of_modes(gcs):
    """The list is the same mode by mode, as QGroundControl requests it, and all at once. An index beyond it is denied."""
    count = ask_modes(gcs, 1).number_modes
    one_by_one = [ask_modes(gcs, index).to_dict() for index in range(1, count + 1)]
    found = [ask_modes(gcs, 0).to_dict()]
    while len(found) < count:
        mode = gcs.wait("AVAILABLE_MODES")
        assert mode, f"only {len(found)} of {count}"
        found.append(mode.to_dict())
    assert found == one_by_one
    assert [mode["mode_index"] for mode in found] == list(range(1, count + 1))
    names = [mode["mode_name"] for mode in found]
    assert len(set(names)) == count and all(names)
    assert {mode["custom_mode"]: mode["standard_mode"] for mode in found} == STANDARD | {OFFBOARD: 0, HOLD: 0}
    for index in (count + 1, 255, -1, 1.5):
        assert gcs.command(mavlink.MAV_CMD_REQUEST_MESSAGE, newer.AVAILABLE_MODES, index) == DENIED


def test_monitor_is_constant(gcs):
    """AVAILABLE_MODES_MONITOR is sent on request. Its number stays the same, because the modes cannot change."""
    numbers = []
    for _ in range(2):
        assert gcs.command(mavlink.MAV_CMD_REQUEST_MESSAGE, newer.AVAILABLE_MODES_MONITOR) == ACCEPTED
        numbers.append(gcs.wait("AVAILABLE_MODES_MONITOR").seq)
    assert numbers[0] == numbers[1]


def test_current_mode_is_sent_periodically(gcs):
    """CURRENT_MODE is sent about every 2 s, and on request."""
    is_in(gcs, HOLD, 6)
    assert gcs.command(mavlink.MAV_CMD_REQUEST_MESSAGE, newer.CURRENT_MODE) == ACCEPTED
    assert gcs.wait("CURRENT_MODE", 0.5).custom_mode == HOLD


@pytest.mark.parametrize("main, sub", NO_MODES)
def test_invalid_mode_is_denied(gcs, main, sub):
    assert gcs.command(mavlink.MAV_CMD_DO_SET_MODE, CUSTOM, main, sub) == DENIED


def test_invalid_mode_is_denied_by_other_messages(gcs):
    for mode in (0, 100, HOLD + 1, 0xFFFF_FFFF):
        assert set_mode(gcs, mode) == DENIED
    gcs.mav.set_mode_send(1, 0, HOLD)
    assert gcs.wait("COMMAND_ACK", where=lambda ack: ack.command == 11).result == DENIED
    assert gcs.command(mavlink.MAV_CMD_DO_SET_MODE, 0, 4, 3) == DENIED
    for mode in (0, mavlink.MAV_STANDARD_MODE_ORBIT, 99, math.nan):
        assert gcs.command(mavlink.MAV_CMD_DO_SET_STANDARD_MODE, mode) == DENIED
    # A SET_MODE for another vehicle is not answered.
    gcs.drain()
    gcs.mav.set_mode_send(9, CUSTOM, HOLD)
    assert not gcs.wait("COMMAND_ACK", 1)


def test_disarmed_vehicle_does_not_enter_a_flying_mode(gcs):
    assert gcs.command(mavlink.MAV_CMD_DO_SET_MODE, CUSTOM, 4, 3) == ACCEPTED
    assert gcs.command(mavlink.MAV_CMD_DO_SET_MODE, CUSTOM, 4, 2) == TEMPORARILY_REJECTED
    assert gcs.command(mavlink.MAV_CMD_DO_SET_STANDARD_MODE, STANDARD[RETURN]) == TEMPORARILY_REJECTED
    assert set_mode(gcs, RETURN) == TEMPORARILY_REJECTED
    assert gcs.wait("HEARTBEAT", 3).custom_mode == HOLD


def test_every_message_changes_the_mode_in_flight(gcs, other):
    """Each change is reported at once to all clients, also to those that did not request it."""
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    assert gcs.command(mavlink.MAV_CMD_DO_SET_STANDARD_MODE, STANDARD[TAKEOFF]) == ACCEPTED
    is_in(other, TAKEOFF)
    assert gcs.wait("GLOBAL_POSITION_INT", 20, lambda told: told.relative_alt > 2_000)
    for mode, ask in [
        (HOLD, lambda: gcs.command(mavlink.MAV_CMD_DO_SET_MODE, CUSTOM, 4, 3)),
        (RETURN, lambda: gcs.command(mavlink.MAV_CMD_DO_SET_MODE, CUSTOM, RETURN)),
        (HOLD, lambda: set_mode(gcs, HOLD)),
        (LAND, lambda: gcs.command(mavlink.MAV_CMD_DO_SET_STANDARD_MODE, STANDARD[LAND])),
    ]:
        other.drain()
        assert ask() == ACCEPTED
        is_in(other, mode)
    assert gcs.wait("HEARTBEAT", 60, lambda beat: not beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
