"""The vehicle under test and how to reach it; `cargo xtask integration` starts it and passes the options."""

import contextlib
import time

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk
from pymavlink import mavutil

# Room for mission items, by where the vehicle runs.
CAPACITY = {"qemu": 250, "sitl": 1000}

# No single test takes longer, in seconds.
TIMEOUT = 180

FIGURES = []


def pytest_addoption(parser):
    parser.addoption("--target", choices=CAPACITY, required=True)
    parser.addoption("--port-base", type=int, required=True)


def pytest_configure(config):
    config.option.timeout = TIMEOUT


def pytest_terminal_summary(terminalreporter):
    for figure in FIGURES:
        terminalreporter.write_line(figure)
    passed, failed = (
        sum(len(terminalreporter.stats.get(key, [])) for key in keys) for keys in (["passed"], ["failed", "error"])
    )
    terminalreporter.write_line(f"{passed} passed, {failed} failed")


@pytest.fixture
def target(request):
    return request.config.getoption("target")


@pytest.fixture
def port(request):
    """The port of the telemetry link: where the vehicle listens, or, over UDP, where it sends to."""
    return request.config.getoption("port_base")


@pytest.fixture
def capacity(target):
    return CAPACITY[target]


@pytest.fixture
def figure():
    """Notes a figure for the summary."""
    return FIGURES.append


class Gcs:
    """A ground station made of pymavlink: system 255, component 190."""

    def __init__(self, port, kind="tcp"):
        self.link = mavutil.mavlink_connection(f"{kind}:127.0.0.1:{port}", source_system=255, source_component=190)
        # What an earlier client left on the line is no business of this test.
        assert self.link.recv_match(type="HEARTBEAT", blocking=True, timeout=5), "no heartbeat within 5 s"
        self.drain()

    @property
    def mav(self):
        return self.link.mav

    def close(self):
        self.link.close()

    def drain(self):
        while self.link.recv_match(blocking=False):
            pass

    def wait(self, kind, timeout=3.0, where=lambda message: True):
        """The next message of this kind that fits, or None."""
        deadline = time.monotonic() + timeout
        while (left := deadline - time.monotonic()) > 0:
            message = self.link.recv_match(type=kind, blocking=True, timeout=left)
            if message and message.get_type() != "BAD_DATA" and where(message):
                return message
        return None

    def send_command(self, command, *params):
        params = [*params, *[0.0] * (7 - len(params))]
        self.mav.command_long_send(1, 1, command, 0, *params)

    def command(self, command, *params, timeout=3.0):
        """Sends a COMMAND_LONG and returns the result of its acknowledgement."""
        self.send_command(command, *params)
        ack = self.wait("COMMAND_ACK", timeout, lambda ack: ack.command == command)
        assert ack, f"no answer to command {command}"
        assert (ack.target_system, ack.target_component) == (255, 190)
        return ack.result


@pytest.fixture
def gcs(port):
    gcs = Gcs(port)
    yield gcs
    gcs.close()


@pytest.fixture
def connect(port):
    """Connects as often as a test wants; one client at a time."""
    opened = []

    def connect():
        opened.append(Gcs(port))
        return opened[-1]

    yield connect
    for gcs in opened:
        gcs.close()


@contextlib.contextmanager
def found_by_mavsdk(url):
    """The vehicle as MAVSDK sees it."""
    with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        assert mavsdk.add_any_connection(url).name == "SUCCESS"
        system = mavsdk.first_autopilot(timeout_s=10)
        assert system, "MAVSDK does not find the vehicle"
        yield system


@pytest.fixture
def system(port):
    with found_by_mavsdk(f"tcpout://127.0.0.1:{port}") as system:
        yield system
