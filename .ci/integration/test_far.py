"""MAVSDK uploads over links with a long round trip."""

import concurrent.futures
import contextlib
import socket
import subprocess
import time

import pytest
from conftest import Gcs, found_by_mavsdk
from far import Far
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw
from plans import differences, plan
from transfer import download

# One-way delays (s).
DELAYS = (0.05, 0.25, 0.5, 0.8)

# A vehicle has three links and a port for its metadata.
PORTS = 4


def free_ports():
    """Returns the first of a few consecutive free ports."""
    while True:
        with contextlib.ExitStack() as stack:
            first = stack.enter_context(socket.create_server(("127.0.0.1", 0))).getsockname()[1]
            try:
                for port in range(first + 1, first + PORTS):
                    stack.enter_context(socket.create_server(("127.0.0.1", port)))
                return first
            except (OSError, OverflowError):
                continue


@contextlib.contextmanager
def sitl(program):
    """Runs a vehicle for one test and yields the port of its telemetry link."""
    port = free_ports()
    process = subprocess.Popen([program, "--port-base", str(port)], stdout=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 10
        while True:
            with contextlib.suppress(ConnectionRefusedError):
                # Probe the companion's link, so that the telemetry link stays free for the test.
                socket.create_connection(("127.0.0.1", port + 1)).close()
                break
            assert process.poll() is None and time.monotonic() < deadline, "the vehicle does not start"
            time.sleep(0.01)
        yield port
    finally:
        process.kill()
        process.wait()


def upload_from_afar(program, delay):
    """Uploads a plan over a link with this one-way delay. Returns the duration (s)."""
    items = plan(4)
    with sitl(program) as port, contextlib.closing(Far(port, delay)) as far, found_by_mavsdk(far.url) as system:
        began = time.monotonic()
        MissionRaw(system).upload_mission([MissionItem(**item) for item in items])
        took = time.monotonic() - began
        with contextlib.closing(Gcs(port + 1, system=254)) as companion:
            assert differences(items, download(companion).items) == []
    return took


def test_mavsdk_uploads_over_any_distance(target, request, figure):
    """M-40, M-43: MAVSDK fails an upload in which it is asked for an item more than five times, and gives up after 2.5 s
    without a request."""
    if target != "sitl":
        pytest.skip("runs on sitl only: the code is the same, and each distance needs its own vehicle")
    program = request.config.getoption("program")
    with concurrent.futures.ThreadPoolExecutor() as pool:
        uploads = {delay: pool.submit(upload_from_afar, program, delay) for delay in DELAYS}
    failures = {delay: upload.exception() for delay, upload in uploads.items() if upload.exception()}
    assert not failures
    for delay, upload in uploads.items():
        figure(f"MAVSDK: 4 items up over {delay} s each way: {upload.result():.1f} s")
