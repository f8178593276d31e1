"""Loads a plan file with pymavlink, prints the loaded items, and saves the plan again.

Usage: mavwp.py mission|fence|rally FILE SAVED
"""

import os
import struct
import sys

os.environ["MAVLINK20"] = "1"

from pymavlink import mavwp  # noqa: E402

LOADERS = {
    "mission": mavwp.MAVWPLoader,
    "fence": mavwp.MissionItemProtocol_Fence,
    "rally": mavwp.MissionItemProtocol_Rally,
}


def bits(value, kind="f"):
    """Of the nearest float of 32 bits, or of 64 (`d`); all NaN are one."""
    return "nan" if value != value else struct.pack(">" + kind, value).hex()


kind, path, saved = sys.argv[1:]
loader = LOADERS[kind]()
loader.load(path)
for item in loader.wpoints:
    floats = [bits(value) for value in (item.param1, item.param2, item.param3, item.param4, item.z)]
    coordinates = [bits(value, "d") for value in (item.x, item.y)]
    print(item.seq, item.current, item.frame, item.command, *floats, *coordinates, item.autocontinue)
loader.save(saved)
