"""The vehicle's camera and gimbal, which are components of their own, with MAVSDK, MAVProxy and pymavlink."""

import contextlib
import json
import math
import pathlib
import random
import time

import pytest
from conftest import Gcs, found_by_mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.camera import Camera
from mavsdk.plugins.camera.camera import CameraError, Mode, PhotosRange, Storage
from mavsdk.plugins.gimbal import Gimbal
from mavsdk.plugins.gimbal.gimbal import ControlMode, GimbalError, GimbalMode, SendMode
from mavsdk.plugins.mission import Mission
from mavsdk.plugins.mission.mission import MissionItem, MissionPlan
from mavsdk.plugins.telemetry import Telemetry
from plans import differences
from pymavlink import mavutil
from test_log import Logged
from test_mavproxy import MavProxy
from transfer import ACCEPTED as PLAN_ACCEPTED
from transfer import download, send_item

# The vehicle's home: latitude and longitude in degrees.
HOME = (47.397742, 8.545594)
# m of latitude in a degree.
DEGREE = 111_319.5


def place(east, north):
    """Latitude and longitude of a place, in degrees, by its distance from home in m."""
    return HOME[0] + north / DEGREE, HOME[1] + east / DEGREE / math.cos(math.radians(HOME[0]))


mavlink = mavutil.mavlink

ACCEPTED, DENIED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED
AUTOPILOT, CAMERA, GIMBAL = mavlink.MAV_COMP_ID_AUTOPILOT1, mavlink.MAV_COMP_ID_CAMERA, mavlink.MAV_COMP_ID_GIMBAL
POINT = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW
PLAN = pathlib.Path(__file__).parent / "survey.plan"


def until(condition, timeout, what):
    """Waits until the condition is true, and returns its value."""
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        assert time.monotonic() < deadline, f"not within {timeout} s: {what}"
        time.sleep(0.02)
    return value


def comes_from(component):
    return lambda message: message.get_srcSystem() == 1 and message.get_srcComponent() == component


def order(gcs, component, command, *params, timeout=30.0):
    """Sends a command to a component, again if it is not answered within a second. Returns the result."""
    params = [*params, *[0.0] * (7 - len(params))]
    gcs.drain()
    deadline, confirmation = time.monotonic() + timeout, 0
    while time.monotonic() < deadline:
        gcs.mav.command_long_send(1, component, command, confirmation, *params)
        confirmation = min(confirmation + 1, 255)
        is_it = lambda ack: ack.command == command and comes_from(component)(ack)
        if ack := gcs.hear("COMMAND_ACK", 1.0, is_it):
            return ack.result
    raise AssertionError(f"component {component} does not answer command {command}")


def request(gcs, component, kind, index=0, timeout=30.0):
    """Requests a message from a component, again if it does not arrive within a second."""
    number = getattr(mavlink, f"MAVLINK_MSG_ID_{kind}")
    gcs.drain()
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        gcs.mav.command_long_send(1, component, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, number, index, 0, 0, 0, 0, 0)
        fits = lambda message: kind != "CAMERA_IMAGE_CAPTURED" or message.image_index == index
        if message := gcs.hear(kind, 1.0, lambda message: comes_from(component)(message) and fits(message)):
            return message
    raise AssertionError(f"component {component} does not send {kind}")


@contextlib.contextmanager
def tuned(gcs, **values):
    """Sets float parameters, and restores them."""

    def told(name, send):
        def is_told():
            send()
            return gcs.wait("PARAM_VALUE", 1.0, lambda told: told.param_id == name)

        return until(is_told, 20, name).param_value

    def read(name):
        return told(name, lambda: gcs.mav.param_request_read_send(1, 1, name.encode(), -1))

    def set_to(name, value):
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        assert told(name, lambda: gcs.mav.param_set_send(1, 1, name.encode(), value, kind)) == value

    before = {name: read(name) for name in values}
    try:
        for name, value in values.items():
            set_to(name, value)
        yield
    finally:
        for name, value in before.items():
            set_to(name, value)


class Images:
    """The images that MAVSDK hears of, by index."""

    def __init__(self, camera):
        self.found = {}
        camera.subscribe_capture_info(self._note)

    def _note(self, info, _):
        self.found[info.index] = info


@pytest.fixture
def camera(system):
    camera = Camera(system)
    until(lambda: camera.camera_list().cameras, 20, "MAVSDK finds the camera")
    return camera


def test_mavsdk_points_the_gimbal(system, other):
    """GIM-3, GIM-4, GIM-5: found with its ids; taken, turned to angles, at rates and to a place, and released. Another station
    is denied meanwhile."""
    gimbal = Gimbal(system)
    (found,) = until(lambda: gimbal.gimbal_list().gimbals, 20, "MAVSDK finds the gimbal")
    assert (found.gimbal_manager_component_id, found.gimbal_device_id) == (AUTOPILOT, GIMBAL)
    assert (found.vendor_name, found.model_name) == ("mavstack", "Demo gimbal")
    this = found.gimbal_id
    attitudes = []
    gimbal.subscribe_attitude(lambda attitude, _: attitudes.append(attitude))
    until(lambda: attitudes, 10, "it sends its attitude")

    def points(pitch, yaw, north=False):
        angle = attitudes[-1].euler_angle_north if north else attitudes[-1].euler_angle_forward
        return abs(angle.pitch_deg - pitch) < 1 and abs(angle.yaw_deg - yaw) < 1

    with pytest.raises(GimbalError):
        gimbal.set_angles(this, 0, -30, 0, GimbalMode.YAW_FOLLOW, SendMode.ONCE)
    gimbal.take_control(this, ControlMode.PRIMARY)
    until(lambda: gimbal.get_control_status(this).control_mode == ControlMode.PRIMARY, 10, "MAVSDK is in control")
    assert order(other, AUTOPILOT, POINT, -10, 10, math.nan, math.nan, 0, 0, 0) == DENIED
    gimbal.set_angles(this, 0, -45, 30, GimbalMode.YAW_FOLLOW, SendMode.ONCE)
    until(lambda: points(-45, 30), 10, "it points at the angles")
    gimbal.set_angles(this, 0, -20, 120, GimbalMode.YAW_LOCK, SendMode.STREAM)
    until(lambda: points(-20, 120, north=True), 10, "it points at the angles from north")

    gimbal.set_angles(this, 0, 0, 0, GimbalMode.YAW_FOLLOW, SendMode.ONCE)
    until(lambda: points(0, 0), 10, "it is ahead and level")
    gimbal.set_angular_rates(this, 0, -20, 10, GimbalMode.YAW_FOLLOW, SendMode.ONCE)
    until(lambda: attitudes[-1].euler_angle_forward.pitch_deg < -5, 10, "it turns")
    assert attitudes[-1].euler_angle_forward.yaw_deg > 2
    gimbal.set_angular_rates(this, 0, 0, 0, GimbalMode.YAW_FOLLOW, SendMode.STREAM)

    # Far away in the east, at the height of the vehicle: MAVSDK sends the altitude as one above home.
    gimbal.set_roi_location(this, HOME[0], HOME[1] + 1, 0)
    until(lambda: points(0, 90, north=True), 10, "it points at the place")
    gimbal.release_control(this)
    until(lambda: gimbal.get_control_status(this).control_mode == ControlMode.NONE, 10, "nobody is in control")
    configure = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
    assert order(other, AUTOPILOT, configure, *other.address, -1, -1) == ACCEPTED
    is_other = lambda: gimbal.get_control_status(this).sysid_primary_control == other.address[0]
    until(is_other, 10, "the other station is in control")
    assert order(other, AUTOPILOT, POINT, 0, 0, math.nan, math.nan, 0, 0, 0) == ACCEPTED
    until(lambda: points(0, 0), 10, "it is ahead and level")
    assert order(other, AUTOPILOT, configure, -3, -3, -1, -1) == ACCEPTED


def test_mavsdk_operates_the_camera(camera, other):
    """CAM-1 to CAM-8: images at once and at an interval, video, modes, zoom, focus, the card, and the reset."""
    (found,) = camera.camera_list().cameras
    assert (found.component_id, found.vendor_name, found.model_name) == (CAMERA, "mavstack", "Demo camera")
    assert found.focal_length_mm == pytest.approx(8.8) and found.horizontal_resolution_px == 5_472
    # Images from before MAVSDK knew of them: the first ones on the card.
    camera.format_storage(CAMERA, 1)
    for _ in range(2):
        assert order(other, CAMERA, mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1) == ACCEPTED

    images = Images(camera)
    camera.take_photo(CAMERA)
    info = until(lambda: images.found.get(2), 10, "the image is reported")
    assert info.is_success and info.component_id == CAMERA
    here = request(other, AUTOPILOT, "GLOBAL_POSITION_INT")
    assert info.position.latitude_deg == pytest.approx(here.lat * 1e-7, abs=1e-6)
    assert info.position.longitude_deg == pytest.approx(here.lon * 1e-7, abs=1e-6)
    assert info.position.absolute_altitude_m == pytest.approx(here.alt * 1e-3, abs=0.1)

    camera.start_photo_interval(CAMERA, 0.5)
    until(lambda: 5 in images.found, 15, "it takes images at the interval")
    status = request(other, CAMERA, "CAMERA_CAPTURE_STATUS")
    assert status.image_interval == 0.5 and status.image_status in (2, 3)
    camera.stop_photo_interval(CAMERA)
    status = request(other, CAMERA, "CAMERA_CAPTURE_STATUS")
    assert (status.image_status, status.image_interval) == (0, 0)
    count = status.image_count
    until(lambda: max(images.found) == count - 1, 10, "all images are reported")

    def listed():
        return {info.index for info in camera.list_photos(CAMERA, PhotosRange.ALL)}

    until(lambda: listed() == set(range(count)), 20, "MAVSDK has fetched the older images")

    stored = lambda: camera.get_storage(CAMERA)
    with pytest.raises(CameraError):
        camera.start_video(CAMERA)
    camera.set_mode(CAMERA, Mode.VIDEO)
    until(lambda: camera.get_mode(CAMERA) == Mode.VIDEO, 10, "it is in the video mode")
    camera.start_video(CAMERA)
    until(lambda: stored().video_on, 15, "it records")
    camera.stop_video(CAMERA)
    until(lambda: not stored().video_on, 15, "it records no more")
    until(lambda: stored().used_storage_mib >= 8 * count, 15, "the card fills")
    assert (stored().total_storage_mib, stored().storage_type) == (32_000, Storage.StorageType.MICROSD)

    settings = lambda: request(other, CAMERA, "CAMERA_SETTINGS")
    camera.zoom_range(CAMERA, 40)
    camera.focus_range(CAMERA, 20)
    now = settings()
    assert (now.mode_id, now.zoomLevel, now.focusLevel) == (mavlink.CAMERA_MODE_VIDEO, 40, 20)
    camera.focus_auto(CAMERA)
    assert settings().focusLevel == 50
    camera.reset_settings(CAMERA)
    now = settings()
    assert (now.mode_id, now.zoomLevel, now.focusLevel) == (mavlink.CAMERA_MODE_IMAGE, 0, 50)
    until(lambda: camera.get_mode(CAMERA) == Mode.PHOTO, 10, "it is in the image mode")

    camera.format_storage(CAMERA, 1)
    until(lambda: stored().used_storage_mib == 0, 15, "the card is empty")
    assert request(other, CAMERA, "CAMERA_CAPTURE_STATUS").image_count == 0


def test_mavsdk_flies_a_mission_with_the_camera(system, camera, other, figure):
    """CAM-4, CAM-6, GIM-7: each of MAVSDK's actions in a mission, flown to its end."""
    actions, take_off = MissionItem.CameraAction, MissionItem.VehicleAction.TAKEOFF

    def item(north, action, **more):
        latitude, longitude = place(0, north)
        return MissionItem(latitude, longitude, 4.0, 8.0, True, camera_action=action, **more)

    items = [
        item(0, actions.TAKE_PHOTO, gimbal_pitch_deg=-60, gimbal_yaw_deg=20, vehicle_action=take_off),
        item(5, actions.START_PHOTO_INTERVAL, camera_photo_interval_s=0.5),
        item(15, actions.STOP_PHOTO_INTERVAL),
        item(16, actions.START_VIDEO),
        item(22, actions.STOP_VIDEO),
        item(25, actions.START_PHOTO_DISTANCE, camera_photo_distance_m=5.0),
        item(38, actions.STOP_PHOTO_DISTANCE),
    ]
    telemetry, mission = Telemetry(system), Mission(system)
    until(telemetry.health_all_ok, 20, "the vehicle is healthy")
    camera.format_storage(CAMERA, 1)
    images = Images(camera)
    mission.upload_mission(MissionPlan(items))
    back = mission.download_mission().mission_items
    assert [item.camera_action for item in back] == [item.camera_action for item in items]
    assert (back[0].gimbal_pitch_deg, back[0].gimbal_yaw_deg) == (-60, 20)
    assert (back[1].camera_photo_interval_s, back[5].camera_photo_distance_m) == (0.5, 5)
    began = time.monotonic()
    Action(system).arm()
    mission.start_mission()
    records = lambda status: comes_from(CAMERA)(status) and status.video_status == 1
    assert other.hear("CAMERA_CAPTURE_STATUS", 60, records), "it does not record"
    until(mission.is_mission_finished, 60, "the mission ends")
    figure(f"MAVSDK: a mission with seven actions of the camera in {time.monotonic() - began:.0f} s")
    status = request(other, CAMERA, "CAMERA_CAPTURE_STATUS")
    assert (status.video_status, status.image_status) == (0, 0)
    until(lambda: set(images.found) == set(range(status.image_count)), 15, f"all are reported: {sorted(images.found)}")
    taken = [images.found[index] for index in range(status.image_count)]
    norths = [(info.position.latitude_deg - HOME[0]) * DEGREE for info in taken]
    # One at the start, some at the interval, and by distance one at once and one every five of thirteen metres.
    assert abs(norths[0]) < 3
    timed = norths[1:-3]
    assert len(timed) >= 2 and all(2 < north < 16 for north in timed), norths
    steps = [after - before for before, after in zip(norths[-3:], norths[-2:])]
    assert norths[-3] == pytest.approx(25, abs=3) and all(4.5 < step < 6 for step in steps), norths
    begin, end = (request(other, CAMERA, "CAMERA_IMAGE_CAPTURED", index).time_boot_ms for index in (1, len(timed)))
    assert (end - begin) / (len(timed) - 1) == pytest.approx(500, abs=100)
    angles = taken[-1].attitude_euler_angle
    assert (angles.pitch_deg, angles.yaw_deg) == (pytest.approx(-60, abs=1), pytest.approx(20, abs=1))


class Lossy:
    """Loses one message in five in each direction, until it is closed."""

    def __init__(self, gcs, seed):
        self.link, self.write, self.receive = gcs.link, gcs.link.write, gcs.link.recv_msg
        self.chance = random.Random(seed)
        self.lost = 0
        gcs.link.write, gcs.link.recv_msg = self._write, self._receive

    def _is_lost(self):
        is_lost = self.chance.random() < 0.2
        self.lost += is_lost
        return is_lost

    def _write(self, frame):
        if not self._is_lost():
            self.write(frame)

    def _receive(self):
        while (message := self.receive()) and self._is_lost():
            pass
        return message

    def close(self):
        self.link.write, self.link.recv_msg = self.write, self.receive


def planned(file):
    """Returns the items of a file of QGroundControl, as it sends them."""

    def flat(items):
        for item in items:
            yield from flat(item["TransectStyleComplexItem"]["Items"]) if item["type"] == "ComplexItem" else [item]

    def scaled(value, frame):
        # What a NaN becomes on a PC.
        return -(2**31) if value is None else int(value * (1 if frame == mavlink.MAV_FRAME_MISSION else 1e7))

    found = []
    for seq, item in enumerate(flat(json.loads(file.read_text())["mission"]["items"])):
        *params, x, y, z = item["params"]
        params = [math.nan if value is None else float(value) for value in params]
        frame = item["frame"]
        found.append(
            dict(
                seq=seq,
                frame=frame,
                command=item["command"],
                current=int(seq == 0),
                autocontinue=int(item["autoContinue"]),
                **{f"param{n}": value for n, value in enumerate(params, 1)},
                x=scaled(x, frame),
                y=scaled(y, frame),
                z=math.nan if z is None else float(z),
            )
        )
    return found


def upload(gcs, items):
    """Uploads a mission over a bad line: repeats the count until the vehicle asks. It asks again for what is lost, at first also in
    the older form (M-47)."""
    kinds = ["MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK"]
    asked, deadline = False, time.monotonic() + 60
    while time.monotonic() < deadline:
        if not asked:
            gcs.mav.mission_count_send(1, 1, len(items), mavlink.MAV_MISSION_TYPE_MISSION)
        message = gcs.wait(kinds, 1.0, lambda word: (word.target_system, word.target_component) == gcs.address)
        if message and message.get_type() == "MISSION_ACK":
            return message.type
        asked = asked or bool(message)
        if asked:
            # The acknowledgement may be lost: the last item is sent again.
            send_item(gcs, items[message.seq if message else -1])
    raise AssertionError("the upload does not end")


def test_survey_over_a_bad_line(gcs, other, figure):
    """M-40, CAM-2, CAM-3, GIM-7: QGroundControl's survey, uploaded, started and flown while one message in five is lost. Every
    image exists once: on each of three lines one at once, at 10 and 20 m, and at the end. The other link hears of each once."""
    items = planned(PLAN)
    assert order(other, CAMERA, mavlink.MAV_CMD_STORAGE_FORMAT, 1, 1, 1) == ACCEPTED
    quick = dict(MPC_ACC_HOR=10, MPC_Z_VEL_MAX_UP=8, MPC_Z_VEL_MAX_DN=8, MPC_LAND_SPEED=5, MPC_XY_P=4, RTL_RETURN_ALT=6)
    with tuned(other, **quick), contextlib.closing(Lossy(gcs, 7)) as line:
        began = time.monotonic()
        assert upload(gcs, items) == PLAN_ACCEPTED
        uploaded = time.monotonic() - began
        assert differences(items, download(other).items) == []
        assert order(gcs, AUTOPILOT, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
        assert order(gcs, AUTOPILOT, mavlink.MAV_CMD_MISSION_START) == ACCEPTED
        found, heard, deadline = {}, [], time.monotonic() + 120
        while True:
            heard += [image.image_index for image in other.take_all() if image.get_type() == "CAMERA_IMAGE_CAPTURED"]
            message = gcs.hear(["CAMERA_IMAGE_CAPTURED", "HEARTBEAT"], 5)
            assert message and time.monotonic() < deadline, f"the survey does not end; images: {list(found)}"
            if message.get_type() == "CAMERA_IMAGE_CAPTURED":
                assert comes_from(CAMERA)(message) and message.image_index not in found
                found[message.image_index] = message
            elif comes_from(AUTOPILOT)(message) and found and not message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
                break
        flown = time.monotonic() - began - uploaded
        count = request(gcs, CAMERA, "CAMERA_CAPTURE_STATUS").image_count
        missing = [index for index in range(count) if index not in found]
        for index in missing:
            found[index] = request(gcs, CAMERA, "CAMERA_IMAGE_CAPTURED", index)
        # Also one that was not lost is there.
        assert request(gcs, CAMERA, "CAMERA_IMAGE_CAPTURED", 0).to_dict() == found[0].to_dict()
    figure(
        f"A survey uploaded in {uploaded:.1f} s and flown in {flown:.0f} s: {line.lost} messages lost, "
        f"{len(missing)} of {count} images requested again"
    )
    norths = [(found[index].lat * 1e-7 - HOME[0]) * DEGREE for index in sorted(found)]
    assert len(found) == 3 * 4 and heard == sorted(found), (norths, heard)
    for number in range(3):
        first, second, third, last = norths[4 * number : 4 * number + 4]
        way = 1 if number % 2 == 0 else -1
        for before, after, step in ((first, second, 10), (second, third, 10), (first, last, 25)):
            assert way * (after - before) == pytest.approx(step, abs=2.5 if step == 25 else 0.7), norths
    # Downwards: a rotation by -90 degrees about the axis of the pitch.
    assert all(found[index].q[2] == pytest.approx(-0.7071, abs=0.01) for index in found)
    assert request(other, CAMERA, "CAMERA_SETTINGS").mode_id == mavlink.CAMERA_MODE_IMAGE_SURVEY


# MAVProxy's gimbal module imports its map, which needs packages for windows. It uses it only if a map is open.
NO_MAP = """
import runpy, sys, types
name = "MAVProxy.modules.mavproxy_map"
sys.modules[name] = package = types.ModuleType(name)
package.mp_slipmap = sys.modules[name + ".mp_slipmap"] = types.ModuleType(name + ".mp_slipmap")
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def test_mavproxy_operates_gimbal_and_camera(port, other, tmp_path):
    """GIM-8: MAVProxy's modules point the gimbal by the older protocol and show both batteries; its order takes an image."""
    mavproxy = MavProxy(port, tmp_path, "gimbal,battery,cmdlong,misc", prelude=NO_MAP)
    try:
        mavproxy.expect("Detected vehicle 1:1")

        def turns(pitch, yaw, command):
            mavproxy.say(command)
            sines = math.sin(math.radians(pitch) / 2), math.sin(math.radians(yaw) / 2)
            cosines = math.cos(math.radians(pitch) / 2), math.cos(math.radians(yaw) / 2)
            expected = [
                cosines[1] * cosines[0],
                -sines[1] * sines[0],
                cosines[1] * sines[0],
                sines[1] * cosines[0],
            ]
            # A quaternion and its negative are the same attitude.
            is_it = lambda q: abs(sum(a * b for a, b in zip(q, expected))) > 0.9998
            points = lambda status: comes_from(GIMBAL)(status) and is_it(status.q)
            assert other.hear("GIMBAL_DEVICE_ATTITUDE_STATUS", 15, points), command

        turns(-30, 40, "gimbal angle 0 -30 40")
        turns(0, 0, "gimbal mode neutral")
        # Far away in the south.
        heading = math.degrees(other.wait("ATTITUDE", 10).yaw)
        turns(0, 180 - heading, f"gimbal roi {HOME[0] - 1} {HOME[1]} 0")
        turns(0, 0, "gimbal mode neutral")
        mavproxy.say("set numcells 4")
        mavproxy.say("set numcells2 2")
        mavproxy.ask_until("bat", "Bat2 ")
        mavproxy.expect_all("Bat1 ", "Flight battery:")
        before = request(other, CAMERA, "CAMERA_CAPTURE_STATUS").image_count
        mavproxy.say("cammsg")
        assert other.hear("CAMERA_IMAGE_CAPTURED", 15, lambda image: image.image_index == before)
    finally:
        mavproxy.end()
    assert order(other, AUTOPILOT, mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, 0, 0, -1, -1) == ACCEPTED


class Sequences:
    """The sequence numbers of each sender. pymavlink counts messages that it does not know as another sender's."""

    def __init__(self, gcs):
        self.last, self.gaps = {}, []
        self.receive = gcs.link.recv_msg
        gcs.link.recv_msg = self._receive

    def _receive(self):
        message = self.receive()
        if message and message.get_type() != "BAD_DATA":
            _, _, _, _, seq, system, component = message.get_msgbuf()[:7]
            last = self.last.get((system, component))
            if last is not None and seq != (last + 1) % 256:
                self.gaps.append((system, component, last, seq))
            self.last[system, component] = seq
        return message


def test_components_speak_for_themselves(port):
    """K-10, P-40, P-41, P-42: each component has heartbeats, sequence numbers and answers of its own; the camera has parameters."""
    gcs = Gcs(port)
    sequences = Sequences(gcs)
    try:
        kinds = {AUTOPILOT: mavlink.MAV_TYPE_QUADROTOR, CAMERA: mavlink.MAV_TYPE_CAMERA, GIMBAL: mavlink.MAV_TYPE_GIMBAL}
        for component, kind in kinds.items():
            for _ in range(2):
                beat = gcs.hear("HEARTBEAT", 5, comes_from(component))
                assert beat and beat.type == kind, component
        for component, kind in [
            (AUTOPILOT, "AUTOPILOT_VERSION"),
            (AUTOPILOT, "GIMBAL_MANAGER_INFORMATION"),
            (CAMERA, "CAMERA_INFORMATION"),
            (CAMERA, "STORAGE_INFORMATION"),
            (GIMBAL, "GIMBAL_DEVICE_INFORMATION"),
        ]:
            told = request(gcs, component, kind)
            if kind.startswith("GIMBAL"):
                assert (told.gimbal_device_id, round(told.pitch_min, 3)) == (GIMBAL * (component == AUTOPILOT), -1.571)
        for component in (CAMERA, GIMBAL):
            assert order(gcs, component, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_UNSUPPORTED

        def value(name):
            gcs.mav.param_ext_request_read_send(1, CAMERA, name.encode(), -1)
            told = gcs.hear("PARAM_EXT_VALUE", 5, lambda told: comes_from(CAMERA)(told) and told.param_id == name)
            assert told and told.param_count == 2
            return raw(told)

        # As bytes, not as a text.
        def raw(told):
            return bytes(told.get_msgbuf())[10 + 20 :]

        gcs.mav.param_ext_request_list_send(1, CAMERA)
        listed = [gcs.hear("PARAM_EXT_VALUE", 5, comes_from(CAMERA)) for _ in range(2)]
        assert [told and (told.param_index, told.param_id) for told in listed] == [(0, "CAM_MODE"), (1, "CAM_ISO")]
        for number, result in ((800, mavlink.PARAM_ACK_ACCEPTED), (1, mavlink.PARAM_ACK_VALUE_UNSUPPORTED), (100, 0)):
            wanted = number.to_bytes(4, "little")
            gcs.mav.param_ext_set_send(1, CAMERA, b"CAM_ISO", wanted, mavlink.MAV_PARAM_EXT_TYPE_UINT32)
            ack = gcs.hear("PARAM_EXT_ACK", 5, comes_from(CAMERA))
            assert ack and (ack.param_id, ack.param_result) == ("CAM_ISO", result)
            assert value("CAM_ISO")[:4] == (wanted if result == 0 else (800).to_bytes(4, "little"))
        assert {(1, component) for component in kinds} <= set(sequences.last) and not sequences.gaps
    finally:
        gcs.close()


def test_vehicle_without_components(target, request, tmp_path):
    """K-10: with `--no-components` only component 1 sends, and it has no commands for a camera or a gimbal."""
    option = request.config.getoption
    program = [option("program")] if target == "sitl" else [option("xtask"), "qemu"]
    vehicle = Logged([*program, "--no-components"], option("spare_port_base"), tmp_path)
    try:
        gcs = Gcs(vehicle.port)
        beats, components = 0, set()
        while beats < 4:
            message = gcs.hear(None, 10)
            assert message, "the vehicle is silent"
            # pymavlink does not report the sender of a message that it does not know.
            if "UNKNOWN" not in message.get_type():
                components.add(message.get_srcComponent())
            beats += message.get_type() == "HEARTBEAT"
        assert components == {AUTOPILOT}
        for command in [POINT, mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST, mavlink.MAV_CMD_IMAGE_START_CAPTURE]:
            assert gcs.command(command) == mavlink.MAV_RESULT_UNSUPPORTED
        gcs.close()
    finally:
        vehicle.end()
