"""A ground station that signs with pymavlink. It reads one command per line and answers each with one line.

    key HEX TIMESTAMP LINK    signs with this key, and requires signatures
    as SYSTEM COMPONENT       sets its address
    tx NAME [HEX TIMESTAMP]   prints the frame of a message for vehicle 1/1: heartbeat, land, ping, or setup with a key
    rx HEX                    receives bytes; prints the ids of the messages in them, or `bad` for a refused one
    timestamp                 prints its own time
"""

import os
import sys

os.environ["MAVLINK20"] = "1"

from pymavlink.dialects.v20 import common as mavlink  # noqa: E402

link = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
link.robust_parsing = True


def message(name, arguments):
    if name == "heartbeat":
        return mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    if name == "land":
        return mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, 0, 0, 0, 0, 0)
    if name == "ping":
        return mavlink.MAVLink_ping_message(123, 7, 0, 0)
    key, timestamp = arguments
    return mavlink.MAVLink_setup_signing_message(1, 1, list(bytes.fromhex(key)), int(timestamp))


def answer(verb, *arguments):
    signing = link.signing
    if verb == "key":
        key, timestamp, link_id = arguments
        signing.secret_key = bytes.fromhex(key)
        signing.timestamp, signing.link_id, signing.sign_outgoing = int(timestamp), int(link_id), True
        signing.stream_timestamps.clear()
        return "ok"
    if verb == "as":
        link.srcSystem, link.srcComponent = map(int, arguments)
        return "ok"
    if verb == "tx":
        frame = message(arguments[0], arguments[1:]).pack(link)
        link.seq = (link.seq + 1) % 256
        return frame.hex()
    if verb == "timestamp":
        return str(signing.timestamp)
    found = link.parse_buffer(bytearray.fromhex(arguments[0])) or []
    return " ".join("bad" if one.get_type() == "BAD_DATA" else str(one.get_msgId()) for one in found)


for line in sys.stdin:
    print(answer(*line.split()), flush=True)
