#!/usr/bin/env python3
"""Generates Python from a definition by pymavlink's mavgen, and prints what it says of each of its messages, and one frame of each.

    mavgen_frames.py DEFINITION OUTPUT

Common, which the definition includes, is beside it. A line has id, name, CRC_EXTRA, the frame with the values below.
"""

import contextlib
import importlib.util
import io
import sys

from pymavlink.generator import mavgen

VALUES = {
    "WINCH_REPORT": {
        "time_usec": 0x0102030405060708,
        "energy": 1.5,
        "line_out": 2.5,
        "acceleration": [1.0, 2.0, 3.0],
        "turns": -5,
        "id": 7,
        "faults": 0x8001,
        "tension": 1000,
        "temperatures": [-1, 2],
        "state": 2,
        "result": 4,
        "type": 9,
        "trim": -8,
        "grade": b"x",
        "name": b"hook",
        "cells": [1, 2, 3, 4],
        "odometer": -6,
        "last": [1, 2],
    },
    "WINCH_CONTROL": {"speed": -0.5, "target_system": 1, "target_component": 2},
}


def main():
    definition, output = sys.argv[1:]
    options = mavgen.Opts(output, wire_protocol="2.0", language="Python3", validate=True)
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        is_valid = mavgen.mavgen(options, [definition])
    if is_valid is False:
        sys.exit(said.getvalue())
    spec = importlib.util.spec_from_file_location("generated", output)
    generated = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generated)
    sender = generated.MAVLink(None, srcSystem=1, srcComponent=1)
    for name, values in VALUES.items():
        kind = getattr(generated, f"MAVLink_{name.lower()}_message")
        message = kind(*(values[field] for field in kind.fieldnames))
        sender.seq = 0
        print(kind.id, name, kind.crc_extra, message.pack(sender).hex())
    commands = generated.enums["MAV_CMD"]
    for value in (50_010, 50_011, 50_012):
        print(value, commands[value].name)


if __name__ == "__main__":
    main()
