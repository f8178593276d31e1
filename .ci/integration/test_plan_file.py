"""sitl starts with a plan from a text file, and stores it. Rule W-9."""

import pathlib
import time

import pytest
from plans import FENCE, MISSION
from power import InSitl
from transfer import download

SAMPLES = pathlib.Path(__file__).parents[2] / "tests" / "wpl"


def has_plans(log):
    """Returns whether a log has the last page of a record of plans, which is written last. See `src/storage/format.md`."""
    pages = [log[at : at + 256] for at in range(0, len(log), 256)]
    # The kind, and the flag of the last page. The footer's checksum is written with it.
    return any(page[:4] == b"ML\x01\x01" and page[239] & 1 and page[252:] != b"\xff" * 4 for page in pages)


@pytest.mark.parametrize(
    "file, options, kind, commands",
    [
        # Its jump leads to row 3 of the file. Row 0 is home, so this is item 2.
        ("qgroundcontrol.waypoints", [], MISSION, [22, 178, 16, 16, 177, 21]),
        # Row 0 is an item: MAVProxy writes no home (W-9).
        ("mavproxy_fence.txt", [], FENCE, [5000, 5001, 5001, 5001, 5004]),
    ],
)
def test_sitl_starts_with_a_plan_from_a_file(request, target, tmp_path, file, options, kind, commands):
    if target != "sitl":
        pytest.skip("sitl alone reads files")
    option = request.config.getoption
    program, port = option("program"), option("spare_port_base")
    storage = tmp_path / "plans.bin"
    vehicle = InSitl(program, port, storage, "--plan", SAMPLES / file, *options)
    try:
        plan = download(vehicle.gcs, kind)
        assert [item["command"] for item in plan.items] == commands
        if kind == MISSION:
            assert (plan.items[0]["x"], plan.items[0]["y"], plan.items[4]["param1"]) == (473977420, 85455940, 2.0)
        deadline = time.monotonic() + 5
        while not has_plans(storage.read_bytes()):
            assert time.monotonic() < deadline, "it is not stored"
            time.sleep(0.01)
        del vehicle.command[vehicle.command.index("--plan") :]
        vehicle.cut()
        assert download(vehicle.gcs, kind).id == plan.id != 0
    finally:
        vehicle.end()
