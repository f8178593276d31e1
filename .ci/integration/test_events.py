"""Events: MAVSDK shows them and the arming checks, from the file that the vehicle serves; pymavlink requests what it has missed."""

import json
import pathlib
import queue
import re
import time

import pytest
from conftest import found_by_mavsdk
from mavsdk.plugins.events import Events
from mavsdk.plugins.events.events import LogLevel
from newer import RequestEvent
from pymavlink import mavutil
from test_metadata import cache_metadata

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
FILE = pathlib.Path(__file__).parents[2] / "examples/demo/metadata/events.json"
COMPONENT = json.loads(FILE.read_bytes())["components"]["1"]
GROUPS = COMPONENT["event_groups"]
# Each event by its id, and each id by its name.
EVENTS = {1 << 24 | int(id): event for group in GROUPS.values() for id, event in group["events"].items()}
IDS = {event["name"]: id for id, event in EVENTS.items()}
SIZES = {"uint8_t": 1, "int8_t": 1, "uint16_t": 2, "int16_t": 2, "uint32_t": 4, "int32_t": 4, "float": 4}
SIZES |= {"uint64_t": 8, "int64_t": 8}
# Flags of CURRENT_EVENT_SEQUENCE.
RESET = 1


def fnv1a(text):
    hash = 0x811C9DC5
    for byte in text.encode():
        hash = (hash ^ byte) * 0x01000193 & 0xFFFFFFFF
    return hash


def test_file_follows_the_schema():
    """EVT-1, EVT-8: the rules of libevents' `validation/schema.json` and `scripts/validate.py`, as far as they concern this file."""
    assert set(COMPONENT) <= {"namespace", "enums", "event_groups", "supported_protocols", "navigation_mode_groups"}
    enums = COMPONENT["enums"]
    for name, enum in enums.items():
        assert re.fullmatch("[a-zA-Z][a-zA-Z0-9_]*_t", name) and enum["type"] in SIZES
        for value, entry in enum["entries"].items():
            assert value.isdigit() and set(entry) == {"name", "description"}
            assert re.fullmatch("[a-z][a-z0-9_]*", entry["name"]) and "\n" not in entry["description"]
    assert enums["health_t"]["entries"]["1"]["name"] == "none"
    size_of = {**SIZES, **{name: SIZES[enum["type"]] for name, enum in enums.items()}}
    seen = set()
    for group, content in GROUPS.items():
        for number, event in content["events"].items():
            name, arguments = event["name"], event["arguments"]
            assert int(number) == fnv1a(name) & 0xFFFFFF, "EVT-1"
            assert name not in seen and re.fullmatch("[^\n]{1,120}", event["message"])
            seen.add(name)
            assert sum(size_of[argument["type"]] for argument in arguments) <= 25
            for place in re.findall(r"\{(\d+)", event["message"]):
                assert 1 <= int(place) <= len(arguments)
            names = [argument["name"] for argument in arguments]
            if group == "default":
                continue
            if event.get("type") != "summary":
                assert names[:2] == ["modes", "health_component_index"] and arguments[1]["type"] == "uint8_t"
            elif group == "arming_check":
                assert names == ["chunk_idx", "error", "warning", "can_arm", "can_run"]
            else:
                assert names == ["chunk_idx", "is_present", "error", "warning"]
    modes = COMPONENT["navigation_mode_groups"]["groups"]
    assert len(modes) == len(enums["mode_groups_t"]["entries"])


def events_of(line, seconds):
    """Returns the vehicle's events of the next seconds."""
    events, end = [], time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        if event := line.wait("EVENT", left):
            events.append(event)
    return events


def request(line, first, last=None):
    line.mav.send(RequestEvent(first, first if last is None else last, 1, 1))


@pytest.fixture
def ready(other):
    """The vehicle can arm."""
    bit = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert other.wait("SYS_STATUS", 20, lambda status: status.onboard_control_sensors_health & bit)


def test_events_arrive_on_every_link(gcs, other, ready):
    """EVT-1, EVT-2: the same events with the same numbers, each of which the file describes."""
    for state in (1, 0):
        # While the other client connected, the vehicle may have reported its start.
        for line in (gcs, other):
            line.drain()
        assert gcs.command(ARM, state, 21196) == ACCEPTED
        received = {line: events_of(line, seconds) for line, seconds in ((gcs, 1.0), (other, 0.2))}
        names = [EVENTS[event.event]["name"] for event in received[gcs]]
        assert ("armed" if state else "disarmed") in names, names
        sequences = [event.sequence for event in received[gcs]]
        assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
        # A report of the checks may come between the two windows.
        both = [event for event in received[other] if event.sequence <= sequences[-1]]
        last = {event.sequence: bytes(event.arguments) for event in both}
        assert {event.sequence: bytes(event.arguments) for event in received[gcs]}.items() >= last.items()


def test_missed_events_are_requested(gcs):
    """EVT-3, EVT-4: CURRENT_EVENT_SEQUENCE has the last number. Events are sent again; what is too old is an error."""
    for state in (1, 0) * 5:
        assert gcs.command(ARM, state, 21196) == ACCEPTED
    gcs.drain()
    current = gcs.wait("CURRENT_EVENT_SEQUENCE", 5)
    assert current and not current.flags & RESET
    newest = current.sequence
    gcs.drain()
    request(gcs, newest - 3, newest)
    events = events_of(gcs, 1)
    assert [event.sequence for event in events] == list(range(newest - 3, newest + 1))
    assert all(event.event in EVENTS for event in events)
    request(gcs, (newest - 2_000) % 65_536)
    error = gcs.wait("RESPONSE_EVENT_ERROR")
    assert error and (error.sequence, error.target_system) == ((newest - 2_000) % 65_536, 255)
    oldest = error.sequence_oldest_available
    assert 0 <= newest - oldest < 24
    request(gcs, oldest)
    assert gcs.wait("EVENT").sequence == oldest


def test_receiver_recovers_every_event(gcs):
    """EVT-4: a receiver that drops every second event has all of them in the end, in order."""
    gcs.drain()
    latest = gcs.wait("CURRENT_EVENT_SEQUENCE", 5).sequence
    first, seen, names = latest + 1, 0, []
    for state in (1, 0) * 3:
        gcs.send_command(ARM, state, 21196)
        time.sleep(0.1)
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline and names.count("disarmed") < 3:
        event = gcs.wait("EVENT", 0.2)
        seen += bool(event)
        if not event or seen % 2:
            request(gcs, latest + 1)
        elif event.sequence == latest + 1:
            latest += 1
            names.append(EVENTS[event.event]["name"])
            request(gcs, latest + 1)
    assert names.count("armed") == names.count("disarmed") == 3, names
    assert latest + 1 - first == len(names)


def test_checks_are_reported_on_request(gcs, ready):
    """EVT-6, EVT-7: a summary, the failing checks, and a summary, at the latest two seconds after the last report."""
    gcs.drain()
    gcs.send_command(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
    names = [EVENTS[event.event]["name"] for event in events_of(gcs, 3)]
    assert names[-2:] == ["arming_check_summary", "health_summary"], names


def test_mavsdk_shows_events_and_checks(port, other, ready):
    """EVT-6, EVT-8: MAVSDK reads the file over FTP, asks for the checks, and shows which of them fails while it does."""
    cache_metadata(port)
    with found_by_mavsdk(f"tcpout://127.0.0.1:{port}") as system:
        events, shown, reports = Events(system), queue.Queue(), queue.Queue()
        events.subscribe_events(lambda event, _: shown.put(event))
        events.subscribe_health_and_arming_checks(lambda report, _: reports.put(report))

        def report(where, timeout=15):
            deadline = time.monotonic() + timeout
            while (left := deadline - time.monotonic()) > 0:
                try:
                    if where(report := reports.get(timeout=left)):
                        return report
                except queue.Empty:
                    break
            raise AssertionError("no such report")

        well = report(lambda report: report.current_mode_intention.can_arm_or_run)
        assert not well.all_problems
        components = {component.name: component for component in well.health_components}
        assert {name for name, component in components.items() if component.is_present} == {
            "system",
            "sensors",
            "gps",
            "battery",
        }
        assert components["gps"].label == "GPS"

        assert other.command(mavlink.MAV_CMD_PREFLIGHT_CALIBRATION, 1) in (ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)
        ill = report(lambda report: not report.current_mode_intention.can_arm_or_run)
        [problem] = ill.current_mode_intention.problems
        assert (problem.message, problem.log_level, problem.health_component) == ("Calibrating", LogLevel.ERROR, "sensors")
        assert problem.description == "Keep the vehicle still."
        report(lambda report: report.current_mode_intention.can_arm_or_run)

        for state, text in ((1, "Armed in Hold"), (0, "Disarmed")):
            assert other.command(ARM, state) == ACCEPTED
            while (event := shown.get(timeout=10)).message != text:
                pass
            assert (event.log_level, event.event_namespace, event.compid) == (LogLevel.INFO, "demo", 1)
        assert not events.get_health_and_arming_checks_report().all_problems
