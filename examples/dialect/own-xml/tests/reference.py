#!/usr/bin/env python3
"""Encodes and decodes frames with MAVLink's reference implementation, generated from crane.xml.

    reference.py CRANE_XML DEFINITIONS [FRAMES]

Prints CRANE_CONTROL and COMMAND_LONG MAV_CMD_CRANE_HOOK from system 255 to system 7 in hexadecimal. Then decodes FRAMES
(hexadecimal) and prints a line for each message.
"""

import importlib.util
import os
import shutil
import sys
import tempfile

from pymavlink.generator import mavgen, mavparse


def module(crane, definitions, directory):
    for name in ("common.xml", "minimal.xml", "standard.xml"):
        shutil.copy(os.path.join(definitions, name), directory)
    path = os.path.join(directory, "crane_v2.py")
    options = mavgen.Opts(path, wire_protocol=mavparse.PROTOCOL_2_0, language="Python3", validate=False)
    # mavgen prints its progress.
    stdout, sys.stdout = sys.stdout, sys.stderr
    mavgen.mavgen(options, [shutil.copy(crane, directory)])
    sys.stdout = stdout
    os.environ["MAVLINK20"] = "1"
    spec = importlib.util.spec_from_file_location("crane_v2", path)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def main():
    crane, definitions, *frames = sys.argv[1:]
    with tempfile.TemporaryDirectory() as directory:
        dialect = module(crane, definitions, directory)
    link = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    control = dialect.MAVLink_crane_control_message(target_system=7, target_component=1, speed=-0.5)
    hook = dialect.MAV_CMD_CRANE_HOOK
    command = dialect.MAVLink_command_long_message(7, 1, hook, 0, dialect.CRANE_HOOK_OPEN, 2.0, 0, 0, 0, 0, 0)
    for message in control, command:
        print(message.pack(link).hex())
    for message in link.parse_buffer(bytearray.fromhex("".join(frames))) or []:
        print(message.to_dict())


if __name__ == "__main__":
    main()
