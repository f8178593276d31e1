"""The firmwares on Ethernet, over smoltcp and embassy-net: ground stations on the network, which are UDP ports of this machine."""

import re
import socket
import time

import pytest
from conftest import Gcs, found_by_mavsdk
from firmware import running
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw
from plans import differences, plan
from pymavlink import mavutil
from qgc import Qgc
from stations import TIMED, Counter
from transfer import ACCEPTED, as_dict, download, upload

mavlink = mavutil.mavlink

# The number of stations that have a link, and the silence (s) after which a station is forgotten.
STATIONS, TIMEOUT = 4, 5
# The load: telemetry, and as many pings (frames/s).
RATE = 1000
# On a busy machine this program may not receive in time what the vehicle has sent. Then the load is repeated.
TRIES = 3
# For tests that do not depend on the network stack.
on_one = pytest.mark.parametrize("app", ["ethernet"], scope="module")


@pytest.fixture(scope="module", params=["ethernet", "ethernet-embassy"])
def app(request):
    return request.param


@pytest.fixture(scope="module")
def ports(app, request, tmp_path_factory):
    """The UDP port on which a ground station listens, and the one to which stations send."""
    option = request.config.getoption
    base = option("spare_port_base")
    file = tmp_path_factory.mktemp(app) / "output.txt"
    with running(option, app, file, f"--udp=127.0.0.1:{base + 3}"):
        yield base + 3, base
    assert re.search(r"address 10\.0\.2\.15/24 \(DHCP\), UDP port 14550", file.read_text()), file.read_text()


@pytest.fixture
def call(ports):
    """Connects stations that send first. Afterwards their links become free again."""
    opened = []

    def call(system, is_served=True):
        opened.append(Gcs(ports[1], "udpout", system=system, is_new=True))
        # Equal frames of stations with the same ids would be duplicates.
        opened[-1].mav.seq = 37 * len(opened) % 256
        opened[-1].mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        if is_served:
            assert opened[-1].wait("HEARTBEAT"), "the vehicle does not answer"
        return opened[-1]

    yield call
    for gcs in opened:
        gcs.close()


def test_heartbeats_are_broadcast_without_a_station(ports):
    """A receiver that never sends finds the vehicle: at its first station port, from the port to which it can answer."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", ports[0]))
        receiver.settimeout(8)
        ids = set()
        for _ in range(6):
            datagram, sender = receiver.recvfrom(65536)
            assert sender == ("127.0.0.1", ports[1])
            assert len(datagram) == 12 + datagram[1], "a datagram is one frame"
            ids.add(int.from_bytes(datagram[7:10], "little"))
        assert ids == {mavlink.MAVLINK_MSG_ID_HEARTBEAT}, "only heartbeats are broadcast"


# Each try takes up to twice the configured time.
@pytest.mark.timeout(900)
def test_a_thousand_frames_a_second_in_each_direction(ports, app, request, figure):
    """Telemetry at over 1,000 frames/s, and 1,000 PINGs/s that are all answered: no frame is lost."""
    duration = request.config.getoption("load_seconds")
    station = Counter(ports[1])
    try:
        for _ in range(TRIES):
            for message in TIMED:
                station.request(message, 2_500)
            station.run(1, 0)
            station.restart()
            sent, elapsed = station.run(duration, RATE)
            telemetry = station.rate()
            station.receive(1)
            for message in TIMED:
                station.request(message, 0)
            station.run(0.5, 0)
            if not station.discarded:
                break
        answers = station.counts[mavlink.MAVLINK_MSG_ID_PING]
        figure(f"{app}, {elapsed:.1f} s: {telemetry:.0f} frames/s of telemetry, {answers} of {sent} pings answered, {station.lost} lost")
        assert station.lost == 0
        assert answers == sent
        assert telemetry >= RATE
    finally:
        station.close()


def test_several_stations_at_once_get_answers(call, app, figure):
    """One uploads and downloads 250 items. The others have the same ids, and still get their own answers only."""
    # The station of the last test has the fourth link.
    pilot, twins = call(254), [call(255) for _ in range(STATIONS - 2)]
    for seq in range(10):
        for index, gcs in enumerate(twins):
            gcs.mav.ping_send(0, 100 * index + seq, 0, 0)
    for index, gcs in enumerate(twins):
        assert [gcs.wait("PING").seq for _ in range(10)] == list(range(100 * index, 100 * index + 10))
        assert gcs.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == mavlink.MAV_RESULT_ACCEPTED
        assert gcs.wait("AUTOPILOT_VERSION")
    items, began = plan(250, variant=1), time.monotonic()
    assert upload(pilot, items).type == ACCEPTED
    uploaded = time.monotonic()
    assert differences(items, download(pilot).items) == []
    figure(f"{app}: pymavlink: 250 items up {uploaded - began:.1f} s, down {time.monotonic() - uploaded:.1f} s")
    for gcs in twins:
        assert gcs.wait("HEARTBEAT")
        assert not any(message.get_type() == "COMMAND_ACK" for message in gcs.take_all()), "a second answer"


@on_one
def test_a_station_that_dies_is_forgotten(call, ports):
    """Further stations get no answer while all links are taken. After the silence of the dead ones they do."""
    for _ in range(STATIONS):
        # If the stations of an earlier test have the links, these get none.
        call(255, is_served=False).close()
    late = call(254, is_served=False)
    late.mav.ping_send(0, 1, 0, 0)
    assert not late.wait("PING", 1), "all links were taken"
    deadline = time.monotonic() + 2 * TIMEOUT
    while True:
        late.mav.ping_send(0, 2, 0, 0)
        if late.wait("PING", 0.5):
            break
        assert time.monotonic() < deadline, "the dead stations are not forgotten"
    # Its link carries everything now that it was heard for a second.
    time.sleep(1.1)
    late.mav.ping_send(0, 3, 0, 0)
    assert late.wait("HEARTBEAT") and late.wait("ATTITUDE")


@on_one
def test_qgroundcontrol_connects(ports):
    """QGroundControl's default: it listens on a UDP port, without any configuration."""
    gcs = Gcs(ports[0], "udpin", is_new=True)
    try:
        assert gcs.wait("HEARTBEAT", 2 * TIMEOUT), "the vehicle does not broadcast"
        qgc = Qgc(gcs)
        qgc.connect()
        assert qgc.is_ready and all(step.is_answered for step in qgc.steps), qgc.steps
        assert len(qgc.parameters) == qgc.parameter_count
    finally:
        gcs.close()


def test_mavsdk_uploads_and_downloads_250_items(ports, app, figure):
    with found_by_mavsdk(f"udpin://127.0.0.1:{ports[0]}") as system:
        missions, items = MissionRaw(system), plan(250)
        began = time.monotonic()
        missions.upload_mission([MissionItem(**item) for item in items])
        uploaded = time.monotonic()
        back = [as_dict(item) for item in missions.download_mission()]
        figure(f"{app}: MAVSDK: 250 items up {uploaded - began:.1f} s, down {time.monotonic() - uploaded:.1f} s")
        assert differences(items, back) == []
