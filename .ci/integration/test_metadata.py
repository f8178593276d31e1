"""Component metadata (O-1): MAVSDK follows COMPONENT_METADATA to the parameter file, and accepts a refusal."""

import json
import pathlib
import queue
import subprocess
import sys
import time

import pytest
from mavsdk.plugins.component_metadata import ComponentMetadata
from mavsdk.plugins.component_metadata.component_metadata import (
    ComponentMetadataError,
    ComponentMetadataResult,
    MetadataType,
)
from test_params import INT8, INT16, INT32, REAL32, UINT8, UINT16, UINT32, fetch

TYPES = {"Uint8": UINT8, "Int8": INT8, "Uint16": UINT16, "Int16": INT16, "Uint32": UINT32, "Int32": INT32, "Float": REAL32}

# Requests the metadata and exits, without waiting for MAVSDK.
ASK = """
import os, sys, time
from conftest import found_by_mavsdk
from mavsdk.plugins.component_metadata import ComponentMetadata
with found_by_mavsdk(sys.argv[1]) as system:
    ComponentMetadata(system).request_autopilot_component()
    time.sleep(3)
    os._exit(0)
"""


@pytest.fixture
def was_asked_before(target, port):
    """MAVSDK 4.1 hangs when it has to fetch both files at once. A first try leaves one of them in its cache."""
    if target == "sitl":
        command = [sys.executable, "-c", ASK, f"tcpout://127.0.0.1:{port}"]
        subprocess.run(command, cwd=pathlib.Path(__file__).parent, timeout=30, check=True)


def test_parameters_are_described(target, was_asked_before, system, other):
    """sitl serves the files itself. In QEMU nothing serves them, and the vehicle refuses the request."""
    metadata, available = ComponentMetadata(system), queue.Queue()
    metadata.subscribe_metadata_available(lambda update, *_: available.put(update))
    metadata.request_autopilot_component()
    if target == "qemu":
        deadline = time.monotonic() + 30
        while True:
            with pytest.raises(ComponentMetadataError) as refusal:
                metadata.get_metadata(1, MetadataType.PARAMETER)
            if refusal.value.result != ComponentMetadataResult.NOT_REQUESTED or time.monotonic() > deadline:
                break
            time.sleep(0.1)
        assert refusal.value.result == ComponentMetadataResult.NOT_AVAILABLE
        return
    while (update := available.get(timeout=30)).type != MetadataType.PARAMETER:
        pass
    described = json.loads(update.json_metadata)["parameters"]
    listed = fetch(other)
    assert [parameter["name"] for parameter in described] == [value.name for value in listed]
    for parameter, value in zip(described, listed):
        assert TYPES[parameter["type"]] == value.type, parameter
        assert parameter["min"] <= value.value <= parameter["max"], parameter
        assert parameter["min"] <= parameter["default"] <= parameter["max"], parameter
    cruise = next(parameter for parameter in described if parameter["name"] == "MPC_XY_CRUISE")
    assert (cruise["units"], cruise["min"], cruise["max"]) == ("m/s", 0.5, 25.0)
