"""Plan transfers, message by message, as a ground station performs them."""

import time
from collections import namedtuple

from plans import ALL, FENCE, FIELDS, MISSION, RALLY
from pymavlink import mavutil

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_MISSION_ACCEPTED
CANCELLED = mavlink.MAV_MISSION_OPERATION_CANCELLED
DENIED = mavlink.MAV_MISSION_DENIED

# The offsets of plan ids in the payload. pymavlink's definitions do not have these fields yet.
IDS = {"MISSION_COUNT": 5, "MISSION_ACK": 4, "MISSION_CURRENT": 6}

# The vehicle repeats a request after this time, at the earliest (s), less a pass of the vehicle's loop.
REPEAT = 0.24

# If a request is still repeated this long after its answer, the answer has been lost (s).
LOST = 2.0

# A downloaded plan.
Plan = namedtuple("Plan", "id items")


def plan_id(message, kind=MISSION):
    """Returns the id of a plan in a message: `opaque_id`, or in MISSION_CURRENT the id of the plan of this kind."""
    frame = bytes(message.get_msgbuf())
    payload = frame[10 : 10 + frame[1]].ljust(255, b"\0")
    at = IDS[message.get_type()] + (4 * kind if message.get_type() == "MISSION_CURRENT" else 0)
    return int.from_bytes(payload[at : at + 4], "little")


def send_item(gcs, item, kind=MISSION):
    gcs.mav.mission_item_int_send(1, 1, *(item[field] for field in FIELDS), kind)


def next_word(gcs, kind, timeout=3.0):
    """Returns the vehicle's next message to this client about an upload, or None."""
    kinds = ["MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK"]
    message = gcs.wait(kinds, timeout, lambda word: (word.target_system, word.target_component) == gcs.address)
    if message:
        assert message.mission_type == kind
        assert message.get_type() != "MISSION_REQUEST", "a GENERIC autopilot asks for MISSION_ITEM_INT"
    return message


class Upload:
    """An upload, message by message.

    On a busy machine this program may answer so late that the vehicle has repeated its request. `next` then skips the repetition
    of the request that was answered last, but only if the vehicle can have waited for the answer: it sent that request after the
    previous answer. An earlier repetition is returned.
    """

    def __init__(self, gcs, items, kind=MISSION, send=send_item):
        self.gcs, self.items, self.kind, self.send_item = gcs, items, kind, send
        self.answered = None
        self.answered_at = time.monotonic()
        gcs.mav.mission_count_send(1, 1, len(items), kind)

    def send(self, seq):
        """Answers the request for an item with the item."""
        self._answer(seq)
        self.send_item(self.gcs, self.items[seq], self.kind)

    def cancel(self, seq):
        """Answers the request for an item by cancelling the upload."""
        self._answer(seq)
        self.gcs.mav.mission_ack_send(1, 1, CANCELLED, self.kind)

    def _answer(self, seq):
        self.answered = seq
        # The earliest moment of the request.
        self.requested_at, self.answered_at = self.answered_at, time.monotonic()

    def next(self, timeout=3.0):
        """Returns the vehicle's next message about the upload, or None."""
        while True:
            word = next_word(self.gcs, self.kind, timeout)
            if not word or word.get_type() != "MISSION_REQUEST_INT" or word.seq != self.answered:
                return word
            if not self.requested_at + REPEAT <= time.monotonic() <= self.answered_at + LOST:
                return word
            self.requested_at += REPEAT


def upload(gcs, items, kind=MISSION, timeout=3.0):
    """Uploads a plan and returns the acknowledgement."""
    started = Upload(gcs, items, kind)
    while True:
        message = started.next(timeout)
        assert message, "the vehicle stopped asking"
        if message.get_type() == "MISSION_ACK":
            return message
        started.send(message.seq)


def upload_part(gcs, items, count, kind=MISSION):
    """Starts an upload and sends the first `count` items. Returns the upload."""
    started = Upload(gcs, items, kind)
    for seq in range(count):
        request = started.next()
        assert request and request.get_type() == "MISSION_REQUEST_INT" and request.seq == seq, request
        started.send(seq)
    return started


def ask_count(gcs, kind=MISSION, timeout=3.0):
    """Requests the length of a plan. Returns the MISSION_COUNT, or None."""
    gcs.mav.mission_request_list_send(1, 1, kind)
    return gcs.wait("MISSION_COUNT", timeout, lambda count: count.mission_type == kind)


def ask_item(gcs, seq, kind=MISSION):
    """Requests an item. Returns it, or the MISSION_ACK that is sent instead."""
    gcs.mav.mission_request_int_send(1, 1, seq, kind)
    message = gcs.wait(["MISSION_ITEM_INT", "MISSION_ACK"], where=lambda message: message.mission_type == kind)
    assert message, f"no answer to the request for item {seq}"
    assert (message.target_system, message.target_component) == gcs.address
    return message


def as_dict(item):
    return {field: getattr(item, field) for field in FIELDS}


def download(gcs, kind=MISSION):
    """Downloads a plan. Returns it with its id."""
    count = ask_count(gcs, kind)
    assert count, "no answer to MISSION_REQUEST_LIST"
    assert (count.target_system, count.target_component) == gcs.address
    items = []
    for seq in range(count.count):
        item = ask_item(gcs, seq, kind)
        assert item.get_type() == "MISSION_ITEM_INT" and item.seq == seq, item
        items.append(as_dict(item))
    gcs.mav.mission_ack_send(1, 1, ACCEPTED, kind)
    return Plan(plan_id(count), items)


def ids(gcs):
    """Returns the ids of the three plans, 0 for an empty one."""
    found = []
    for kind in (MISSION, FENCE, RALLY):
        found.append(plan_id(ask_count(gcs, kind)))
        # Ends the download.
        gcs.mav.mission_ack_send(1, 1, ACCEPTED, kind)
    return found


def clear(gcs, kind=MISSION):
    """Clears one plan or all. Returns the type of the acknowledgement."""
    gcs.mav.mission_clear_all_send(1, 1, kind)
    ack = gcs.wait("MISSION_ACK")
    assert ack and ack.mission_type == kind
    assert (ack.target_system, ack.target_component) == gcs.address
    return ack.type


def clear_all(gcs):
    assert clear(gcs, ALL) == ACCEPTED
