"""Flight logs with pymavlink, MAVSDK and MAVProxy, read back with pyulog (LOG-1, LOG-2, LOG-3, LOG-4, LOG-6, LOG-7, LOG-15).

A log is streamed to pymavlink too (LOG-10, LOG-11, LOG-12, LOG-13). MAVSDK 4.1 streams only from PX4 and ArduPilot."""

import time

import pytest
from conftest import is_armed
from mavsdk.plugins.log_files import LogFiles
from mavsdk.plugins.log_files.log_files import LogFilesError, LogFilesResult
from pymavlink import mavutil
from pyulog import ULog
from test_files import Files
from test_mavproxy import MavProxy

mavlink = mavutil.mavlink
ALL = 0xFFFFFFFF
# PX4's number of the mode Takeoff.
TAKEOFF = 17


def fly(client, seconds):
    """Takes off, and ends the flight after a few seconds."""
    deadline = time.monotonic() + 10
    while client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) != mavlink.MAV_RESULT_ACCEPTED:
        assert time.monotonic() < deadline, "the vehicle does not arm"
        time.sleep(0.2)
    assert client.command(mavlink.MAV_CMD_NAV_TAKEOFF) == mavlink.MAV_RESULT_ACCEPTED
    time.sleep(seconds)
    disarm(client)


def disarm(client):
    assert client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == mavlink.MAV_RESULT_ACCEPTED
    assert client.wait("HEARTBEAT", 5, lambda heartbeat: not is_armed(heartbeat))


def entries(client, start=0, end=0xFFFF):
    """Returns the entries of the list, up to its last one."""
    client.drain()
    client.mav.log_request_list_send(1, 1, start, end)
    found = []
    while entry := client.wait("LOG_ENTRY", 3):
        found.append(entry)
        if entry.num_logs == 0 or entry.id == entry.last_log_num:
            break
    return found


def get(client, entry):
    """Downloads a log: requests what is missing until it is complete."""
    blocks = {}
    begin = time.monotonic()
    while missing := [offset for offset in range(0, entry.size, 90) if offset not in blocks]:
        assert time.monotonic() < begin + 60, f"{len(missing)} blocks are missing"
        client.mav.log_request_data_send(1, 1, entry.id, missing[0], ALL)
        while data := client.wait("LOG_DATA", 1, lambda data: data.id == entry.id):
            blocks[data.ofs] = bytes(data.data[: data.count])
            if data.ofs + data.count >= entry.size:
                break
    client.mav.log_request_end_send(1, 1)
    content = b"".join(blocks[offset] for offset in sorted(blocks))
    assert len(content) == entry.size
    return content


def read(content, folder):
    path = folder / "flight.ulg"
    path.write_bytes(content)
    return ULog(str(path))


@pytest.fixture(scope="module")
def logs(other_link):
    """The contents of two logs."""
    other_link.mav.log_erase_send(1, 1)
    assert other_link.wait("STATUSTEXT", 3, lambda text: text.text == "Logs erased")
    (none,) = entries(other_link)
    assert (none.num_logs, none.size) == (0, 0)
    fly(other_link, 2)
    fly(other_link, 5)
    return [get(other_link, entry) for entry in entries(other_link)]


def test_log_is_read_by_pyulog(logs, tmp_path, figure):
    assert len(logs) == 2
    for content, seconds in zip(logs, (2, 5)):
        ulog = read(content, tmp_path)
        topics = {data.name: data.data for data in ulog.data_list}
        assert ulog.msg_info_dict["sys_name"] == "mavstack" and not ulog.file_corruption
        flight = (ulog.last_timestamp - ulog.start_timestamp) / 1e6
        figure(f"a log of {flight:.1f} s: {len(content)} bytes")
        assert seconds < flight < seconds + 4
        # Five times a second, and the other topics more slowly.
        assert len(topics["vehicle_attitude"]["timestamp"]) > 4 * seconds
        assert len(topics["vehicle_local_position"]["timestamp"]) > 2 * seconds
        norm = sum(topics["vehicle_attitude"][f"q[{i}]"] ** 2 for i in range(4))
        assert abs(norm - 1).max() < 1e-3
        assert topics["vehicle_local_position"]["z"].min() < -0.5
        assert 473_000_000 < topics["vehicle_gps_position"]["lat"][0] < 474_000_000
        assert 9 < topics["battery_status"]["voltage_v"].min() < 13
        status = topics["vehicle_status"]
        assert list(status["arming_state"][[0, -1]]) == [2, 1] and TAKEOFF in status["nav_state"]


def test_texts_are_in_the_log(logs, other, tmp_path):
    """A text of the stack itself too: the refused request for the list."""
    assert other.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED
    assert other.wait("HEARTBEAT", 5, is_armed)
    assert entries(other) == [], "nothing is listed in flight"
    time.sleep(0.5)
    disarm(other)
    content = get(other, entries(other)[-1])
    texts = [text.message for text in read(content, tmp_path).logged_messages]
    assert "Logs refused: disarm first" in texts


def test_part_of_a_log(logs, gcs):
    # The flights were made since this client has listed the logs (LOG-16).
    gcs.mav.log_request_data_send(1, 1, 1, 100, 180)
    assert not gcs.wait("LOG_DATA", 0.5)
    assert len(entries(gcs)) >= len(logs)
    gcs.mav.log_request_data_send(1, 1, 1, 100, 180)
    parts = [gcs.wait("LOG_DATA"), gcs.wait("LOG_DATA")]
    assert [(part.ofs, part.count) for part in parts] == [(100, 90), (190, 90)]
    assert bytes(parts[0].data + parts[1].data) == logs[1][100:280]
    # The end.
    gcs.mav.log_request_data_send(1, 1, 1, len(logs[1]), ALL)
    part = gcs.wait("LOG_DATA")
    assert (part.ofs, part.count) == (len(logs[1]), 0)
    (entry,) = entries(gcs, 1, 1)
    assert (entry.id, entry.last_log_num, entry.size) == (1, 1, len(logs[1]))
    gcs.mav.log_request_end_send(1, 1)


def test_mavsdk_downloads(logs, system, tmp_path):
    plugin = LogFiles(system)
    found = list(plugin.get_entries())
    assert [entry.size_bytes for entry in found[:2]] == [len(content) for content in logs]
    for entry, content in zip(found, logs):
        path = tmp_path / f"{entry.id}.ulg"
        ended = []
        plugin.download_log_file_async(entry, str(path), lambda result, progress, _: ended.append(result))
        deadline = time.monotonic() + 30
        while LogFilesResult.SUCCESS not in ended:
            assert time.monotonic() < deadline and all(result in (0, 1, 2) for result in ended), ended
            time.sleep(0.1)
        assert path.read_bytes() == content


def test_mavproxy_downloads(logs, port, tmp_path):
    proxy = MavProxy(port, tmp_path, "log")
    try:
        proxy.expect("Detected vehicle")
        proxy.say("log list")
        proxy.expect(f"size {len(logs[1])}")
        for number, content in enumerate(logs):
            proxy.say(f"log download {number} {number}.ulg")
            proxy.expect(f"Finished downloading {number}.ulg ({len(content)} bytes", timeout=30)
            assert (tmp_path / f"{number}.ulg").read_bytes() == content
    finally:
        proxy.end()


def test_log_is_a_file(logs, gcs):
    files = Files(gcs, burst_read_size=239)
    for number, content in enumerate(logs):
        assert files.get(f"@MAV_LOG/log_{number}.ulg") == content


def test_logs_survive_a_reboot(logs, gcs):
    assert gcs.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == mavlink.MAV_RESULT_ACCEPTED
    time.sleep(1)
    assert gcs.wait("HEARTBEAT", 10)
    assert [get(gcs, entry) for entry in entries(gcs)[:2]] == logs


def test_log_is_streamed_to_pymavlink(gcs, tmp_path):
    assert gcs.command(mavlink.MAV_CMD_LOGGING_START, 0) == mavlink.MAV_RESULT_ACCEPTED
    packets, beginnings = {}, {}
    deadline = time.monotonic() + 4
    while time.monotonic() < deadline:
        packet = gcs.wait(["LOGGING_DATA", "LOGGING_DATA_ACKED"], 1)
        if not packet:
            # On a busy machine the emulator may not run for a second.
            continue
        if packet.get_type() == "LOGGING_DATA_ACKED":
            gcs.mav.logging_ack_send(1, 1, packet.sequence)
        assert (packet.target_system, packet.target_component) == gcs.address
        packets[packet.sequence] = bytes(packet.data[: packet.length])
        beginnings[packet.sequence] = packet.first_message_offset
    assert gcs.command(mavlink.MAV_CMD_LOGGING_STOP) == mavlink.MAV_RESULT_ACCEPTED
    gcs.drain()
    assert not gcs.wait(["LOGGING_DATA", "LOGGING_DATA_ACKED"], 1)
    assert list(packets) == list(range(len(packets))) and beginnings[0] == 0
    ulog = read(b"".join(packets.values()), tmp_path)
    topics = {data.name: data.data for data in ulog.data_list}
    assert ulog.msg_info_dict["sys_name"] == "mavstack" and len(topics["vehicle_attitude"]["timestamp"]) > 12


def test_mavsdk_finds_no_log(logs, system):
    """The last test: it erases."""
    plugin = LogFiles(system)
    plugin.erase_all_log_files()
    time.sleep(0.5)
    with pytest.raises(LogFilesError) as refusal:
        plugin.get_entries()
    assert refusal.value.result == LogFilesResult.NO_LOGFILES
