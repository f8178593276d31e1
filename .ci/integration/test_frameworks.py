"""The firmware as a bare loop, with RTIC and with Embassy. All three behave the same, except when the flight loop hangs."""

import statistics
import time

import pytest
from conftest import Gcs, is_armed
from firmware import running
from plans import differences, plan
from pymavlink import mavutil
from rates import steady_gaps
from test_params import INT32, REAL32, read, to_float, write
from transfer import ACCEPTED, download, upload

mavlink = mavutil.mavlink

# Config::max_loop_gap and the heartbeat period (s).
MAX_LOOP_GAP, PERIOD = 0.5, 1.0
# The time to wait before a message counts as absent (s).
SILENCE = 3.0


@pytest.fixture(scope="module", params=["loop", "rtic", "embassy"])
def app(request):
    return request.param


@pytest.fixture(scope="module")
def firmware(app, request, tmp_path_factory):
    """A client on the telemetry link of a separate vehicle, started like `cargo qemu`."""
    option = request.config.getoption
    with running(option, app, tmp_path_factory.mktemp(app) / "output.txt"):
        gcs = Gcs(option("spare_port_base"))
        yield gcs
        gcs.close()


@pytest.fixture
def gcs(firmware):
    firmware.drain()
    return firmware


def answers_ping(gcs, seq):
    gcs.mav.ping_send(0, seq, 0, 0)
    return bool(gcs.wait("PING", where=lambda ping: ping.seq == seq))


def test_heartbeat_is_sent_once_a_second(gcs, app, figure):
    """H-1. During startup, state changes are reported at once (H-16)."""
    assert gcs.wait("HEARTBEAT", where=lambda heartbeat: heartbeat.system_status == mavlink.MAV_STATE_STANDBY)
    # This heartbeat may be such a report. The next one is periodic.
    assert gcs.wait("HEARTBEAT")

    def next_time():
        assert gcs.wait("HEARTBEAT"), "a heartbeat is missing"
        return time.monotonic()

    gaps = steady_gaps(next_time, 4, lambda gaps: abs(statistics.mean(gaps) - 1) < 0.05)
    figure(f"{app}: heartbeat: mean {statistics.mean(gaps):.3f} s")


def test_arming_is_reported(gcs):
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED
    assert gcs.wait("HEARTBEAT", where=is_armed)
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == mavlink.MAV_RESULT_ACCEPTED
    assert gcs.wait("HEARTBEAT", where=lambda heartbeat: not is_armed(heartbeat))


def test_fifty_items_are_uploaded_and_downloaded(gcs, app, figure):
    items = plan(50)
    began = time.monotonic()
    assert upload(gcs, items).type == ACCEPTED
    uploaded = time.monotonic()
    assert not differences(items, download(gcs).items)
    figure(f"{app}: 50 items: {uploaded - began:.2f} s up, {time.monotonic() - uploaded:.2f} s down")


def test_plans_and_parameters_survive_a_restart(gcs):
    """C-30: the vehicle restarts after it has answered and stored everything."""
    items = plan(5, variant=1)
    assert upload(gcs, items).type == ACCEPTED
    assert write(gcs, "MIS_TAKEOFF_ALT", REAL32, 12.5).value == 12.5
    assert gcs.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == mavlink.MAV_RESULT_ACCEPTED
    # Bytes arrive before the firmware has started.
    for seq in range(50):
        gcs.mav.ping_send(0, seq, 0, 0)
        time.sleep(0.01)
    assert gcs.wait("HEARTBEAT", 5, lambda heartbeat: heartbeat.system_status == mavlink.MAV_STATE_BOOT)
    assert read(gcs, "MIS_TAKEOFF_ALT").value == 12.5
    assert not differences(items, download(gcs).items)


def test_heartbeats_stop_when_the_flight_loop_hangs(gcs, app):
    """H-5. With a framework, communication continues in its own task. The heartbeat never depends on that."""
    gcs.mav.param_set_send(1, 1, b"SIM_HANG", to_float(INT32, 1), INT32)
    if app == "loop":
        # Bytes may still be in flight.
        time.sleep(MAX_LOOP_GAP)
        gcs.drain()
        assert not gcs.hear(None, SILENCE), "a frame was sent, although communication runs in the loop that hangs"
        return
    assert gcs.wait("PARAM_VALUE", where=lambda value: value.param_id == "SIM_HANG")
    time.sleep(MAX_LOOP_GAP + PERIOD)
    gcs.drain()
    assert not gcs.wait("HEARTBEAT", SILENCE), "a heartbeat was sent, although the flight loop hangs"
    assert all(answers_ping(gcs, seq) for seq in range(10))
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == mavlink.MAV_RESULT_ACCEPTED
    items = plan(50, variant=2)
    assert upload(gcs, items).type == ACCEPTED
    assert not differences(items, download(gcs).items)
    assert not gcs.wait("HEARTBEAT", PERIOD + 0.2)
