"""Flight with MAVProxy: modes, radio channels, streams, a reboot."""

import math
import time

import pytest
from conftest import Gcs
from pymavlink import mavutil
from rates import Meter, settled_errors
from test_mavproxy import MavProxy
from test_messages import STREAMS, set_interval
from test_payload import tuned

mavlink = mavutil.mavlink

# PX4's numbers: main mode << 16 | sub-mode << 24. MAVProxy has no names for them.
HOLD, RETURN, LAND = (4 << 16 | sub << 24 for sub in (3, 5, 6))
POSITION = 3 << 16


@pytest.fixture
def mavproxy(port, tmp_path):
    mavproxy = MavProxy(port, tmp_path, "arm,mode,cmdlong,misc,rc")
    mavproxy.expect("Detected vehicle 1:1")
    yield mavproxy
    mavproxy.end()


def mode_of(gcs, number, timeout=5):
    """Waits until the vehicle is in this mode."""
    assert gcs.wait("HEARTBEAT", timeout, lambda beat: beat.custom_mode == number), f"not in mode {number}"


def test_modes(mavproxy, other):
    """Changes modes in flight by number. MAVProxy's names mean ArduPilot's numbers, which are refused without any effect.
    Its RTL is the number of Offboard mode, which needs setpoints."""
    mavproxy.expect(f"Mode({HOLD})")
    mavproxy.say("arm throttle")
    mavproxy.expect("COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
    mavproxy.say("takeoff 5")
    mavproxy.expect("COMMAND_ACK: NAV_TAKEOFF: ACCEPTED")
    assert other.wait("GLOBAL_POSITION_INT", 20, lambda told: told.relative_alt > 2_000)
    mavproxy.say(f"mode {HOLD}")
    mavproxy.expect("COMMAND_ACK: DO_SET_MODE: ACCEPTED")
    mode_of(other, HOLD)
    for name, result in (("RTL", "TEMPORARILY_REJECTED"), ("GUIDED", "DENIED"), ("LOITER", "DENIED")):
        mavproxy.say(f"mode {name}")
        mavproxy.expect(f"COMMAND_ACK: DO_SET_MODE: {result}")
    mode_of(other, HOLD)
    mavproxy.say(f"mode {RETURN}")
    mavproxy.expect("COMMAND_ACK: DO_SET_MODE: ACCEPTED")
    mavproxy.expect(f"Mode({RETURN})")
    mode_of(other, RETURN)
    mavproxy.say(f"mode {LAND}")
    mavproxy.expect("COMMAND_ACK: DO_SET_MODE: ACCEPTED")
    mode_of(other, LAND)
    mavproxy.say("disarm")
    mavproxy.expect("COMMAND_ACK: COMPONENT_ARM_DISARM: TEMPORARILY_REJECTED")
    mavproxy.expect("DISARMED", timeout=40)


@pytest.fixture
def patience(other):
    """A longer timeout of manual control: on a busy machine MAVProxy may not send for half a second."""
    with tuned(other, COM_RC_LOSS_T=2.0):
        yield


def test_radio_channels(mavproxy, other, patience):
    """J-4: overrides fly the vehicle like a radio, and RC_CHANNELS reports them. When they are released, the vehicle holds."""
    mavproxy.say("arm throttle")
    mavproxy.expect("COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
    mavproxy.say("takeoff 5")
    mavproxy.expect("COMMAND_ACK: NAV_TAKEOFF: ACCEPTED")
    assert other.wait("GLOBAL_POSITION_INT", 20, lambda told: told.relative_alt > 3_000)
    mavproxy.say(f"mode {POSITION}")
    mavproxy.expect("COMMAND_ACK: DO_SET_MODE: TEMPORARILY_REJECTED")
    for channel, pulse in [(1, 1500), (2, 1300), (3, 1500), (4, 1500)]:
        mavproxy.say(f"rc {channel} {pulse}")
    told = other.wait("RC_CHANNELS", 10, lambda told: told.chan4_raw == 1500)
    assert (told.chan1_raw, told.chan2_raw, told.chan3_raw) == (1500, 1300, 1500)
    mavproxy.say(f"mode {POSITION}")
    mavproxy.expect("COMMAND_ACK: DO_SET_MODE: ACCEPTED")
    mode_of(other, POSITION)
    # A low pulse means forward, in whatever direction that is.
    begin = other.wait("LOCAL_POSITION_NED")
    assert other.wait("LOCAL_POSITION_NED", 30, lambda told: math.hypot(told.x - begin.x, told.y - begin.y) > 5)
    mavproxy.say("rc clear")
    mavproxy.expect("Manual control lost: holding")
    mode_of(other, HOLD)
    assert other.wait("RC_CHANNELS", 10, lambda told: told.chan2_raw != 1300)
    mavproxy.say(f"mode {LAND}")
    mavproxy.expect("DISARMED", timeout=60)


def logged(log):
    """Measures the rates of the vehicle's messages in MAVProxy's log, which grows."""
    time.sleep(0.5)
    meter = Meter()
    messages = mavutil.mavlink_connection(str(log))
    while message := messages.recv_match():
        if message.get_type() != "BAD_DATA" and message.get_srcSystem() == 1:
            meter.take(message.get_type(), message.to_dict())
    messages.close()
    return meter


def test_streams(mavproxy, port, tmp_path, figure):
    """Q-7: MAVProxy requests one rate for everything. Its log shows this rate."""
    names = [name for name in STREAMS if name != "HOME_POSITION"]
    mavproxy.say("set streamrate 10")
    (log,) = tmp_path.rglob("*.tlog")
    error, worst = settled_errors(lambda: logged(log), dict.fromkeys(names, 100_000))
    figure(f"MAVProxy: {len(names)} streams of 10 Hz within {100 * abs(error):.2f} % ({worst})")
    mavproxy.end()
    gcs = Gcs(port)
    for name in names:
        set_interval(gcs, name, 0)
    gcs.close()


def test_reboot(mavproxy, other):
    """The vehicle answers first, and its clock starts again."""
    assert other.wait("SYSTEM_TIME", 10, lambda told: told.time_boot_ms > 5000)
    mavproxy.say("reboot")
    mavproxy.expect("COMMAND_ACK: PREFLIGHT_REBOOT_SHUTDOWN: ACCEPTED")
    assert other.wait("SYSTEM_TIME", 10, lambda told: told.time_boot_ms < 5000), "the vehicle does not restart"
    # The next test needs a vehicle that is ready.
    assert other.wait("SYSTEM_TIME", 10, lambda told: told.time_boot_ms > 4000)
