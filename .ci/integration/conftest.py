"""Fixtures: the vehicle under test and its clients. `cargo xtask integration` starts the vehicle and passes the options."""

import contextlib
import pathlib
import time

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk
from plans import FENCE, MISSION, RALLY
from pymavlink import mavutil

# The capacity for mission items, fence items and rally points, by target.
CAPACITY = {
    "qemu": {MISSION: 250, FENCE: 64, RALLY: 16},
    "sitl": {MISSION: 1000, FENCE: 256, RALLY: 64},
}

# The time limit of a test (s). Some start a firmware of their own, which may take 120 s.
TIMEOUT = 300

FIGURES = []


def pytest_addoption(parser):
    parser.addoption("--target", choices=CAPACITY, required=True)
    parser.addoption("--port-base", type=int, required=True, help="the vehicle's first link; the others follow")
    parser.addoption("--spare-port-base", type=int, required=True, help="four free ports for a test to use")
    parser.addoption("--load-seconds", type=int, default=4, help="how long the tests with a high load take")
    parser.addoption("--qmp-port", type=int, help="QEMU's control port, for processor resets")
    parser.addoption("--program", type=pathlib.Path, help="the program of the vehicle in sitl")
    parser.addoption("--station", type=pathlib.Path, help="the example `foreign` of the station for tests, in sitl")
    parser.addoption("--xtask", type=pathlib.Path, help="the program that starts the vehicle in QEMU")


def pytest_configure(config):
    config.option.timeout = TIMEOUT


def pytest_terminal_summary(terminalreporter):
    for figure in FIGURES:
        terminalreporter.write_line(figure)
    passed, failed = (
        sum(len(terminalreporter.stats.get(key, [])) for key in keys) for keys in (["passed"], ["failed", "error"])
    )
    terminalreporter.write_line(f"{passed} passed, {failed} failed")


@pytest.fixture(scope="session")
def target(request):
    return request.config.getoption("target")


@pytest.fixture(scope="session")
def port(request):
    """The port of the telemetry link. The vehicle listens on it; over UDP, it sends to it."""
    return request.config.getoption("port_base")


@pytest.fixture
def capacities(target):
    return CAPACITY[target]


@pytest.fixture
def capacity(capacities):
    """The capacity for mission items."""
    return capacities[MISSION]


@pytest.fixture
def figure():
    """Adds a figure to the summary."""
    return FIGURES.append


class Gcs:
    """A ground station in pymavlink: component 190, system 255 by default."""

    def __init__(self, port, kind="tcp", system=255, is_new=False):
        self.address = (system, 190)
        self.link = mavutil.mavlink_connection(f"{kind}:127.0.0.1:{port}", source_system=system, source_component=190)
        if is_new:
            return
        # Discards what is left over from an earlier client.
        assert self.link.recv_match(type="HEARTBEAT", blocking=True, timeout=5), "no heartbeat within 5 s"
        self.drain()

    @property
    def mav(self):
        return self.link.mav

    def close(self):
        self.link.close()

    def drain(self):
        self.take_all()

    def take_all(self):
        """Returns the messages received so far."""
        messages = []
        while message := self.link.recv_match(blocking=False):
            messages.append(message)
        return messages

    def forget_half_a_frame(self):
        """After a power cut: discards an incomplete frame, which the next bytes do not continue."""
        self.drain()
        self.mav.buf = bytearray()
        self.mav.buf_index = 0

    def wait(self, kind, timeout=3.0, where=lambda message: True):
        """Returns the vehicle's next matching message of this kind, or None. Forwarded messages do not count."""
        return self.hear(kind, timeout, lambda message: message.get_srcComponent() == 1 and where(message))

    def hear(self, kind, timeout=3.0, where=lambda message: True):
        """Returns the next matching message of this kind from any sender, or None."""
        deadline = time.monotonic() + timeout
        while True:
            left = deadline - time.monotonic()
            if left > 0:
                message = self.link.recv_match(type=kind, blocking=True, timeout=left)
            elif not (message := self.link.recv_match(type=kind)):
                # pymavlink looks at its clock first. What arrived in time counts, even if this program did not run for a moment.
                return None
            if message and message.get_type() != "BAD_DATA" and where(message):
                return message

    def send_command(self, command, *params):
        params = [*params, *[0.0] * (7 - len(params))]
        self.mav.command_long_send(1, 1, command, 0, *params)

    def command(self, command, *params, timeout=3.0):
        """Sends a COMMAND_LONG and returns the result of its acknowledgement."""
        self.send_command(command, *params)
        ack = self.wait("COMMAND_ACK", timeout, lambda ack: ack.command == command)
        assert ack, f"no answer to command {command}"
        assert (ack.target_system, ack.target_component) == self.address
        return ack.result


def is_armed(heartbeat):
    return bool(heartbeat.base_mode & mavutil.mavlink.MAV_MODE_FLAG_SAFETY_ARMED)


@pytest.fixture
def gcs(port):
    gcs = Gcs(port)
    yield gcs
    gcs.close()


@pytest.fixture
def connect(port):
    """Connects as often as a test needs, one client at a time."""
    opened = []

    def connect(system=255):
        opened.append(Gcs(port, system=system))
        return opened[-1]

    yield connect
    for gcs in opened:
        gcs.close()


@pytest.fixture(scope="session")
def other_link(port):
    """A second client on the companion's link, shared by all tests."""
    gcs = Gcs(port + 1, system=254)
    yield gcs
    gcs.close()


@pytest.fixture
def other(other_link):
    """The second client, without messages from earlier tests."""
    other_link.drain()
    return other_link


@pytest.fixture(autouse=True)
def tidy(other_link):
    """After each test: leaves the vehicle on the ground, disarmed, without plans."""
    yield
    mavlink = mavutil.mavlink
    other_link.drain()

    def disarms():
        other_link.send_command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196)
        return other_link.wait("COMMAND_ACK", where=lambda ack: ack.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM)

    # Retransmits, as ground stations do: the previous test may leave a backlog on the link.
    assert any(disarms() for _ in range(4)), "the vehicle does not answer"
    # The open upload of a disconnected client blocks other clients until it times out.
    deadline = time.monotonic() + 15
    while time.monotonic() < deadline:
        other_link.mav.mission_clear_all_send(1, 1, mavlink.MAV_MISSION_TYPE_ALL)
        ack = other_link.wait("MISSION_ACK", where=lambda ack: ack.mission_type == mavlink.MAV_MISSION_TYPE_ALL)
        if ack and ack.type == mavlink.MAV_MISSION_ACCEPTED:
            return
        time.sleep(0.5)
    raise AssertionError("the vehicle's plans cannot be cleared any more")


@contextlib.contextmanager
def found_by_mavsdk(url):
    """The vehicle as MAVSDK sees it."""
    with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        assert mavsdk.add_any_connection(url).name == "SUCCESS"
        system = mavsdk.first_autopilot(timeout_s=10)
        assert system, "MAVSDK does not find the vehicle"
        yield system


@pytest.fixture
def vehicle(target, other, request, tmp_path):
    """A vehicle whose power may be cut."""
    # Imported here, because `power` imports this module.
    from power import InQemu, InSitl

    option = request.config.getoption
    if target == "qemu":
        vehicle = InQemu(option("qmp_port"), other)
    else:
        vehicle = InSitl(option("program"), option("spare_port_base"), tmp_path / "plans.bin")
    yield vehicle
    vehicle.end()


@pytest.fixture
def system(port):
    with found_by_mavsdk(f"tcpout://127.0.0.1:{port}") as system:
        yield system
