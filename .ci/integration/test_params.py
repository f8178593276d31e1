"""Parameters with pymavlink, MAVSDK and MAVProxy."""

import binascii
import struct
import time
from collections import namedtuple

import pytest
from mavsdk.plugins.param import Param
from mavsdk.plugins.param.param import ParamError, ParamResult
from power import InQemu, InSitl
from pymavlink import mavutil
from test_mavproxy import MavProxy

mavlink = mavutil.mavlink

# The encoding of each type in the float's four bytes.
CODES = {
    mavlink.MAV_PARAM_TYPE_UINT8: "B",
    mavlink.MAV_PARAM_TYPE_INT8: "b",
    mavlink.MAV_PARAM_TYPE_UINT16: "H",
    mavlink.MAV_PARAM_TYPE_INT16: "h",
    mavlink.MAV_PARAM_TYPE_UINT32: "I",
    mavlink.MAV_PARAM_TYPE_INT32: "i",
    mavlink.MAV_PARAM_TYPE_REAL32: "f",
}
UINT8, INT8, UINT16, INT16, UINT32, INT32, REAL32 = CODES

DOES_NOT_EXIST = mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST
OUT_OF_RANGE = mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
PERMISSION_DENIED = mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED
READ_ONLY = mavlink.MAV_PARAM_ERROR_READ_ONLY
# pymavlink does not have this one yet: MAV_PARAM_ERROR_TYPE_MISMATCH.
TYPE_MISMATCH = 7

# A received value.
Value = namedtuple("Value", "name index count type value")
# The parameters that the tests change, with the values that they restore.
DEFAULTS = {
    "MIS_TAKEOFF_ALT": (REAL32, 10.0),
    "MPC_YAW_MODE": (INT32, 0),
    "SIM_BAT_START": (INT32, 100),
    "SIH_LOC_LAT0": (INT32, 473_977_420),
    "COM_FLT_TIME_MAX": (INT32, 0),
    "MAV_HL_LOSS_T": (INT32, 0),
    "SIM_GEOID_SEP": (INT32, 47),
    "SIM_GPS_FIX_TIME": (INT32, 2000),
    "SIM_GPS_SATS": (INT32, 14),
    "MPC_XY_CRUISE": (REAL32, 8.0),
    "COM_LOW_BAT_ACT": (INT32, 0),
}

# Volatile parameters, which the hash does not cover.
VOLATILE = ("SIM_HANG", "STAT_HL_BYTES", "STAT_HL_CREDITS")


def to_float(kind, value):
    return struct.unpack("<f", struct.pack("<" + CODES[kind], value).ljust(4, b"\0"))[0]


def param_value(message):
    """Decodes a PARAM_VALUE. Takes the value from the frame, because a Python float does not preserve the bits of a NaN."""
    frame = bytes(message.get_msgbuf())
    raw = frame[10 : 10 + frame[1]].ljust(25, b"\0")[:4]
    (value,) = struct.unpack_from("<" + CODES[message.param_type], raw)
    return Value(message.param_id, message.param_index, message.param_count, message.param_type, value)


def next_answer(gcs, name=None, timeout=3.0):
    """Returns the next PARAM_VALUE (of this name), or the index, name and reason of the next PARAM_ERROR, or None."""
    message = gcs.wait(["PARAM_VALUE", "PARAM_ERROR"], timeout, lambda message: name in (None, message.param_id))
    if message and message.get_type() == "PARAM_ERROR":
        assert (message.target_system, message.target_component) == gcs.address
        return message.param_index, message.param_id, message.error
    return message and param_value(message)


def read(gcs, name="", index=-1):
    gcs.mav.param_request_read_send(1, 1, name.encode(), index)
    return next_answer(gcs, name or None)


def write(gcs, name, kind, value):
    gcs.mav.param_set_send(1, 1, name.encode(), to_float(kind, value), kind)
    return next_answer(gcs, name)


def collect(gcs, until, timeout=10.0):
    """Returns the values received until `until` holds, by index."""
    values = {}
    deadline = time.monotonic() + timeout
    while (left := deadline - time.monotonic()) > 0 and not until(values):
        if message := gcs.hear("PARAM_VALUE", left):
            value = param_value(message)
            values[value.index] = value
    return values


def fetch(gcs):
    """Returns the whole list."""
    gcs.mav.param_request_list_send(1, 1)
    values = collect(gcs, lambda values: values and len(values) == next(iter(values.values())).count)
    return [value for _, value in sorted(values.items())]


@pytest.fixture
def client(gcs):
    yield gcs
    for name, (kind, value) in DEFAULTS.items():
        back = write(gcs, name, kind, value)
        assert back.value == value


def test_list_is_complete(client, figure):
    """P-10, P-11: each parameter is listed once, in the order of names, with the same count."""
    began = time.monotonic()
    values = fetch(client)
    figure(f"{len(values)} parameters in {time.monotonic() - began:.2f} s")
    assert len(values) >= 30
    assert [value.index for value in values] == list(range(len(values)))
    assert {value.count for value in values} == {len(values)}
    names = [value.name for value in values]
    assert names == sorted(set(names))
    # P-19: every client can read and set these two types.
    assert {value.type for value in values} == {INT32, REAL32}
    by_name = {value.name: value for value in values}
    for name, (kind, default) in DEFAULTS.items():
        assert (by_name[name].type, by_name[name].value) == (kind, default)


def test_missing_values_are_sent_during_the_list(client):
    """P-12: values that are requested by index are sent between those of the list."""
    count = len(fetch(client))
    client.mav.param_request_list_send(1, 1)
    collect(client, lambda values: len(values) >= 5)
    for index in (0, 3, 1):
        client.mav.param_request_read_send(1, 1, b"", index)
    rest = collect(client, lambda values: {0, 1, 3, count - 1} <= set(values))
    assert {0, 1, 3, count - 1} <= set(rest)


def test_read_by_name_and_by_index(client):
    value = read(client, "MPC_XY_CRUISE")
    assert (value.type, value.value) == (REAL32, 8.0)
    assert read(client, index=value.index) == value
    # The index takes precedence over the name.
    client.mav.param_request_read_send(1, 1, b"NAV_ACC_RAD", value.index)
    assert next_answer(client) == value
    assert read(client, "NO_SUCH_NAME") == (-1, "NO_SUCH_NAME", DOES_NOT_EXIST)
    index, _, error = read(client, index=value.count)
    assert (index, error) == (value.count, DOES_NOT_EXIST)


@pytest.mark.parametrize(
    "name, kind, value",
    [
        ("MIS_TAKEOFF_ALT", REAL32, 12.5),
        ("SIH_LOC_LAT0", INT32, -123_456_789),
        ("COM_FLT_TIME_MAX", INT32, 86_399),
        ("SIM_GEOID_SEP", INT32, -33),
        ("SIM_GPS_FIX_TIME", INT32, 1999),
        ("MAV_HL_LOSS_T", INT32, 3599),
        ("MPC_YAW_MODE", INT32, 1),
        ("SIM_BAT_START", INT32, 99),
        ("SIM_GPS_SATS", INT32, 40),
    ],
)
def test_set(client, other, name, kind, value):
    """P-2, P-14, P-16: the new value is sent to the client that set it, and to all others."""
    answer = write(client, name, kind, value)
    assert (answer.type, answer.value) == (kind, value)
    told = other.wait("PARAM_VALUE", where=lambda message: message.param_id == name)
    assert param_value(told) == answer == read(client, name)


@pytest.mark.parametrize("kind", [UINT8, INT8, UINT16, INT16, UINT32, INT32])
@pytest.mark.parametrize("name", ["SIM_GPS_SATS", "SIM_GEOID_SEP", "COM_LOW_BAT_ACT"])
def test_integer_of_another_type_is_accepted(client, name, kind):
    """P-14: a client may know the parameter with another autopilot's type. The answer has the parameter's own type."""
    own, default = DEFAULTS[name]
    value = 2 if name == "COM_LOW_BAT_ACT" else 20
    answer = write(client, name, kind, value)
    assert (answer.type, answer.value) == (own, value) and read(client, name) == answer
    assert write(client, name, own, default).value == default


def test_invalid_values_are_refused(client):
    """P-14: a PARAM_ERROR gives the reason, and the value stays unchanged."""
    for name, kind, value, error in [
        ("MPC_XY_CRUISE", REAL32, 99.0, OUT_OF_RANGE),
        ("MPC_XY_CRUISE", REAL32, float("nan"), OUT_OF_RANGE),
        ("COM_LOW_BAT_ACT", INT32, 3, OUT_OF_RANGE),
        ("COM_LOW_BAT_ACT", REAL32, 1.5, OUT_OF_RANGE),
        ("COM_LOW_BAT_ACT", REAL32, float("nan"), OUT_OF_RANGE),
        ("MPC_XY_CRUISE", INT32, 8, TYPE_MISMATCH),
        ("STAT_FLIGHTS", INT32, 5, READ_ONLY),
        ("NO_SUCH_NAME", REAL32, 1.0, DOES_NOT_EXIST),
    ]:
        client.drain()
        client.mav.param_set_send(1, 1, name.encode(), to_float(kind, value), kind)
        answers = [next_answer(client), next_answer(client, timeout=0.5)]
        errors = [answer for answer in answers if answer and not isinstance(answer, Value)]
        assert [(found[1], found[2]) for found in errors] == [(name, error)], (name, answers)
    assert read(client, "MPC_XY_CRUISE").value == 8.0
    assert read(client, "COM_LOW_BAT_ACT").value == 0


def test_hash_matches_the_list(client):
    """P-20: the hash covers names and values in the order of the list. It follows each change of a value. Volatile parameters are
    not included."""

    def expected():
        crc = 0
        for value in fetch(client):
            if value.name not in VOLATILE:
                crc = crc32(value.name.encode() + struct.pack("<" + CODES[value.type], value.value), crc)
        return crc

    first = read(client, "_HASH_CHECK")
    assert (first.type, first.value) == (UINT32, expected())
    write(client, "MPC_XY_CRUISE", REAL32, 7.5)
    second = read(client, "_HASH_CHECK").value
    assert second == expected() != first.value
    write(client, "MPC_XY_CRUISE", REAL32, 8.0)
    assert read(client, "_HASH_CHECK").value == first.value


def crc32(data, crc):
    """Returns the CRC-32 with an initial value of 0 and without the final complement."""
    return binascii.crc32(data, crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF


def test_parameter_changes_the_flight(client):
    """MIS_TAKEOFF_ALT sets the altitude if the take-off command does not."""
    write(client, "MIS_TAKEOFF_ALT", REAL32, 4.0)
    deadline = time.monotonic() + 10
    while client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) != mavlink.MAV_RESULT_ACCEPTED:
        assert time.monotonic() < deadline, "it does not arm"
        time.sleep(0.5)
    # An armed vehicle refuses a change of its system id.
    assert write(client, "MAV_SYS_ID", INT32, 2) == (-1, "MAV_SYS_ID", PERMISSION_DENIED)
    nan = float("nan")
    assert client.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, nan) == mavlink.MAV_RESULT_ACCEPTED
    heights = []
    end = time.monotonic() + 6
    while time.monotonic() < end:
        if message := client.wait("GLOBAL_POSITION_INT", 1):
            heights.append(message.relative_alt / 1000)
    assert 3.4 < heights[-1] < 4.6, heights


def test_parameters_survive_a_power_cut(target, other, request, tmp_path):
    """P-17: parameters survive a power cut a while after they were set."""
    option = request.config.getoption
    if target == "qemu":
        vehicle = InQemu(option("qmp_port"), other)
    else:
        vehicle = InSitl(option("program"), option("spare_port_base"), tmp_path / "plans.bin")
    set_to = {"MPC_XY_CRUISE": (REAL32, 6.25), "COM_LOW_BAT_ACT": (INT32, 2), "SIM_GEOID_SEP": (INT32, -7)}
    try:
        gcs = vehicle.gcs
        for name, (kind, value) in set_to.items():
            assert write_and_read(gcs, name, kind, value) == value
        assert gcs.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1, -1) == mavlink.MAV_RESULT_ACCEPTED
        # The save starts at once, but takes several steps.
        time.sleep(1)
        for _ in range(2):
            vehicle.cut()
            gcs = vehicle.gcs
            for name, (_, value) in set_to.items():
                assert read(gcs, name).value == value
        for name in set_to:
            kind, value = DEFAULTS[name]
            assert write_and_read(gcs, name, kind, value) == value
        # Without a command, the change is stored later.
        time.sleep(13)
        vehicle.cut()
        assert read(vehicle.gcs, "MPC_XY_CRUISE").value == 8.0
    finally:
        vehicle.end()


def test_system_id_is_a_parameter(target, request, tmp_path):
    if target != "sitl":
        pytest.skip("the vehicle that all tests use keeps its id")
    option = request.config.getoption
    vehicle = InSitl(option("program"), option("spare_port_base"), tmp_path / "plans.bin")
    try:
        assert write_and_read(vehicle.gcs, "MAV_SYS_ID", INT32, 77) == 77
        assert vehicle.gcs.wait("HEARTBEAT").get_srcSystem() == 1
        assert vehicle.gcs.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1, -1) == mavlink.MAV_RESULT_ACCEPTED
        time.sleep(1)
        vehicle.cut()
        assert vehicle.gcs.wait("HEARTBEAT").get_srcSystem() == 77
        vehicle.gcs.mav.param_request_read_send(77, 1, b"MAV_SYS_ID", -1)
        assert next_answer(vehicle.gcs, "MAV_SYS_ID").value == 77
    finally:
        vehicle.end()


def write_and_read(gcs, name, kind, value):
    write(gcs, name, kind, value)
    return read(gcs, name).value


def result_of(action, *arguments):
    with pytest.raises(ParamError) as refusal:
        action(*arguments)
    return refusal.value.result


def test_mavsdk(system, other):
    params = Param(system)
    everything = params.get_all_params()
    floats = {param.name: param.value for param in everything.float_params}
    ints = {param.name: param.value for param in everything.int_params}
    # MAVSDK does not return unsigned parameters.
    values = [value for value in fetch(other) if value.type in (INT8, INT16, INT32, REAL32)]
    assert {**floats, **ints} == {value.name: value.value for value in values}
    assert (floats["MPC_XY_CRUISE"], ints["SIH_LOC_LAT0"], ints["SIM_GEOID_SEP"]) == (8.0, 473_977_420, 47)
    params.set_param_float("MPC_XY_CRUISE", 6.5)
    params.set_param_int("SIH_LOC_LAT0", -473_977_421)
    assert params.get_param_float("MPC_XY_CRUISE") == 6.5
    assert params.get_param_int("SIH_LOC_LAT0") == -473_977_421
    assert read(other, "MPC_XY_CRUISE").value == 6.5
    assert read(other, "SIH_LOC_LAT0").value == -473_977_421
    assert result_of(params.set_param_float, "MPC_XY_CRUISE", 99.0) == ParamResult.VALUE_OUT_OF_RANGE
    assert result_of(params.get_param_float, "NO_SUCH_NAME") == ParamResult.DOES_NOT_EXIST
    assert result_of(params.get_param_int, "MPC_XY_CRUISE") == ParamResult.WRONG_TYPE
    params.set_param_float("MPC_XY_CRUISE", 8.0)
    params.set_param_int("SIH_LOC_LAT0", 473_977_420)
    # P-19: every integer parameter that it lists.
    for name in ("COM_LOW_BAT_ACT", "SIM_GPS_SATS", "SIM_GEOID_SEP"):
        default = ints[name]
        for value in (default + 1, default):
            params.set_param_int(name, value)
            assert params.get_param_int(name) == value
            said = (name, value)
            assert other.wait("PARAM_VALUE", where=lambda told: (told.param_id, param_value(told).value) == said)


def test_mavproxy(port, other, tmp_path):
    """MAVProxy shows floats only: it decodes integers bytewise only for PX4. It sets both, as REAL32 (P-19)."""
    mavproxy = MavProxy(port, tmp_path, "param,ftp")
    try:
        mavproxy.expect("Detected vehicle 1:1")
        count = read(other, "MAV_SYS_ID").count
        mavproxy.say("param fetch")
        mavproxy.expect(f"Received {count} parameters")
        mavproxy.say("param show MPC_XY_CRUISE")
        mavproxy.expect("MPC_XY_CRUISE    8")
        other.drain()
        mavproxy.say("param set MPC_XY_CRUISE 5.5")
        told = other.wait("PARAM_VALUE", 10, lambda message: message.param_id == "MPC_XY_CRUISE")
        assert told and told.param_value == 5.5
        # The other client may have the answer before MAVProxy has it.
        mavproxy.ask_until("param show MPC_XY_CRUISE", "MPC_XY_CRUISE    5.5")
        for prelude, value in ((None, 1), ("param ftp", 2)):
            if prelude:
                mavproxy.say(prelude)
                mavproxy.expect(f"Received {count} parameters (ftp)", timeout=60)
            other.drain()
            mavproxy.say(f"param set COM_LOW_BAT_ACT {value}")
            told = other.wait("PARAM_VALUE", 10, lambda message: message.param_id == "COM_LOW_BAT_ACT")
            assert told and param_value(told)[3:] == (INT32, value)
        mavproxy.say("param ftp")
        mavproxy.expect(f"Received {count} parameters (ftp)", timeout=60)
        mavproxy.ask_until("param show COM_LOW_BAT_ACT", "COM_LOW_BAT_ACT  2")
    finally:
        mavproxy.end()
        write(other, "MPC_XY_CRUISE", REAL32, 8.0)
        write(other, "COM_LOW_BAT_ACT", INT32, 0)
