"""Plans for the tests. Every field of every item has a distinct value."""

import math
import struct

MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255

GLOBAL, GLOBAL_RELATIVE_ALT = 0, 3
NAV_WAYPOINT, NAV_LAND, NAV_TAKEOFF, DO_CHANGE_SPEED = 16, 21, 22, 178
RETURN_POINT, INCLUSION, EXCLUSION, CIRCLE_INCLUSION, CIRCLE_EXCLUSION = range(5000, 5005)
RALLY_POINT = 5100

FIELDS = ("seq", "frame", "command", "current", "autocontinue", "param1", "param2", "param3", "param4", "x", "y", "z")

# The demo vehicle's home position (deg * 1e7).
HOME = (473977420, 85455940)


def single(value):
    """Rounds the value to single precision."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


def plan(count, variant=0):
    """Returns `count` items: a take-off, waypoints that differ in every field, and a change of speed every 10 items. Variants have
    no item in common."""
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
            param3=single(seq * 0.1 + variant) if seq else 0.0,
            # NaN ("the vehicle decides") and a number.
            param4=math.nan if seq % 2 else single(seq % 360),
            x=HOME[0] + 1000 * seq + 1 + variant,
            y=HOME[1] - 777 * seq - 3,
            z=single(20 + seq / 7),
        )
        if seq == 0:
            item.update(command=NAV_TAKEOFF)
        elif seq % 10 == 5:
            item.update(command=DO_CHANGE_SPEED, param1=1.0, param2=single(3 + seq % 5), param3=-1.0)
            item.update(param4=single(variant), x=0, y=0, z=0.0)
        items.append(item)
    return items


def place(command, seq, variant=0, **fields):
    """Returns a fence vertex or a rally point."""
    item = dict(
        seq=seq,
        frame=GLOBAL_RELATIVE_ALT if seq % 2 else GLOBAL,
        command=command,
        current=0,
        autocontinue=1,
        param1=0.0,
        param2=0.0,
        param3=single(seq / 9),
        param4=single(seq * 0.7),
        x=HOME[0] + 100 * seq + variant,
        y=HOME[1] + 100 * seq,
        z=single(seq / 3 + variant),
    )
    return item | fields


def fence(count, variant=0):
    """Returns `count` items, at least 10: both kinds of polygons, a return point, circles."""
    items = []

    def polygon(command, size, corners, group):
        for north, east in corners:
            at = dict(x=HOME[0] + north * size + variant, y=HOME[1] + east * size)
            items.append(
                place(command, len(items), variant, param1=float(len(corners)), param2=float(group), **at)
            )

    polygon(INCLUSION, 90_000, [(-1, -1), (-1, 1), (1, 2), (2, 0), (1, -1)], 1)
    items.append(place(RETURN_POINT, len(items), variant))
    polygon(EXCLUSION, 700, [(20, 20), (20, 21), (21, 20)], 0)
    while len(items) < count:
        seq = len(items)
        command, group = (CIRCLE_INCLUSION, 2.0) if seq % 3 == 0 else (CIRCLE_EXCLUSION, 0.0)
        items.append(place(command, seq, variant, param1=single(5 + seq / 7), param2=group))
    return items[:count]


def rally(count, variant=0):
    """Returns `count` rally points."""
    return [place(RALLY_POINT, seq, variant, param1=single(seq * 1.5)) for seq in range(count)]


PLANS = {MISSION: plan, FENCE: fence, RALLY: rally}


def same(a, b):
    """Compares two values; NaN equals NaN."""
    return a == b or (isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b))


def differences(sent, received):
    """Returns the fields that differ, as (seq, field, sent, received)."""
    if len(sent) != len(received):
        return [("count", len(sent), len(received))]
    return [
        (item["seq"], field, item[field], back[field])
        for item, back in zip(sent, received)
        for field in item
        if not same(item[field], back[field])
    ]
