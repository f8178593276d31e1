"""Missions, fences and rally points with pymavlink, from one client and from two."""

import math
import random
import time

import pytest
from plans import ALL, EXCLUSION, FENCE, MISSION, NAV_WAYPOINT, PLANS, RALLY, RETURN_POINT, differences, plan
from pymavlink import mavutil
from transfer import (
    ACCEPTED,
    CANCELLED,
    DENIED,
    Upload,
    as_dict,
    ask_count,
    ask_item,
    clear,
    clear_all,
    download,
    ids,
    next_word,
    plan_id,
    send_item,
    upload,
    upload_part,
)

mavlink = mavutil.mavlink

KINDS = pytest.mark.parametrize("kind", PLANS, ids=["mission", "fence", "rally"])
UNKNOWN = 77


@pytest.fixture
def client(other):
    """The client that is already connected, for tests that need only one."""
    return other


@KINDS
def test_full_plan_of_each_kind(client, capacities, kind):
    """M-1, M-3, M-5, M-26: every field comes back. The plan's id is the same in all messages, and for the same content."""
    items = PLANS[kind](capacities[kind])
    ack = upload(client, items, kind)
    assert ack.type == ACCEPTED and plan_id(ack) != 0
    current = client.wait("MISSION_CURRENT")
    assert [plan_id(current, each) for each in PLANS] == [plan_id(ack) if each == kind else 0 for each in PLANS]
    back = download(client, kind)
    assert differences(items, back.items) == []
    assert back.id == plan_id(ack)
    assert clear(client, kind) == ACCEPTED
    assert ids(client) == [0, 0, 0]
    assert plan_id(upload(client, items, kind)) == back.id
    assert plan_id(upload(client, PLANS[kind](capacities[kind], 1), kind)) not in (0, back.id)


def test_kinds_of_plans_are_independent(client):
    """M-1, M-50"""
    plans = {kind: make(10) for kind, make in PLANS.items()}
    stored = [plan_id(upload(client, items, kind)) for kind, items in plans.items()]
    assert ids(client) == stored
    assert clear(client, FENCE) == ACCEPTED
    assert ids(client) == [stored[MISSION], 0, stored[RALLY]]
    assert differences(plans[RALLY], download(client, RALLY).items) == []
    clear_all(client)
    assert ids(client) == [0, 0, 0]


@KINDS
def test_one_item_too_many(client, capacities, kind):
    """M-21: the plan is refused before its first item."""
    stored = plan_id(upload(client, PLANS[kind](10), kind))
    client.mav.mission_count_send(1, 1, capacities[kind] + 1, kind)
    message = next_word(client, kind)
    assert message.get_type() == "MISSION_ACK" and message.type == mavlink.MAV_MISSION_NO_SPACE
    assert ids(client)[kind] == stored


# Commands without a position have plain numbers in x and y (M-75).
SPEED = dict(command=mavlink.MAV_CMD_DO_CHANGE_SPEED, param1=1.0, param2=5.0, param3=-1.0, x=0, y=0)
JUMP = dict(command=mavlink.MAV_CMD_DO_JUMP, param1=0.0, param2=1.0, x=0, y=0)
OUT_OF_RANGE = "parameter {} out of range"


# The fault of one item in an otherwise valid plan, the result code, and the reason in the text.
BAD_ITEMS = {
    MISSION: [
        (dict(command=mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT), "UNSUPPORTED", "command not supported"),
        (dict(command=RETURN_POINT), "UNSUPPORTED", "command not supported"),
        (dict(frame=mavlink.MAV_FRAME_LOCAL_NED), "UNSUPPORTED_FRAME", "frame not supported"),
        (SPEED | dict(param1=0.5), "INVALID_PARAM1", OUT_OF_RANGE.format(1)),
        (SPEED | dict(param2=math.nan), "INVALID_PARAM2", OUT_OF_RANGE.format(2)),
        (SPEED | dict(param3=-3.0), "INVALID_PARAM3", OUT_OF_RANGE.format(3)),
        (dict(param4=math.inf), "INVALID_PARAM4", OUT_OF_RANGE.format(4)),
        (dict(x=900_000_001), "INVALID_PARAM5_X", OUT_OF_RANGE.format(5)),
        (dict(y=-1_800_000_001), "INVALID_PARAM6_Y", OUT_OF_RANGE.format(6)),
        (dict(z=math.nan), "INVALID_PARAM7", OUT_OF_RANGE.format(7)),
        (JUMP | dict(param1=12.0), "INVALID_PARAM1", OUT_OF_RANGE.format(1)),
        (JUMP | dict(param2=-2.0), "INVALID_PARAM2", OUT_OF_RANGE.format(2)),
    ],
    FENCE: [
        (dict(command=NAV_WAYPOINT), "UNSUPPORTED", "command not supported"),
        (dict(frame=mavlink.MAV_FRAME_MISSION), "UNSUPPORTED_FRAME", "frame not supported"),
        (dict(param1=2.0), "INVALID_PARAM1", OUT_OF_RANGE.format(1)),
        (dict(param1=4.0), "INVALID_PARAM1", OUT_OF_RANGE.format(1)),
        (dict(param2=2.0), "INVALID_PARAM2", OUT_OF_RANGE.format(2)),
        (dict(y=2**31 - 1), "INVALID_PARAM6_Y", OUT_OF_RANGE.format(6)),
        # A polygon that another item interrupts.
        (dict(command=RETURN_POINT), "INVALID", "not consistent"),
        (dict(command=EXCLUSION), "INVALID", "not consistent"),
    ],
    RALLY: [
        (dict(command=NAV_WAYPOINT), "UNSUPPORTED", "command not supported"),
        (dict(frame=mavlink.MAV_FRAME_MISSION), "UNSUPPORTED_FRAME", "frame not supported"),
        (dict(x=2**31 - 1), "INVALID_PARAM5_X", OUT_OF_RANGE.format(5)),
        (dict(z=math.inf), "INVALID_PARAM7", OUT_OF_RANGE.format(7)),
    ],
}


@KINDS
def test_bad_item_is_refused_with_code_and_text(client, kind):
    """M-1, M-38: the old plan stays."""
    name = ("Mission", "Fence", "Rally")[kind]
    old = PLANS[kind](11)
    assert upload(client, old, kind).type == ACCEPTED
    for case, (fields, result, reason) in enumerate(BAD_ITEMS[kind]):
        # A different item each time, because a repeated text is not sent twice.
        seq = 1 + case % 4
        new = PLANS[kind](12, 1)
        new[seq] |= fields
        ack = upload(client, new, kind)
        assert mavlink.enums["MAV_MISSION_RESULT"][ack.type].name == f"MAV_MISSION_{result}", fields
        text = client.wait("STATUSTEXT")
        assert text and text.text == f"{name} item {seq}: {reason}", fields
        assert differences(old, download(client, kind).items) == [], fields


def test_unknown_kind_of_plan_is_refused(client):
    """M-25: the answer has the requested plan type, so that the client can match it."""
    for kind in (ALL, UNKNOWN):
        client.mav.mission_count_send(1, 1, 3, kind)
        assert next_word(client, kind).type == mavlink.MAV_MISSION_INVALID
        client.mav.mission_request_list_send(1, 1, kind)
        assert next_word(client, kind).type == mavlink.MAV_MISSION_INVALID
    assert clear(client, UNKNOWN) == mavlink.MAV_MISSION_INVALID


def test_partial_lists_are_refused(client):
    """M-68"""
    stored = plan_id(upload(client, plan(5)))
    client.mav.mission_write_partial_list_send(1, 1, 1, 2, MISSION)
    assert next_word(client, MISSION).type == mavlink.MAV_MISSION_UNSUPPORTED
    client.mav.mission_request_partial_list_send(1, 1, 1, 2, MISSION)
    assert next_word(client, MISSION).type == mavlink.MAV_MISSION_UNSUPPORTED
    assert ids(client)[MISSION] == stored


@KINDS
def test_request_beyond_the_end_is_refused(client, kind):
    """M-64: requests beyond the end of the plan are refused."""
    assert upload(client, PLANS[kind](10), kind).type == ACCEPTED
    assert ask_count(client, kind).count == 10
    assert ask_item(client, 9, kind).get_type() == "MISSION_ITEM_INT"
    for seq in (10, 65535):
        assert ask_item(client, seq, kind).type == mavlink.MAV_MISSION_INVALID_SEQUENCE


def test_unrequested_items_are_answered_once_a_second(client):
    """M-31, M-36"""
    for _ in range(5):
        send_item(client, plan(10)[3])
    assert next_word(client, MISSION).type == mavlink.MAV_MISSION_ERROR
    assert next_word(client, MISSION, 0.5) is None, "one answer a second is enough"


def send_float_item(gcs, item, kind=MISSION):
    item = dict(item, x=item["x"] / 1e7, y=item["y"] / 1e7)
    gcs.mav.mission_item_send(1, 1, *item.values(), kind)


def test_float_messages_are_supported(client):
    """M-37, M-61: MISSION_ITEM is accepted for MISSION_ITEM_INT, and MISSION_REQUEST for MISSION_REQUEST_INT."""
    items = plan(12)
    started = Upload(client, items, send=send_float_item)
    while (word := started.next()).get_type() == "MISSION_REQUEST_INT":
        started.send(word.seq)
    assert word.type == ACCEPTED
    back = download(client).items
    for item, received in zip(items, back):
        # The precision of degrees in a 32-bit float.
        for axis in ("x", "y"):
            assert abs(item[axis] - received[axis]) < 20
            received[axis] = item[axis]
    assert differences(items, back) == []
    client.mav.mission_request_send(1, 1, 3, MISSION)
    assert client.wait(["MISSION_ITEM", "MISSION_ITEM_INT"]).get_type() == "MISSION_ITEM"


def test_client_of_the_old_messages(client):
    """M-47, M-61: a client such as dronekit understands only MISSION_REQUEST and sends only MISSION_ITEM."""
    items = plan(6)
    client.mav.mission_count_send(1, 1, len(items), MISSION)
    while (word := client.wait(["MISSION_REQUEST", "MISSION_ACK"])).get_type() == "MISSION_REQUEST":
        send_float_item(client, items[word.seq])
    assert word.type == ACCEPTED
    client.mav.mission_request_list_send(1, 1, MISSION)
    assert client.wait("MISSION_COUNT").count == len(items)
    for seq, item in enumerate(items):
        client.mav.mission_request_send(1, 1, seq, MISSION)
        back = client.wait(["MISSION_ITEM", "MISSION_ITEM_INT"])
        assert (back.get_type(), back.seq, back.command) == ("MISSION_ITEM", seq, item["command"])


def test_duplicate_item_causes_no_request(client):
    """M-30: a duplicate item causes no second request, which would double the traffic."""
    items = plan(20)
    started, requests = Upload(client, items), []
    while (word := started.next()).get_type() == "MISSION_REQUEST_INT":
        requests.append(word.seq)
        started.send(word.seq)
        send_item(client, items[word.seq])
    assert word.type == ACCEPTED and requests == list(range(len(items)))
    assert differences(items, download(client).items) == []


def test_second_client_is_refused_until_the_first_is_done(gcs, other):
    """M-23, M-33, M-51: two clients with two ids, on two links."""
    old, first, second = plan(6), plan(30, 1), plan(8, 2)
    assert upload(gcs, old).type == ACCEPTED
    started = upload_part(gcs, first, 20)
    assert upload(other, second).type == DENIED
    assert upload(other, PLANS[FENCE](10), FENCE).type == DENIED
    assert clear(other) == DENIED
    assert clear(other, ALL) == DENIED
    send_item(other, first[20])
    assert next_word(other, MISSION).type == DENIED
    for seq in range(20, 30):
        assert started.next().seq == seq
        started.send(seq)
    assert started.next().type == ACCEPTED
    assert differences(first, download(other).items) == []
    assert upload(other, second).type == ACCEPTED
    assert differences(second, download(gcs).items) == []


def test_two_clients_download_at_once(gcs, other):
    """M-60: two clients download in different orders, different plans or the same one, and each receives the right items."""
    plans = {gcs: (MISSION, plan(40)), other: (FENCE, PLANS[FENCE](40))}
    for kind, items in plans.values():
        assert upload(gcs, items, kind).type == ACCEPTED
    orders = {client: random.Random(client.address[0]).sample(range(40), 40) for client in plans}
    for kinds in ((MISSION, FENCE), (MISSION, MISSION)):
        received = {client: {} for client in plans}
        for client, kind in zip(plans, kinds):
            assert ask_count(client, kind).count == 40
        for step in range(40):
            for client, kind in zip(plans, kinds):
                client.mav.mission_request_int_send(1, 1, orders[client][step], kind)
            for client, kind in zip(plans, kinds):
                item = client.wait("MISSION_ITEM_INT")
                assert (item.mission_type, item.target_system) == (kind, client.address[0])
                received[client][item.seq] = as_dict(item)
        for client, kind in zip(plans, kinds):
            expected = plans[gcs][1] if kind == MISSION else plans[other][1]
            assert differences(expected, [received[client][seq] for seq in range(40)]) == []


def test_old_plan_is_served_during_an_upload(gcs, other):
    """M-62"""
    old, new = plan(10), plan(15, 1)
    stored = plan_id(upload(gcs, old))
    started = upload_part(gcs, new, 14)
    back = download(other)
    assert back.id == stored and differences(old, back.items) == []
    assert started.next().seq == 14
    started.send(14)
    assert started.next().type == ACCEPTED
    assert differences(new, download(other).items) == []


@KINDS
@pytest.mark.parametrize("by", ["upload", "clear"])
def test_replaced_plan_cancels_a_download(gcs, other, kind, by):
    """M-63: the client gets OPERATION_CANCELLED, and never the items of two plans."""
    old, new = PLANS[kind](10), PLANS[kind](12, 1)
    assert upload(gcs, old, kind).type == ACCEPTED
    assert ask_count(other, kind).count == 10
    for seq in range(4):
        assert differences([old[seq]], [as_dict(ask_item(other, seq, kind))]) == []
    # An equal plan changes nothing.
    assert upload(gcs, old, kind).type == ACCEPTED
    assert differences([old[4]], [as_dict(ask_item(other, 4, kind))]) == []
    if by == "upload":
        assert upload(gcs, new, kind).type == ACCEPTED
    else:
        assert clear(gcs, kind) == ACCEPTED
    for seq in (5, 5, 0):
        assert ask_item(other, seq, kind).type == CANCELLED
    assert differences(new if by == "upload" else [], download(other, kind).items) == []


def test_client_can_cancel_an_upload(gcs, other):
    """M-35: the vehicle does not answer a cancellation, and another client may upload at once."""
    old, new = plan(10), plan(12, 1)
    assert upload(gcs, old).type == ACCEPTED
    started = upload_part(gcs, new, 5)
    assert started.next().seq == 5
    started.cancel(5)
    assert started.next(0.7) is None
    assert differences(old, download(gcs).items) == []
    assert upload(other, new).type == ACCEPTED


@pytest.mark.parametrize("sent", [0, 19])
def test_vanished_client_does_not_block_others(connect, other, sent, figure):
    """M-41: PX4/PX4-Autopilot#27132, for clients on the same link and on the other."""
    gcs = connect()
    old = plan(7)
    assert upload(gcs, old).type == ACCEPTED
    assert upload_part(gcs, plan(20, 1), sent).next().seq == sent
    died = time.monotonic()
    gcs.close()
    new = PLANS[FENCE](12, 2)
    while upload(other, new, FENCE).type == DENIED:
        assert time.monotonic() - died < 10, "no other client can upload"
        time.sleep(0.1)
    free = time.monotonic() - died
    assert differences(new, download(other, FENCE).items) == []
    successor = connect(system=253)
    assert differences(old, download(successor).items) == []
    assert upload(successor, plan(9, 3)).type == ACCEPTED
    assert time.monotonic() - died < 10, "no other client can upload"
    figure(f"a client that died after {sent} items: another one could upload {free:.1f} s later")


def test_next_client_after_a_vanished_one(connect):
    """M-41, for the next client on the same link and the same plan."""
    gcs = connect()
    assert upload_part(gcs, plan(20), 11).next().seq == 11
    died = time.monotonic()
    gcs.close()
    successor = connect(system=253)
    while upload(successor, plan(9, 3)).type == DENIED:
        assert time.monotonic() - died < 10, "no other client can upload"
        time.sleep(0.1)
    assert differences(plan(9, 3), download(successor).items) == []


def test_speed_of_a_long_plan(gcs, other, target, figure):
    """Measures the speed. The links are configured for 115,200 and 921,600 bit/s, which limits it."""
    items = plan(500 if target == "sitl" else 250)
    for name, client in (("telemetry", gcs), ("companion", other)):
        began = time.monotonic()
        assert upload(client, items).type == ACCEPTED
        uploaded = time.monotonic()
        assert differences(items, download(client).items) == []
        up, down = (len(items) / taken for taken in (uploaded - began, time.monotonic() - uploaded))
        figure(f"{len(items)} items over the {name} link: up {up:.0f} items/s, down {down:.0f} items/s")
        clear_all(client)


def test_positions_keep_every_digit(client):
    """M-3: extreme positions, and one that a float cannot represent."""
    corners = [(900_000_000, 1_800_000_000), (-900_000_000, -1_800_000_000), (1, -1), (0, 0), (899_999_999, 16_777_217)]
    items = [dict(item, x=x, y=y) for item, (x, y) in zip(PLANS[RALLY](len(corners)), corners)]
    assert upload(client, items, RALLY).type == ACCEPTED
    assert differences(items, download(client, RALLY).items) == []
