"""Flight plans for the tests: every field of every item has a value of its own."""

import math
import struct

GLOBAL_RELATIVE_ALT = 3
NAV_WAYPOINT, NAV_LAND, NAV_TAKEOFF, DO_CHANGE_SPEED = 16, 21, 22, 178

# Where the demo vehicle stands, deg * 1e7.
HOME = (473977420, 85455940)


def single(value):
    """The value after a trip through 32 bits."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


def plan(count):
    """`count` items: a take-off, waypoints that differ in every field, a change of speed now and then."""
    items = []
    for seq in range(count):
        item = dict(
            seq=seq,
            frame=GLOBAL_RELATIVE_ALT,
            command=NAV_WAYPOINT,
            current=int(seq == 0),
            autocontinue=1,
            param1=single(seq % 7 + 0.25),
            param2=single(1 + seq / 3),
            param3=single(seq * 0.1),
            # "Your choice" and a number.
            param4=math.nan if seq % 2 else single(seq % 360),
            x=HOME[0] + 1000 * seq + 1,
            y=HOME[1] - 777 * seq - 3,
            z=single(20 + seq / 7),
        )
        if seq == 0:
            item.update(command=NAV_TAKEOFF)
        elif seq % 10 == 5:
            item.update(command=DO_CHANGE_SPEED, param2=single(3 + seq % 5), x=0, y=0, z=0.0)
        items.append(item)
    return items


def same(a, b):
    """Equal, where NaN equals NaN."""
    return a == b or (isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b))


def differences(sent, received):
    """The fields that differ, as (seq, field, sent, received)."""
    if len(sent) != len(received):
        return [("count", len(sent), len(received))]
    return [
        (item["seq"], field, item[field], back[field])
        for item, back in zip(sent, received)
        for field in item
        if not same(item[field], back[field])
    ]
