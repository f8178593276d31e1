"""Long-running commands, and the reboot (C-20 to C-24, C-30)."""

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
    assert ack, f"no COMMAND_ACK for command {command}"
    assert (ack.target_system, ack.target_component) == gcs.address
    return ack


def cancel(gcs, command):
    gcs.mav.send(newer.CommandCancel(command, 1, 1))


def test_calibration_reports_progress(gcs, other):
    """The vehicle reports its progress to the requester at least once a second, and then sends one final answer."""
    gcs.send_command(CALIBRATION, 1)
    progress, times = [], []
    while (ack := next_ack(gcs, CALIBRATION)).result == IN_PROGRESS:
        # 255 means unknown.
        progress.append(ack.progress % 255)
        times.append(time.monotonic())
    assert ack.result == ACCEPTED
    assert len(progress) >= 4 and progress == sorted(progress) and progress[0] == 0 and 50 < progress[-1] <= 100
    # MAVSDK waits 3 s for the next report.
    assert max(b - a for a, b in zip(times, times[1:])) < 3
    # A retransmission, as from a client that missed the final answer: it is answered again, but not executed again.
    gcs.send_command(CALIBRATION, 1)
    assert next_ack(gcs, CALIBRATION).result == ACCEPTED
    assert not gcs.wait("COMMAND_ACK", 1.5)
    assert not other.wait("COMMAND_ACK", 0.1)


def test_calibration_is_cancelled(gcs, other):
    """During a calibration, a second one and arming are refused. A COMMAND_CANCEL for a command that is not running is ignored."""
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
    assert not gcs.wait("COMMAND_ACK", 1.5), "the command is still running"
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    assert gcs.command(CALIBRATION, 1) == TEMPORARILY_REJECTED, "armed"


def test_reboot_is_refused(gcs):
    for params in [(2,), (0.5,), (1, 1), (-1,)]:
        assert gcs.command(REBOOT, *params) == DENIED, params
    assert gcs.command(REBOOT, 0) == ACCEPTED, "REBOOT with 0 does nothing"
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    assert gcs.command(REBOOT, 1) == TEMPORARILY_REJECTED, "armed"


def test_reboot_is_acknowledged_first(vehicle):
    """The vehicle answers first and then restarts. A parameter set before the restart is kept."""
    gcs = vehicle.gcs
    assert write(gcs, "NAV_ACC_RAD", REAL32, 3.5).value == 3.5
    before = gcs.wait("SYSTEM_TIME", 3).time_boot_ms
    assert gcs.command(REBOOT, 1) == ACCEPTED
    booting = mavlink.MAV_STATE_BOOT
    assert gcs.wait("HEARTBEAT", 10, lambda beat: beat.system_status == booting), "the vehicle does not restart"
    assert gcs.wait("SYSTEM_TIME", 3).time_boot_ms < max(before, 5000)
    assert read(gcs, "NAV_ACC_RAD").value == 3.5
    write(gcs, "NAV_ACC_RAD", REAL32, 2.0)
    assert gcs.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1, -1) == ACCEPTED
