"""MAVSDK uploads over links with a long round trip."""

import concurrent.futures
import contextlib
import itertools
import random
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


def is_free(port):
    try:
        with socket.create_server(("127.0.0.1", port)):
            return True
    except OSError:
        return False


def free_ports(count):
    """Returns the first ports for this many vehicles. They are none of those that the system gives to clients, which could take
    one before its vehicle does."""
    blocks = list(range(30_000, 32_768, PORTS))
    random.shuffle(blocks)
    free = (first for first in blocks if all(map(is_free, range(first, first + PORTS))))
    return list(itertools.islice(free, count))


@contextlib.contextmanager
def sitl(program, port):
    """Runs a vehicle for one test, whose telemetry link has this port."""
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
        assert process.poll() is None, "the vehicle has ended"
        yield
    finally:
        process.kill()
        process.wait()


def upload_from_afar(program, port, delay):
    """Uploads a plan over a link with this one-way delay. Returns the duration (s)."""
    items = plan(4)
    with sitl(program, port), contextlib.closing(Far(port, delay)) as far, found_by_mavsdk(far.url) as system:
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
        uploads = {
            delay: pool.submit(upload_from_afar, program, port, delay)
            for port, delay in zip(free_ports(len(DELAYS)), DELAYS, strict=True)
        }
    failures = {delay: upload.exception() for delay, upload in uploads.items() if upload.exception()}
    assert not failures
    for delay, upload in uploads.items():
        figure(f"MAVSDK: 4 items up over {delay} s each way: {upload.result():.1f} s")
