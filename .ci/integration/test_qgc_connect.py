"""QGroundControl's connection sequence, and its requests after that."""

import math
import time

import pytest
from conftest import is_armed
from plans import FENCE, MISSION, RALLY, differences, fence, plan, rally
from pymavlink import mavutil
from qgc import BadLine, Qgc
from test_params import REAL32, fetch, write
from transfer import ACCEPTED, upload

mavlink = mavutil.mavlink

PLANS = {MISSION: plan(12), FENCE: fence(12), RALLY: rally(5)}
GIMBAL_MANAGER_INFORMATION = mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION


@pytest.fixture
def planned(other):
    """Plans that QGroundControl can load."""
    for kind, items in PLANS.items():
        assert upload(other, items, kind).type == ACCEPTED


@pytest.fixture
def line(request, gcs, other):
    """The telemetry radio, or the companion's link, which is as fast as USB."""
    return {"telemetry": gcs, "companion": other}[request.param]


@pytest.mark.parametrize("line", ["telemetry", "companion"], indirect=True)
def test_qgroundcontrol_connects_completely(planned, line, figure, request):
    """Every step is answered: with the requested message, or at once with a refusal."""
    qgc = Qgc(line)
    qgc.connect()
    assert qgc.is_ready and all(step.is_answered for step in qgc.steps), qgc.steps
    steps = ", ".join(f"{step.name} {step.duration:.2f}" for step in qgc.steps[:-1])
    figure(f"QGroundControl on {request.node.callspec.id}: {steps} s; {qgc.retries} retries")
    assert len(qgc.modes) == qgc.modes[0].number_modes
    for kind, items in PLANS.items():
        assert differences(items, qgc.plans[kind]) == []
    line.drain()
    assert {value.param_id: value.param_index for value in qgc.parameters.values()} == {
        value.name: value.index for value in fetch(line)
    }


def test_qgroundcontrol_connects_over_a_lossy_line(planned, other, figure):
    """Lost messages are requested again until they arrive."""
    qgc = Qgc(other, BadLine)
    qgc.connect()
    # QGroundControl does not repeat the request for a lost mode, and does not request the remaining modes.
    missed = [step.name for step in qgc.steps if not step.is_answered]
    assert qgc.is_ready and set(missed) <= {"modes"}, qgc.steps
    duration = sum(step.duration for step in qgc.steps)
    figure(f"QGroundControl over a bad line: {duration:.1f} s, {qgc.retries} retries")
    assert qgc.retries
    assert len(qgc.parameters) == qgc.parameter_count
    for kind, items in PLANS.items():
        assert differences(items, qgc.plans[kind]) == []


def test_requests_after_connecting(gcs):
    """The vehicle answers what QGroundControl requests after connecting: gimbals, home, and rates."""
    qgc = Qgc(gcs)
    qgc.connect()
    assert qgc.is_ready
    gimbal = qgc.request_message(GIMBAL_MANAGER_INFORMATION)
    assert gimbal.get_srcComponent() == 1 and gimbal.gimbal_device_id == mavlink.MAV_COMP_ID_GIMBAL
    home = qgc.request_message(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
    assert (home.latitude, home.longitude) == (473_977_420, 85_455_940)
    # The requests of the MAVLink Inspector: sets a rate, reads it back, and restores the default.
    attitude = mavlink.MAVLINK_MSG_ID_ATTITUDE
    for micros, expected in [(100_000, lambda told: told == 100_000), (0, lambda told: told > 100_000)]:
        assert qgc.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, micros) == mavlink.MAV_RESULT_ACCEPTED
        told = qgc.request_message(mavlink.MAVLINK_MSG_ID_MESSAGE_INTERVAL, attitude)
        assert told.message_id == attitude and expected(told.interval_us)


def test_ping_and_timesync(gcs, other):
    """T-1, T-2: a request is answered on the link that it came by. An answer is not answered."""
    gcs.mav.ping_send(123_456_789, 7, 0, 0)
    pong = gcs.wait("PING")
    assert (pong.time_usec, pong.seq) == (123_456_789, 7)
    assert (pong.target_system, pong.target_component) == gcs.address
    other.drain()
    gcs.mav.ping_send(123_456_790, 8, 1, 1)
    assert not gcs.wait("PING", 0.5) and not other.wait("PING", 0.1)
    offsets = []
    for _ in range(5):
        sent = time.monotonic_ns()
        gcs.mav.timesync_send(0, sent)
        answer = gcs.wait("TIMESYNC", where=lambda answer: answer.ts1 == sent)
        assert answer and answer.tc1 > 0
        offsets.append(answer.tc1 - (sent + time.monotonic_ns()) // 2)
    boot = gcs.wait("SYSTEM_TIME", 3)
    # TIMESYNC uses the clock of the other messages, and it runs as fast as ours.
    assert abs(answer.tc1 / 1e6 - boot.time_boot_ms) < 5000
    assert max(offsets) - min(offsets) < 1e9


def test_take_off_and_landing(gcs):
    """QGroundControl's generic sequence: it arms, and then sends only NaN parameters. The vehicle chooses the altitude."""
    write(gcs, "MIS_TAKEOFF_ALT", REAL32, 4.0)
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED
    assert gcs.wait("HEARTBEAT", 3, is_armed)
    assert gcs.command(mavlink.MAV_CMD_NAV_TAKEOFF, *[math.nan] * 7) == mavlink.MAV_RESULT_ACCEPTED
    in_air = mavlink.MAV_LANDED_STATE_IN_AIR
    assert gcs.wait("EXTENDED_SYS_STATE", 20, lambda told: told.landed_state == in_air)
    assert gcs.wait("GLOBAL_POSITION_INT", 20, lambda told: 3_800 < told.relative_alt < 4_200)
    assert gcs.command(mavlink.MAV_CMD_NAV_LAND) == mavlink.MAV_RESULT_ACCEPTED
    assert gcs.wait("HEARTBEAT", 40, lambda beat: not is_armed(beat)), "it does not land"
    write(gcs, "MIS_TAKEOFF_ALT", REAL32, 10.0)
