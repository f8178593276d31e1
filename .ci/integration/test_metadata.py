"""Component metadata (O-1): MAVSDK follows COMPONENT_METADATA to the parameter file, which the vehicle serves."""

import json
import pathlib
import queue
import subprocess
import sys

import jsonschema
import pytest
from mavsdk.plugins.component_metadata import ComponentMetadata
from mavsdk.plugins.component_metadata.component_metadata import MetadataType
from test_params import INT32, REAL32, fetch

TYPES = {"Int32": INT32, "Float": REAL32}

# What MAVLink's component_metadata/parameter.schema.json (July 2026) demands, except for the version of the format: it asks for 3, while
# QGroundControl reads only 1.
TEXT, NUMBER, FLAG = {"type": "string"}, {"type": "number"}, {"type": "boolean"}
PARAMETER = {
    "name": {"type": "string", "pattern": r"^[\.\-a-zA-Z0-9_\{\}]{1,16}$"},
    "type": {"enum": ["Uint8", "Int8", "Uint16", "Int16", "Uint32", "Int32", "Float"]},
    **dict.fromkeys(["shortDesc", "longDesc", "units", "group", "category"], TEXT),
    **dict.fromkeys(["default", "min", "max", "increment"], NUMBER),
    **dict.fromkeys(["rebootRequired", "volatile", "readOnly"], FLAG),
    "decimalPlaces": {"type": "integer", "minimum": 0},
    "values": {"type": "array", "items": {"type": "object", "properties": {"value": NUMBER, "description": TEXT}}},
    "bitmask": {
        "type": "array",
        "items": {"type": "object", "properties": {"index": {"type": "integer"}, "description": TEXT}},
    },
}
SCHEMA = {
    "$schema": "http://json-schema.org/draft-07/schema",
    "type": "object",
    "properties": {
        "version": {"type": "integer", "minimum": 1},
        "translation": {"type": "object"},
        "parameters": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": PARAMETER,
                "required": ["name"],
                "additionalProperties": False,
            },
        },
    },
    "required": ["version", "parameters"],
    "additionalProperties": False,
}

# Requests the metadata, waits for another file in the cache, and exits without waiting for MAVSDK.
ASK = """
import os, sys, time
from conftest import found_by_mavsdk
from mavsdk.plugins.component_metadata import ComponentMetadata
from test_metadata import cached
with found_by_mavsdk(sys.argv[1]) as system:
    count, deadline = len(cached()), time.monotonic() + 20
    ComponentMetadata(system).request_autopilot_component()
    while len(cached()) <= count and time.monotonic() < deadline:
        time.sleep(0.1)
    os._exit(0)
"""


def cached():
    """Returns the files of the vehicle in MAVSDK's cache, which is in the home folder of this run of the tests. A second file belongs to
    each."""
    cache = (pathlib.Path.home() / ".cache/mavsdk/component_metadata").glob("compid-001_*.cache")
    return [file for file in cache if is_written(file) and is_written(file.with_suffix(".meta"))]


def is_written(file):
    return file.exists() and file.stat().st_size > 0


# The general file, the parameters and the events.
FILES = 3


def cache_metadata(port, files=FILES):
    """MAVSDK 4.1 hangs when it has to fetch several files at once. Each try leaves at least one more of them in its cache. What earlier
    tests have left there is removed: the vehicle serves the files."""
    for file in cached():
        file.unlink()
    command = [sys.executable, "-c", ASK, f"tcpout://127.0.0.1:{port}"]
    for _ in range(files + 1):
        subprocess.run(command, cwd=pathlib.Path(__file__).parent, timeout=60, check=True)
        if len(cached()) >= files:
            return
    raise AssertionError("MAVSDK does not fetch the files")


@pytest.fixture
def was_asked_before(port):
    cache_metadata(port, FILES - 1)


def test_parameters_are_described(was_asked_before, system, other):
    metadata, available = ComponentMetadata(system), queue.Queue()
    metadata.subscribe_metadata_available(lambda update, *_: available.put(update))
    metadata.request_autopilot_component()
    while (update := available.get(timeout=30)).type != MetadataType.PARAMETER:
        pass
    file = json.loads(update.json_metadata)
    jsonschema.validate(file, SCHEMA, cls=jsonschema.Draft7Validator)
    described = file["parameters"]
    listed = fetch(other)
    assert [parameter["name"] for parameter in described] == [value.name for value in listed]
    for parameter, value in zip(described, listed):
        assert TYPES[parameter["type"]] == value.type, parameter
        assert parameter["min"] <= value.value <= parameter["max"], parameter
        assert parameter["min"] <= parameter["default"] <= parameter["max"], parameter
    named = {parameter["name"]: parameter for parameter in described}
    cruise = named["MPC_XY_CRUISE"]
    assert [cruise[key] for key in ("units", "min", "max", "decimalPlaces", "increment")] == ["m/s", 0.5, 25.0, 1, 0.5]
    actions = {value["value"]: value["description"] for value in named["GF_ACTION"]["values"]}
    assert actions == {0: "None", 1: "Warning", 2: "Hold", 3: "Return"}
    flags = ("category", "rebootRequired", "readOnly", "volatile")
    assert [named["MAV_SYS_ID"].get(flag) for flag in flags] == ["System", True, None, None]
    assert [named["STAT_HL_BYTES"].get(flag) for flag in flags] == [None, None, True, True]
