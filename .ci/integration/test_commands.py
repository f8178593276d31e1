"""Commands that take their time, and the one after which there is nobody left to ask (C-20 to C-24, C-30)."""

import time

import newer
from pymavlink import mavutil
from test_params import REAL32, read, write

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
DENIED = mavlink.MAV_RESULT_DENIED
TEMPORARILY_REJECTED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
IN_PROGRESS = mavlink.MAV_RESULT_IN_PROGRESS
# pymavlink does not have this one yet: MAV_RESULT_CANCELLED.
CANCELLED = 6

CALIBRATION = mavlink.MAV_CMD_PREFLIGHT_CALIBRATION
REBOOT = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN


def next_ack(gcs, command, timeout=3.0):
    ack = gcs.wait("COMMAND_ACK", timeout, lambda ack: ack.command == command)
    assert ack, f"no word of command {command}"
    assert (ack.target_system, ack.target_component) == gcs.address
    return ack


def cancel(gcs, command):
    gcs.mav.send(newer.CommandCancel(1, 1, command))


def test_a_calibration(gcs, other):
    """It tells how far it is, once a second at least, to who asked for it; then there is one final answer."""
    gcs.send_command(CALIBRATION, 1)
    progress, times = [], []
    while (ack := next_ack(gcs, CALIBRATION)).result == IN_PROGRESS:
        # 255: not known yet.
        progress.append(ack.progress % 255)
        times.append(time.monotonic())
    assert ack.result == ACCEPTED
    assert len(progress) >= 4 and progress == sorted(progress) and progress[0] == 0 and 50 < progress[-1] <= 100
    # MAVSDK waits 3 s after each.
    assert max(b - a for a, b in zip(times, times[1:])) < 3
    # Sent again, as by a client that has not heard the end: told again and not begun again.
    gcs.send_command(CALIBRATION, 1)
    assert next_ack(gcs, CALIBRATION).result == ACCEPTED
    assert not gcs.wait("COMMAND_ACK", 1.5)
    assert not other.wait("COMMAND_ACK", 0.1)


def test_a_calibration_that_is_cancelled(gcs, other):
    """Meanwhile nobody else can begin one, and it does not arm. A cancellation of what does not run is not answered."""
    cancel(gcs, CALIBRATION)
    assert not gcs.wait("COMMAND_ACK", 1)
    gcs.send_command(CALIBRATION, 0, 1)
    assert next_ack(gcs, CALIBRATION).result == IN_PROGRESS
    other.send_command(CALIBRATION, 0, 1)
    assert next_ack(other, CALIBRATION).result == TEMPORARILY_REJECTED
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == TEMPORARILY_REJECTED
    cancel(gcs, CALIBRATION)
    while (ack := next_ack(gcs, CALIBRATION)).result == IN_PROGRESS:
        pass
    assert ack.result == CANCELLED
    assert not gcs.wait("COMMAND_ACK", 1.5), "it goes on"
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    assert gcs.command(CALIBRATION, 1) == TEMPORARILY_REJECTED, "armed"


def test_a_reboot_that_is_refused(gcs):
    for params in [(2,), (0.5,), (1, 1), (-1,)]:
        assert gcs.command(REBOOT, *params) == DENIED, params
    assert gcs.command(REBOOT, 0) == ACCEPTED, "it is asked to do nothing"
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    assert gcs.command(REBOOT, 1) == TEMPORARILY_REJECTED, "armed"


def test_a_reboot(vehicle):
    """Answered first; then it is there again, from the start, and what was set before it is kept."""
    gcs = vehicle.gcs
    assert write(gcs, "NAV_ACC_RAD", REAL32, 3.5).value == 3.5
    before = gcs.wait("SYSTEM_TIME", 3).time_boot_ms
    assert gcs.command(REBOOT, 1) == ACCEPTED
    booting = mavlink.MAV_STATE_BOOT
    assert gcs.wait("HEARTBEAT", 10, lambda beat: beat.system_status == booting), "it does not come back"
    assert gcs.wait("SYSTEM_TIME", 3).time_boot_ms < max(before, 5000)
    assert read(gcs, "NAV_ACC_RAD").value == 3.5
    write(gcs, "NAV_ACC_RAD", REAL32, 2.0)
    assert gcs.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1, -1) == ACCEPTED
