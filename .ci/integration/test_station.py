"""The station for tests (`crates/station`), as each client, over UDP: against MAVSDK's server plugins as a foreign vehicle, and with the
same program against the demo. What fails with MAVSDK fails with the real client too. An unlisted failure fails the test."""

import contextlib
import re
import socket
import subprocess
import time

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action_server import ActionServer
from mavsdk.plugins.ftp_server import FtpServer
from mavsdk.plugins.mission_raw_server import MissionRawServer
from mavsdk.plugins.param_server import ParamServer
from mavsdk.plugins.telemetry_server import TelemetryServer
from power import InSitl
from pymavlink import mavftp, mavutil
from test_mavproxy import MISSION_FILE, MavProxy

mavlink = mavutil.mavlink
CLIENTS = ["QGroundControl", "MAVSDK", "MAVProxy", "pymavlink"]
SERVICES = "connect list set upload download clear arm disarm request directory file timesync".split()

CONTENT = bytes(range(256)) * 4
# What the program says of MAVSDK where all is well.
WITH_MAVSDK = {
    "connect": "GENERIC GENERIC at 1/1",
    "list": "2 parameters",
    "set": "CRUISE from 3 to 4 and back",
    "upload": "accepted",
    "download": "3 items as uploaded",
    "clear": "no items",
    "arm": "armed",
    "disarm": "disarmed",
    "request": "AUTOPILOT_VERSION",
    "directory": "2 entries",
    "file": f"{len(CONTENT)} bytes",
    "timesync": "answered",
}
# What fails with MAVSDK's servers: the failure, and why. `test_real_*` show it with the real clients.
EVERYBODY = {"timesync": (r"TIMESYNC was not answered", "MAVSDK answers TIMESYNC only if it measures the time itself")}
NO_SESSION = "the answer is of session 0, whatever the request's; the client drops it"
KNOWN = {
    "QGroundControl": EVERYBODY,
    "MAVSDK": EVERYBODY,
    "MAVProxy": EVERYBODY
    | {
        "clear": (
            r"MISSION_REQUEST_LIST of the mission was not answered",
            "MAVProxy does not acknowledge a download, so it stays open for seconds",
        ),
        "directory": (r"Page of .* was not answered", NO_SESSION),
        "file": (r"Open of .* was not answered", NO_SESSION),
    },
    "pymavlink": EVERYBODY
    | {
        "download": (r"the vehicle refused the mission: UNSUPPORTED", "MAVSDK refuses MISSION_REQUEST"),
        "clear": (r"the vehicle refused the mission: UNSUPPORTED", "the download before it is still open"),
    },
}
# A session is a byte, and MAVProxy's is 0 now and then: these may succeed.
BY_CHANCE = {"MAVProxy": {"directory", "file"}}


class Foreign:
    """The running program, which listens for a vehicle."""

    def __init__(self, program, client, parameter, file, port=0):
        command = [program, client, str(port), parameter, file]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        line = self.process.stdout.readline()
        assert line.startswith("port: "), line + self.process.stdout.read()
        self.port = int(line.split()[1])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()

    def result(self):
        """Returns what it says of each service, and its exit code."""
        lines = [line.rstrip("\n").split(": ", 1) for line in self.process.stdout]
        said = {service: what for service, what in lines if service != "missing"}
        assert list(said) == SERVICES, lines
        return said, self.process.wait()


@contextlib.contextmanager
def mavsdk_as_vehicle(url, root):
    """MAVSDK's server plugins. The files are in `root`."""
    (root / "logs").mkdir(parents=True)
    (root / "readme.txt").write_bytes(CONTENT)
    with Mavsdk(Configuration.create_with_component_type(ComponentType.AUTOPILOT)) as mavsdk:
        component = mavsdk.server_component()
        missions, params, actions, telemetry, files = (
            plugin(component) for plugin in (MissionRawServer, ParamServer, ActionServer, TelemetryServer, FtpServer)
        )
        params.provide_param_float("CRUISE", 3.0)
        params.provide_param_int("COUNT", 7)
        actions.set_armable(True, True)
        actions.set_disarmable(True, True)
        files.set_root_dir(str(root))
        assert mavsdk.add_any_connection(url).name == "SUCCESS"
        yield missions, params, actions, telemetry, files


@pytest.fixture(autouse=True)
def only_in_sitl(target):
    if target == "qemu":
        pytest.skip("the same code as in sitl, and slower")


@pytest.fixture
def program(request):
    return request.config.getoption("station")


@pytest.mark.parametrize("client", CLIENTS)
def test_mavsdk_as_a_foreign_vehicle(client, program, tmp_path, figure):
    known = KNOWN[client]
    with Foreign(program, client, "CRUISE", "readme.txt") as foreign:
        with mavsdk_as_vehicle(f"udpout://127.0.0.1:{foreign.port}", tmp_path / "files"):
            said, code = foreign.result()
    for service, what in said.items():
        if what == WITH_MAVSDK[service]:
            assert service not in known or service in BY_CHANCE.get(client, ()), f"{service} works by now: {what}"
        else:
            assert service in known and re.match(f"failed: {known[service][0]}", what), f"{service}: {what}"
    assert code == 1
    works = sum(not what.startswith("failed") for what in said.values())
    figure(f"The station as {client} with MAVSDK's servers: {works} of {len(SERVICES)} services, as the real client")


@pytest.mark.parametrize("client", CLIENTS)
def test_the_demo(client, program, request, tmp_path):
    """Everything works, as any client."""
    option = request.config.getoption
    base = option("spare_port_base")
    with Foreign(program, client, "RTL_RETURN_ALT", "@PARAM/param.pck", base) as foreign:
        vehicle = InSitl(option("program"), base, tmp_path / "plans.bin", f"--udp=127.0.0.1:{foreign.port}")
        try:
            said, code = foreign.result()
        finally:
            vehicle.end()
    assert not {service: what for service, what in said.items() if what.startswith("failed")}
    assert code == 0


# ---- the same failures with the real clients


def test_real_pymavlink_fails_at_the_same_services(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255, source_component=0)
    try:
        with mavsdk_as_vehicle(f"udpout://127.0.0.1:{port}", tmp_path / "files"):
            assert link.wait_heartbeat(timeout=5)
            ftp = mavftp.MAVFTP(link, 1, 1)
            assert ftp.cmd_list(["/"]).error_code == mavftp.FtpError.Success
            ftp.cmd_get(["readme.txt", str(tmp_path / "got")])
            assert ftp.process_ftp_reply("OpenFileRO", timeout=10).error_code == mavftp.FtpError.Success
            assert (tmp_path / "got").read_bytes() == CONTENT
            # It has ended session 0 and takes no answers of it any more.
            assert ftp.cmd_list(["/"]).error_code != mavftp.FtpError.Success
            link.waypoint_request_list_send()
            assert link.recv_match(type="MISSION_COUNT", blocking=True, timeout=3)
            link.waypoint_request_send(0)
            ack = link.recv_match(type=["MISSION_ACK", "MISSION_ITEM", "MISSION_ITEM_INT"], blocking=True, timeout=3)
            assert ack.get_type() == "MISSION_ACK" and ack.type == mavlink.MAV_MISSION_UNSUPPORTED
    finally:
        link.close()


def test_real_mavproxy_fails_at_the_same_services(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    mission = tmp_path / "mission.txt"
    mission.write_text(MISSION_FILE)
    with mavsdk_as_vehicle(f"tcpin://127.0.0.1:{port}", tmp_path / "files"):
        proxy = MavProxy(port, tmp_path, modules="wp,ftp,param")
        try:
            # MAVProxy counts sessions up from a random byte, so at most one of the two is session 0, whose answers it takes.
            before = proxy.expect("Received 2 parameters", timeout=60)
            if "FTP: request timed out" not in before:
                proxy.say("ftp get readme.txt")
                proxy.expect("FTP: request timed out", timeout=30)
            proxy.say(f"wp load {mission}")
            proxy.expect("Got MISSION_ACK: TYPE_MISSION: ACCEPTED")
            proxy.say("wp list")
            proxy.expect("Saved waypoints")
            proxy.say("wp clear")
            proxy.expect("Got MISSION_ACK: TYPE_MISSION: ACCEPTED")
            # The download is still open. The request that comes now is lost, a later one is answered.
            proxy.say("wp list")
            time.sleep(4)
            assert "Requesting 0 waypoints" not in proxy.output
            proxy.ask_until("wp list", "Requesting 0 waypoints")
        finally:
            proxy.end()
