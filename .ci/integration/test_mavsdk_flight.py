"""Flight and telemetry with MAVSDK."""

import json
import math
import queue
import threading
import time

import pytest
from mavsdk.plugins.action import Action
from mavsdk.plugins.action.action import ActionError, ActionResult
from mavsdk.plugins.info import Info
from mavsdk.plugins.info.info import InfoError
from mavsdk.plugins.manual_control import ManualControl
from mavsdk.plugins.manual_control.manual_control import ManualControlError, ManualControlResult
from mavsdk.plugins.mavlink_direct import MavlinkDirect
from mavsdk.plugins.mavlink_direct.mavlink_direct import MavlinkMessage
from mavsdk.plugins.offboard import Offboard
from mavsdk.plugins.offboard.offboard import (
    OffboardError,
    OffboardResult,
    PositionGlobalYaw,
    PositionNedYaw,
    VelocityNedYaw,
)
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry
from mavsdk.plugins.telemetry.telemetry import FlightMode, LandedState, TelemetryError, TelemetryResult
from pymavlink import mavutil
from rates import Meter, settled_errors

mavlink = mavutil.mavlink

HOME = (47.397742, 8.545594, 488.0)
# The length of a degree of latitude (m).
DEGREE = 111_319.5

# MAVSDK's names of telemetry with a rate, and their messages.
RATES = {
    "attitude_euler": "ATTITUDE",
    "attitude_quaternion": "ATTITUDE_QUATERNION",
    "battery": "BATTERY_STATUS",
    "fixedwing_metrics": "VFR_HUD",
    "gps_info": "GPS_RAW_INT",
    "health": "SYS_STATUS",
    "home": "HOME_POSITION",
    "landed_state": "EXTENDED_SYS_STATE",
    "position": "GLOBAL_POSITION_INT",
    "position_velocity_ned": "LOCAL_POSITION_NED",
    "rc_status": "RC_CHANNELS",
    "unix_epoch_time": "SYSTEM_TIME",
}


def until(condition, timeout, what):
    """Waits for a condition. A vehicle that meets it does so well before the time limit."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f"not within {timeout} s: {what}"
        time.sleep(0.02)


def command_long(command, *params):
    params = [*params, *[0] * (7 - len(params))]
    fields = {f"param{n}": value for n, value in enumerate(params, 1)}
    fields |= dict(target_system=1, target_component=1, command=command, confirmation=0)
    return MavlinkMessage("COMMAND_LONG", 0, 0, 1, 1, json.dumps(fields))


class Watched:
    """The current telemetry of a flight, and its history."""

    def __init__(self, system):
        self.telemetry = Telemetry(system)
        self.modes, self.states = [], []
        self.telemetry.subscribe_flight_mode(self._remember(self.modes))
        self.telemetry.subscribe_landed_state(self._remember(self.states))
        self.telemetry.set_rate_position(10.0)
        self.telemetry.set_rate_position_velocity_ned(10.0)
        self.telemetry.set_rate_landed_state(10.0)
        self.highest = self.fastest = 0.0
        self.telemetry.subscribe_position_velocity_ned(self._note)

    @staticmethod
    def _remember(log):
        def note(value, _):
            if log[-1:] != [value]:
                log.append(value)

        return note

    def _note(self, told, _):
        self.highest = max(self.highest, -told.position.down_m)
        self.fastest = max(self.fastest, self.speed(told))

    @staticmethod
    def speed(told):
        return math.hypot(told.velocity.north_m_s, told.velocity.east_m_s)

    @property
    def height(self):
        return self.telemetry.position().relative_altitude_m

    @property
    def now(self):
        return self.telemetry.position_velocity_ned()

    def north(self):
        """Returns the distance north of home (m)."""
        return self.now.position.north_m

    def way(self, begin, heading):
        """Returns the distances (m) ahead and to the right of `begin`, for a heading (rad)."""
        north, east = self.now.position.north_m - begin.north_m, self.now.position.east_m - begin.east_m
        sin, cos = math.sin(heading), math.cos(heading)
        return north * cos + east * sin, east * cos - north * sin

    def is_still(self):
        return self.speed(self.now) < 0.1 and abs(self.now.velocity.down_m_s) < 0.1


@pytest.fixture
def action(system, port):
    """The plugin Action of a vehicle that is ready to fly. Restores the parameters and rates that a test has set."""
    telemetry, params = Telemetry(system), Param(system)
    until(telemetry.health_all_ok, 20, "the vehicle is healthy")
    yield Action(system)
    params.set_param_float("MIS_TAKEOFF_ALT", 10.0)
    params.set_param_float("RTL_RETURN_ALT", 15.0)
    params.set_param_float("MPC_XY_CRUISE", 8.0)
    params.set_param_float("COM_RC_LOSS_T", 0.5)
    for name in RATES.values():
        MavlinkDirect(system).send_command(command_long(511, getattr(mavlink, f"MAVLINK_MSG_ID_{name}"), 0))


def result_of(call, *arguments):
    with pytest.raises(ActionError) as refusal:
        call(*arguments)
    return refusal.value.result


def test_flight(system, action, figure):
    """Takes off, flies to a position, stops on the way to a second one, and returns home. The telemetry shows each step."""
    watched = Watched(system)
    Param(system).set_param_float("RTL_RETURN_ALT", 8.0)
    began = time.monotonic()
    action.set_takeoff_altitude(5.0)
    assert action.get_takeoff_altitude() == 5.0
    assert result_of(action.takeoff) == ActionResult.COMMAND_DENIED, "it is not armed"
    action.arm()
    until(watched.telemetry.armed, 5, "armed")
    action.takeoff()
    until(lambda: FlightMode.TAKEOFF in watched.modes, 5, "it says that it takes off")
    until(lambda: 4.8 < watched.height < 5.2 and watched.is_still(), 30, "it is where the take-off ends")
    until(lambda: watched.telemetry.flight_mode() == FlightMode.HOLD, 5, "it holds")
    until(lambda: watched.telemetry.landed_state() == LandedState.IN_AIR, 5, "it says that it is in the air")
    assert watched.telemetry.in_air()
    assert result_of(action.disarm) == ActionResult.COMMAND_DENIED, "it flies"

    action.set_current_speed(4.0)
    watched.fastest = 0.0
    action.goto_location(HOME[0] + 20 / DEGREE, HOME[1], HOME[2] + 7, math.nan)
    until(lambda: abs(watched.north() - 20) < 1 and watched.is_still(), 60, "it is where it was sent")
    assert 6.7 < watched.height < 7.3
    assert 3.5 < watched.fastest < 4.5

    action.goto_location(HOME[0] + 200 / DEGREE, HOME[1], HOME[2] + 7, math.nan)
    until(lambda: watched.north() > 25, 60, "it is on its way")
    action.hold()
    until(watched.is_still, 20, "it stops")
    assert 25 < watched.north() < 60
    assert watched.telemetry.flight_mode() == FlightMode.HOLD

    watched.modes.clear()
    action.return_to_launch()
    until(lambda: not watched.telemetry.armed(), 90, "it lands at home")
    until(lambda: watched.telemetry.landed_state() == LandedState.ON_GROUND, 5, "it says that it has landed")
    assert FlightMode.RETURN_TO_LAUNCH in watched.modes
    assert 7.7 < watched.highest < 8.5, "it does not fly home at the configured altitude"
    assert math.hypot(watched.now.position.north_m, watched.now.position.east_m) < 1
    in_air = watched.states.index(LandedState.IN_AIR)
    assert LandedState.TAKING_OFF in watched.states[:in_air], watched.states
    assert watched.states[-1] == LandedState.ON_GROUND, watched.states
    figure(f"MAVSDK: flown in {time.monotonic() - began:.0f} s")


def test_land(system, action):
    """Lands at the current position."""
    watched = Watched(system)
    action.set_takeoff_altitude(3.0)
    action.arm()
    action.takeoff()
    until(lambda: watched.height > 2.3, 30, "it takes off")
    action.land()
    until(lambda: FlightMode.LAND in watched.modes, 5, "it says that it lands")
    until(lambda: not watched.telemetry.armed(), 60, "it lands")
    until(lambda: watched.states[-1] == LandedState.ON_GROUND, 5, "it says that it has landed")
    assert LandedState.LANDING in watched.states, watched.states
    assert abs(watched.height) < 0.2


class Sticks:
    """The pilot's sticks: sent ten times a second until they are released."""

    CENTRED = (0.0, 0.0, 0.5, 0.0)

    def __init__(self, control):
        self.control = control
        self.at = self.CENTRED
        self.is_let_go = threading.Event()
        self.thread = threading.Thread(target=self._send)
        self.thread.start()

    def _send(self):
        while not self.is_let_go.wait(0.1):
            self.control.set_manual_control_input(*self.at)

    def let_go(self):
        self.is_let_go.set()
        self.thread.join()


def test_manual_flight(system, action):
    """J-3: the vehicle flies forward, climbs and turns. With centred sticks it stands still; when they are released, it holds."""
    watched, control = Watched(system), ManualControl(system)
    # On a busy machine the thread that sends the sticks may not run for longer than half a second.
    Param(system).set_param_float("COM_RC_LOSS_T", 2.0)
    action.set_takeoff_altitude(3.0)
    action.arm()
    action.takeoff()
    until(lambda: watched.height > 2.3 and watched.is_still(), 30, "it takes off")
    with pytest.raises(ManualControlError) as refusal:
        control.start_position_control()
    assert refusal.value.result != ManualControlResult.SUCCESS, "manual control was accepted without sticks"
    sticks = Sticks(control)
    try:
        until(lambda: start(control), 10, "it takes the sticks")
        until(lambda: watched.telemetry.flight_mode() == FlightMode.POSCTL, 5, "it says so")
        begin, heading = watched.now.position, math.radians(watched.telemetry.attitude_euler().yaw_deg)
        sticks.at = (0.5, 0.0, 0.5, 0.0)
        until(lambda: watched.way(begin, heading)[0] > 4, 30, "it flies ahead")
        sticks.at = sticks.CENTRED
        until(watched.is_still, 20, "it stands still")
        assert abs(watched.way(begin, heading)[1]) < 1
        height = watched.height
        sticks.at = (0.0, 0.0, 1.0, 0.0)
        until(lambda: watched.height > height + 2, 30, "it climbs")
        sticks.at = (0.0, 0.0, 0.5, 1.0)
        yaw = watched.telemetry.attitude_euler
        until(lambda: math.cos(math.radians(yaw().yaw_deg) - heading) < 0.8, 30, "it turns")
        # The vehicle is still turning when the sticks are released.
    finally:
        sticks.let_go()
    until(lambda: watched.telemetry.flight_mode() == FlightMode.HOLD, 5, "it holds")
    until(watched.is_still, 20, "it stands still")
    action.land()
    until(lambda: not watched.telemetry.armed(), 60, "it lands")


def start(control):
    """Returns whether the vehicle accepts manual control. The first input may not have arrived yet."""
    try:
        control.start_position_control()
        return True
    except ManualControlError:
        return False


def test_offboard_flight(system, action):
    """J-6, J-7, J-8: the vehicle flies MAVSDK's positions and velocities, and holds when they stop. C-17: as in MAVSDK's own
    example, Offboard mode starts right behind the first setpoint."""
    watched, offboard = Watched(system), Offboard(system)
    action.set_takeoff_altitude(3.0)
    action.arm()
    action.takeoff()
    until(lambda: watched.height > 2.3 and watched.is_still(), 30, "it takes off")
    with pytest.raises(OffboardError) as refusal:
        offboard.start()
    assert refusal.value.result == OffboardResult.NO_SETPOINT_SET
    offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 90.0))
    offboard.start()
    until(lambda: watched.telemetry.flight_mode() == FlightMode.OFFBOARD, 5, "it says so")
    assert offboard.is_active()
    until(lambda: abs(watched.telemetry.attitude_euler().yaw_deg - 90) < 2, 20, "it turns to the east")
    # An earlier test may have flown it away from home.
    begin = watched.now.position
    offboard.set_velocity_ned(VelocityNedYaw(3.0, 0.0, -0.5, 90.0))
    until(lambda: watched.north() > begin.north_m + 6, 30, "it flies north")
    assert abs(watched.now.velocity.north_m_s - 3) < 0.2 and abs(watched.now.position.east_m - begin.east_m) < 0.5
    offboard.set_position_ned(PositionNedYaw(10.0, -5.0, -6.0, 0.0))
    until(lambda: is_at(watched, 10, -5, 6), 30, "it is where it was sent")
    above_home = PositionGlobalYaw.AltitudeType.REL_HOME
    offboard.set_position_global(PositionGlobalYaw(HOME[0] + 4 / DEGREE, HOME[1], 4.0, 0.0, above_home))
    until(lambda: is_at(watched, 4, 0, 4), 30, "it is there on the globe")

    offboard.stop()
    until(lambda: watched.telemetry.flight_mode() == FlightMode.HOLD, 5, "it holds")
    offboard.set_velocity_ned(VelocityNedYaw(2.0, 0.0, 0.0, 0.0))
    offboard.start()
    until(lambda: watched.north() > 6, 30, "it flies north")
    texts = []
    watched.telemetry.subscribe_status_text(lambda text, _: texts.append(text.text))
    # The companion is gone: its setpoints stop in the middle of the flight.
    offboard.destroy()
    until(lambda: watched.telemetry.flight_mode() == FlightMode.HOLD, 5, "it holds without setpoints")
    until(lambda: "Setpoints lost: holding" in texts, 5, "it says why")
    until(watched.is_still, 20, "it stands still")
    action.land()
    until(lambda: not watched.telemetry.armed(), 60, "it lands")


def is_at(watched, north, east, height):
    place = watched.now.position
    return math.dist((place.north_m, place.east_m, -place.down_m), (north, east, height)) < 0.3


def known(ask):
    """Returns MAVSDK's answer, as soon as it has received the information from the vehicle."""
    deadline = time.monotonic() + 20
    while True:
        try:
            return ask()
        except InfoError:
            assert time.monotonic() < deadline, "MAVSDK does not receive the information"
            time.sleep(0.1)


def test_identity(system):
    """Q-9: version, product and identity as in AUTOPILOT_VERSION, the flight information, and the speed of the clock."""
    info = Info(system)
    version = known(info.get_version)
    assert (version.flight_sw_major, version.flight_sw_minor, version.flight_sw_patch) == (0, 1, 0)
    product = known(info.get_product)
    assert (product.vendor_id, product.product_id) == (0, 0)
    identification = known(info.get_identification)
    assert bytes.fromhex(identification.hardware_uid) == b"mavstack demo 0001"
    assert identification.legacy_uid == 0x6D61_7673_7461_636B
    flights = queue.SimpleQueue()
    info.subscribe_flight_information(lambda told, _: flights.put(told))
    assert flights.get(timeout=10).time_boot_ms > 0
    # NaN until MAVSDK has observed the clock for a while.
    until(lambda: abs(known(info.get_speed_factor) - 1) < 0.2, 60, "its second is a second")


def test_subscriptions(system):
    """All telemetry of MAVSDK, for a vehicle on the ground."""
    telemetry = Telemetry(system)
    until(telemetry.health_all_ok, 20, "the vehicle is healthy")
    found = {}
    wanted = ["position", "home", "in_air", "landed_state", "armed", "attitude_quaternion", "attitude_euler"]
    wanted += ["velocity_ned", "gps_info", "raw_gps", "battery", "flight_mode", "health", "position_velocity_ned"]
    wanted += ["fixedwing_metrics", "heading", "attitude_angular_velocity_body", "health_all_ok"]
    telemetry.set_rate_attitude_quaternion(5.0)

    def note(value, name):
        # Of the two batteries, the first.
        if name != "battery" or value.id == 0:
            found.setdefault(name, value)

    for name in wanted:
        getattr(telemetry, f"subscribe_{name}")(note, name)
    until(lambda: set(wanted) <= set(found), 15, f"all that is subscribed to; now {sorted(found)}")
    telemetry.set_rate_attitude_quaternion(0.0)
    place = found["position"]
    home = found["home"]
    assert (round(home.latitude_deg, 6), round(home.longitude_deg, 6)) == HOME[:2]
    assert abs(place.latitude_deg - home.latitude_deg) < 1e-2 and abs(place.longitude_deg - home.longitude_deg) < 1e-2
    assert abs(place.absolute_altitude_m - HOME[2]) < 1 and abs(place.relative_altitude_m) < 1
    assert (found["in_air"], found["armed"], found["landed_state"]) == (False, False, LandedState.ON_GROUND)
    assert found["gps_info"].num_satellites == 14 and found["gps_info"].fix_type >= 3
    assert 3 * 3.5 <= found["battery"].voltage_v <= 3 * 4.2 and 0 < found["battery"].remaining_percent <= 100
    assert found["health"].is_armable and found["health"].is_home_position_ok
    assert abs(found["attitude_euler"].roll_deg) < 5 and abs(found["attitude_quaternion"].w) <= 1


def test_rates(system, action, figure):
    """Q-4, Q-5: all telemetry at one rate at the same time. Each rate is within 5 % by the vehicle's clock."""
    telemetry, direct = Telemetry(system), MavlinkDirect(system)
    for name in RATES:
        getattr(telemetry, f"set_rate_{name}")(8.0)
    messages = queue.SimpleQueue()
    direct.subscribe_message("", lambda message, _: messages.put(message))
    meter = Meter()

    def take():
        message = messages.get(timeout=3)
        meter.take(message.message_name, json.loads(message.fields_json))
        return meter

    error, worst = settled_errors(take, dict.fromkeys(RATES.values(), 125_000))
    figure(f"MAVSDK: {len(RATES)} rates of 8 Hz within {100 * abs(error):.2f} % ({worst})")


def test_rate_of_an_unavailable_message_is_denied(system):
    """Q-4"""
    with pytest.raises(TelemetryError) as refusal:
        Telemetry(system).set_rate_odometry(5.0)
    assert refusal.value.result == TelemetryResult.COMMAND_DENIED


def test_raw_messages(system, other):
    """mavlink_direct: sent and received messages, and a command with its answer."""
    direct = MavlinkDirect(system)
    answers = queue.SimpleQueue()
    direct.subscribe_message("PARAM_VALUE", lambda message, _: answers.put(json.loads(message.fields_json)))
    fields = dict(target_system=1, target_component=1, param_id="NAV_ACC_RAD", param_index=-1)
    direct.send_message(MavlinkMessage("PARAM_REQUEST_READ", 0, 0, 1, 1, json.dumps(fields)))
    answer = answers.get(timeout=3)
    assert (answer["param_id"], answer["param_value"], answer["param_type"]) == ("NAV_ACC_RAD", 2.0, 9)
    for command, result in [
        (command_long(512, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION), mavlink.MAV_RESULT_ACCEPTED),
        (command_long(512, 42_000), mavlink.MAV_RESULT_DENIED),
        (command_long(42_424), mavlink.MAV_RESULT_UNSUPPORTED),
    ]:
        ack = direct.send_command(command)
        assert (ack.message_name, json.loads(ack.fields_json)["result"]) == ("COMMAND_ACK", result)


def test_home(system, action):
    """O-6: a new home position is reported at once."""
    telemetry = Telemetry(system)
    moved = HOME[0] + 5 / DEGREE
    try:
        action.set_home(False, moved, *HOME[1:])
        until(lambda: abs(telemetry.home().latitude_deg - moved) < 1e-6, 3, "home has moved")
        assert result_of(action.set_home, False, HOME[0] + 1, *HOME[1:]) == ActionResult.COMMAND_DENIED, "too far"
    finally:
        action.set_home(False, *HOME)
    until(lambda: abs(telemetry.home().latitude_deg - HOME[0]) < 1e-6, 3, "home is back")


def test_reboot(system, action):
    """C-30: the vehicle answers first and then restarts. The restart ends a flight termination."""
    clock = queue.SimpleQueue()
    telling = lambda message, _: clock.put(json.loads(message.fields_json)["time_boot_ms"])
    MavlinkDirect(system).subscribe_message("SYSTEM_TIME", telling)
    until(lambda: clock.get(timeout=5) > 5000, 20, "it has been there for a while")
    action.terminate()
    assert result_of(action.arm) == ActionResult.FAILED
    action.reboot()
    until(lambda: clock.get(timeout=10) < 5000, 10, "the clock does not restart")
    # By then the vehicle has a position fix.
    until(lambda: clock.get(timeout=5) > 4000, 20, "it is ready")
    action.arm()
    action.disarm()
