"""The flight that `cargo xtask pictures` draws: MAVSDK uploads plans, flies the mission, is stopped by the fence, and returns.

    python flight.py tcpout://127.0.0.1:5760
"""

import math
import sys
import time

from conftest import found_by_mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw
from mavsdk.plugins.telemetry import Telemetry
from mavsdk.plugins.telemetry.telemetry import FlightMode
from plans import (
    CIRCLE_EXCLUSION,
    EXCLUSION,
    FENCE,
    GLOBAL,
    GLOBAL_RELATIVE_ALT,
    INCLUSION,
    MISSION,
    NAV_TAKEOFF,
    NAV_WAYPOINT,
    RALLY,
    RALLY_POINT,
)

# Latitude and longitude in degrees, altitude in m.
HOME = (47.397742, 8.545594, 488.0)
# m of latitude in a degree.
DEGREE = 111_319.5

# East and north of home, in m.
BORDER = [(-35, -26), (110, -36), (222, -26), (238, 36), (200, 100), (60, 91), (-30, 58)]
TREE = (112, 46)
TREE_RADIUS = 15
BUILDING = [(150, 26), (176, 30), (172, 52), (146, 48)]
RALLY_PLACE = (208, 56)
OUTSIDE = (152, 118)

# East, north, height.
ROUTE = [
    (0, 0, 12),
    (20, -13, 15),
    (195, -14, 15),
    (208, 10, 22),
    (60, 10, 22),
    (0, 30, 30),
    (40, 70, 30),
    (120, 74, 18),
]


def place(east, north):
    """Degrees."""
    return HOME[0] + north / DEGREE, HOME[1] + east / DEGREE / math.cos(math.radians(HOME[0]))


def item(kind, seq, command, at, height=0.0, frame=GLOBAL, param1=0.0, param4=0.0):
    latitude, longitude = place(*at)
    return MissionItem(
        seq=seq,
        frame=frame,
        command=command,
        current=int(kind == MISSION and seq == 0),
        autocontinue=1,
        param1=float(param1),
        param2=0.0,
        param3=0.0,
        param4=param4,
        x=round(latitude * 1e7),
        y=round(longitude * 1e7),
        z=float(height),
        mission_type=kind,
    )


def mission():
    return [
        item(
            MISSION,
            seq,
            NAV_WAYPOINT if seq else NAV_TAKEOFF,
            (east, north),
            height,
            GLOBAL_RELATIVE_ALT,
            param4=math.nan,
        )
        for seq, (east, north, height) in enumerate(ROUTE)
    ]


def fence():
    corners = [(INCLUSION, at, len(BORDER)) for at in BORDER]
    corners += [(EXCLUSION, at, len(BUILDING)) for at in BUILDING]
    corners += [(CIRCLE_EXCLUSION, TREE, TREE_RADIUS)]
    return [item(FENCE, seq, command, at, param1=size) for seq, (command, at, size) in enumerate(corners)]


def until(condition, timeout, what):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f"not within {timeout} s: {what}"
        time.sleep(0.05)


def fly(system):
    telemetry, action, missions = Telemetry(system), Action(system), MissionRaw(system)
    until(telemetry.health_all_ok, 30, "the vehicle is healthy")
    telemetry.set_rate_position(10.0)
    missions.upload_geofence(fence())
    missions.upload_rally_points([item(RALLY, 0, RALLY_POINT, RALLY_PLACE, 15, GLOBAL_RELATIVE_ALT)])
    missions.upload_mission(mission())
    print("Uploaded the mission, the fence and a rally point", flush=True)

    action.arm()
    missions.start_mission()
    until(lambda: telemetry.flight_mode() == FlightMode.MISSION, 10, "it flies the mission")
    until(lambda: telemetry.flight_mode() == FlightMode.HOLD, 240, "it has flown the mission")
    print("Flew the mission", flush=True)
    time.sleep(4)

    action.goto_location(*place(*OUTSIDE), HOME[2] + 18, math.nan)
    now = telemetry.position_velocity_ned
    until(lambda: now().position.north_m > 84, 60, "it flies towards the fence")
    until(lambda: math.hypot(now().velocity.north_m_s, now().velocity.east_m_s) < 0.05, 30, "it stops there")
    print(f"Stopped {now().position.north_m:.0f} m north of home, at the fence", flush=True)
    time.sleep(4)

    action.return_to_launch()
    until(lambda: not telemetry.armed(), 120, "it lands")
    print("Landed at the rally point", flush=True)
    # Where it stands.
    time.sleep(1)


if __name__ == "__main__":
    with found_by_mavsdk(sys.argv[1]) as vehicle:
        fly(vehicle)
