"""Sends the same random frames to the vehicle and to MAVSDK's mission_raw_server and param_server, and compares the answers frame
by frame. Each known difference is listed here, with the reason for our behaviour. An unlisted difference fails (M-20, M-22, M-30,
M-31, M-35, M-36, M-50, M-60, M-62 to M-64, P-13, P-14)."""

import collections
import math
import random
import socket
import struct
import time

import pytest
from conftest import Gcs
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mission_raw_server import MissionRawServer
from mavsdk.plugins.param_server import ParamServer
from plans import FIELDS, MISSION, plan
from power import InSitl
from pymavlink import mavutil
from transfer import REPEAT

mavlink = mavutil.mavlink
INT32, REAL32 = mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_REAL32
# Values of MAV_PARAM_ERROR.
OUT_OF_RANGE, TYPE_MISMATCH = 2, 7

CONVERSATIONS = 60

# The number of items in the plan that both have at the start of a conversation.
ITEMS = 3

# The messages and fields that are compared. A parameter's count and index are not, because MAVSDK has only two types of parameters.
FIELDS_OF = {
    "MISSION_ACK": ("type", "mission_type"),
    "MISSION_REQUEST_INT": ("seq", "mission_type"),
    "MISSION_COUNT": ("count", "mission_type"),
    "MISSION_ITEM_INT": FIELDS,
    "PARAM_VALUE": ("param_id", "param_type", "param_value"),
    "PARAM_ERROR": ("param_id", "param_index", "error"),
}

# The next frame is sent when both gave the same answers and were then quiet for QUIET (s). If their answers differ, the wait is
# SLOW (s), because their timing differs.
QUIET, SLOW = 0.02, 0.8

Step = collections.namedtuple("Step", "name arguments")
# `is_over`: the conversation ends here, because the two states have diverged.
Difference = collections.namedtuple("Difference", "name reason applies is_over", defaults=[False])


def answer(message):
    fields = (getattr(message, field) for field in FIELDS_OF[message.get_type()])
    # Floats are compared by their bits: NaN is a value, and integers are encoded in floats.
    return (message.get_type(), *(struct.pack("<f", field) if isinstance(field, float) else field for field in fields))


def hear(sides, is_silence_likely=False, is_late=False):
    """Returns the answers of each side until both are quiet. Retransmissions do not count, because their timing differs."""
    heard, last = [[] for _ in sides], time.monotonic()

    def patience():
        if is_late:
            return 4 * SLOW
        return QUIET if all(words == heard[0] and (words or is_silence_likely) for words in heard) else SLOW

    while time.monotonic() - last < patience():
        for gcs, words in zip(sides, heard):
            message = gcs.wait(list(FIELDS_OF), QUIET / 4)
            if message and answer(message) not in words:
                last = time.monotonic()
                words.append(answer(message))
    return heard


def send(gcs, step):
    getattr(gcs.mav, f"{step.name}_send")(1, 1, *step.arguments)


class Mavsdks:
    """MAVSDK as an autopilot with a plan server and a parameter server."""

    def __init__(self, parameters=()):
        self.mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.AUTOPILOT))
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        assert self.mavsdk.add_any_connection(f"tcpin://127.0.0.1:{port}").name == "SUCCESS"
        component = self.mavsdk.server_component()
        self.missions, self.params = MissionRawServer(component), ParamServer(component)
        for name, (kind, value) in dict(parameters).items():
            provide = self.params.provide_param_int if kind == INT32 else self.params.provide_param_float
            provide(name, value)
        self.gcs = Gcs(port)
        self.gcs.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    def end(self):
        self.gcs.close()
        self.mavsdk.destroy()


class Pair:
    """The vehicle and MAVSDK."""

    def __init__(self, ours, parameters=()):
        self.ours, self.parameters, self.theirs = ours, parameters, Mavsdks(parameters)
        # When the last step was sent, and the last request of each.
        self.said_at, self.requests = 0.0, [None, None]

    def renew(self):
        """Replaces MAVSDK, so that its deferred answers are never sent."""
        self.theirs.end()
        self.theirs = Mavsdks(self.parameters)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.theirs.end()

    def say(self, step, is_known=lambda ours, theirs: False):
        """Sends a step to both, and returns their answers. If these differ, but not in a known way, one of them may only be late on a busy
        machine."""
        sides, said_at = [self.ours, self.theirs.gcs], time.monotonic()
        for gcs in sides:
            send(gcs, step)
        heard = self.without_repetitions(hear(sides, is_silence_likely=step.name == "mission_ack"), is_known)
        if heard[0] != heard[1] and not is_known(*heard):
            for words, late in zip(heard, hear(sides, is_late=True)):
                words.extend(word for word in late if word not in words)
            heard = self.without_repetitions(heard, is_known)
        self.said_at = said_at
        for side, words in enumerate(heard):
            requests = [word for word in words if word[0] == "MISSION_REQUEST_INT"]
            self.requests[side] = (requests or [self.requests[side]])[-1]
        return heard

    def without_repetitions(self, heard, is_known):
        """Returns the answers without requests that were repeated before the step was sent, because this program did not run for a moment.
        They are left out only if there is no difference then."""
        if heard[0] == heard[1] or is_known(*heard) or time.monotonic() < self.said_at + REPEAT:
            return heard
        rest = [[word for word in words if word != request] for words, request in zip(heard, self.requests)]
        return rest if rest[0] == rest[1] else heard

    def compare(self, steps, differences, note):
        """Sends all steps to both, up to the first difference. Returns that difference, and the steps with our answers."""
        said = []
        for step in steps:

            def why(ours, theirs):
                return [difference for difference in differences if difference.applies(said, step, ours, theirs)]

            ours, theirs = self.say(step, why)
            if ours != theirs:
                assert why(ours, theirs), f"after {said}\n{step}\n  ours {ours}\ntheirs {theirs}"
                difference = why(ours, theirs)[0]
                note[difference.name] += 1
                return difference, [*said, (step, ours)]
            said.append((step, ours))
        note["the same"] += 1
        return None, said


# ---- plans


def item(seq, variant=0):
    fields = plan(seq + 1, variant)[seq]
    return Step("mission_item_int", (*(fields[field] for field in FIELDS), MISSION))


def count(number):
    return Step("mission_count", (number, MISSION))


def request(seq):
    return Step("mission_request_int", (seq, MISSION))


def ack(result):
    return Step("mission_ack", (result, MISSION))


LIST, CLEAR = Step("mission_request_list", (MISSION,)), Step("mission_clear_all", (MISSION,))
CANCEL = ack(mavlink.MAV_MISSION_OPERATION_CANCELLED)
DOWNLOAD = [LIST, *map(request, range(ITEMS)), ack(mavlink.MAV_MISSION_ACCEPTED)]


def upload(items, variant=0):
    return [count(items), *(item(seq, variant) for seq in range(items))]


def about_plans(rng):
    """Returns a transfer in which steps are left out, repeated, reordered or added at random."""
    number = rng.randrange(1, 6)
    steps = list(rng.choice([upload(number, rng.randrange(1, 1000)), DOWNLOAD, [CLEAR, *DOWNLOAD[:1], DOWNLOAD[-1]]]))
    for _ in range(rng.choice([0, 0, 1, 1, 2])):
        at, change, seq = rng.randrange(len(steps)), rng.randrange(4), rng.randrange(6)
        if change == 0:
            steps.insert(at, steps[at])
        elif change == 1 and len(steps) > 1:
            steps.pop(at)
        elif change == 2:
            steps.insert(at, steps.pop(rng.randrange(len(steps))))
        else:
            steps.insert(at, rng.choice([item(seq), request(seq), ack(0), ack(1), CANCEL, LIST, CLEAR, count(seq)]))
    return steps


# ---- known differences for plans


def transfer(said):
    """Returns MAVSDK's open transfer: "upload", "download" or None."""
    state = None
    for step, answers in said:
        is_answered = any(kind == "MISSION_ACK" for kind, *_ in answers)
        if is_answered or (step.name == "mission_ack" and state == "download"):
            state = None
        elif state is None and answers:
            state = {"mission_count": "upload", "mission_request_list": "download"}.get(step.name)
    return state


def is_item_outside(said, step, ours, theirs):
    return step.name == "mission_item_int" and transfer(said) != "upload" and ours and not theirs


def is_request_outside(said, step, ours, theirs):
    return step.name == "mission_request_int" and ours and not theirs


def is_replaced(said, step, ours, theirs):
    before = [step.name for step, _ in said]
    is_cleared = "mission_request_list" in before and "mission_clear_all" in before
    return is_cleared and step.name == "mission_request_int"


def is_out_of_order(said, step, ours, theirs):
    return step.name == "mission_item_int" and transfer(said) == "upload" and not ours and theirs[0][0] == "MISSION_REQUEST_INT"


def is_counted_again(said, step, ours, theirs):
    return step.name == "mission_item_int" and [said.name for said, _ in said].count("mission_count") > 1


def is_ended(said, step, ours, theirs):
    return step.name == "mission_item_int" and any(step.name in ("mission_ack", "mission_clear_all") for step, _ in said)


def is_waiting(said, step, ours, theirs):
    return transfer(said) and step.name != "mission_item_int"


ABOUT_PLANS = [
    Difference(
        "item outside an upload",
        "MAVSDK does not answer; we answer ERROR, or repeat the result of the upload for a client that missed it",
        is_item_outside,
    ),
    Difference(
        "item requested out of turn",
        "MAVSDK answers only the request that it expects; we keep no state of downloads and send any item at any time. Beyond the "
        "end we answer INVALID_SEQUENCE, so that a client does not wait for its own timeout (M-60, M-64)",
        is_request_outside,
    ),
    Difference(
        "cleared during a download",
        "MAVSDK continues with a copy; we have no copy and answer OPERATION_CANCELLED, because a cleared plan must not pass for "
        "the current one (M-63)",
        is_replaced,
        is_over=True,
    ),
    Difference(
        "another item than the requested one",
        "MAVSDK requests the item again at once; we limit the rate, so that duplicate items do not double the traffic (M-30)",
        is_out_of_order,
        is_over=True,
    ),
    Difference(
        "another COUNT",
        "MAVSDK continues the running upload; for us another number of items starts another upload (M-22)",
        is_counted_again,
        is_over=True,
    ),
    Difference(
        "ended by its client",
        "MAVSDK keeps requesting items after a MISSION_ACK or MISSION_CLEAR_ALL from the client; for us the upload has ended",
        is_ended,
        is_over=True,
    ),
    Difference(
        "request during a transfer",
        "MAVSDK defers requests during a transfer until it ends or times out, and may repeat its own request; we answer from the "
        "live plan (M-62)",
        is_waiting,
        is_over=True,
    ),
]


@pytest.fixture
def ours(target, request, tmp_path):
    """A separate vehicle, because the test changes its parameters."""
    if target == "qemu":
        pytest.skip("the same code as in sitl, and slower")
    vehicle = InSitl(request.config.getoption("program"), request.config.getoption("spare_port_base"), tmp_path / "plans.bin")
    yield vehicle.gcs
    vehicle.end()


@pytest.mark.parametrize("seed", range(2))
def test_plans_are_exchanged_as_with_the_mavsdk_server(ours, seed, figure):
    rng, note = random.Random(seed), collections.Counter()
    with Pair(ours) as pair:
        for _ in range(CONVERSATIONS):
            for step in upload(ITEMS):
                mine, other = pair.say(step)
                assert mine == other, (step, mine, other)
            difference, said = pair.compare(about_plans(rng), ABOUT_PLANS, note)
            # An abandoned upload would stay open for seconds.
            if (difference and difference.is_over) or transfer(said) == "upload":
                pair.renew()
            # Whatever they answer.
            pair.say(CANCEL, lambda *_: True)
    assert note["the same"] >= CONVERSATIONS // 4, note
    figure(f"MAVSDK's mission_raw_server and ours, {CONVERSATIONS} conversations: {dict(note)}")


# ---- parameters


def to_float(kind, value):
    return struct.unpack("<f", struct.pack("<i" if kind == INT32 else "<f", value))[0]


def parameters(gcs):
    """Returns the parameters whose types MAVSDK supports, with their types and values."""
    gcs.mav.param_request_list_send(1, 1)
    found = {}
    while message := gcs.wait("PARAM_VALUE", 1.0):
        # Skip parameters that end a flight after a second, change the system id at the next start, or let the vehicle hang.
        is_left = message.param_id.startswith(("STAT_", "COM_FLT_TIME_MAX", "MAV_SYS_ID", "SIM_HANG"))
        if message.param_type in (INT32, REAL32) and not is_left:
            code = "<i" if message.param_type == INT32 else "<f"
            (value,) = struct.unpack_from(code, bytes(message.get_msgbuf())[10:14])
            found[message.param_id] = (message.param_type, value)
    return found


def about_parameters(rng, known):
    """Returns requests and changes, of existing and unknown parameters."""

    def name():
        return rng.choice([*known] * 4 + ["NO_SUCH_NAME", ""])

    def change(name):
        kind = rng.choice([known.get(name, (INT32,))[0]] * 4 + [INT32, REAL32])
        values = {INT32: [0, 1, 2, 3, -1, 100_000], REAL32: [0.0, 1.25, -1.0, 1e6, math.nan, math.inf]}[kind]
        if known.get(name, (None,))[0] == kind:
            values += 5 * [known[name][1]]
        value = rng.choice(values)
        return Step("param_set", (name.encode(), to_float(kind, value), kind))

    def question(name):
        return Step("param_request_read", (name.encode(), -1))

    return [rng.choice([change, question])(name()) for _ in range(rng.randrange(1, 5))]


def errors(words):
    return [word[3] for word in words if word[0] == "PARAM_ERROR"]


def is_refused(said, step, ours, theirs):
    # The error comes with the unchanged value.
    return errors(ours) == [OUT_OF_RANGE] and "PARAM_VALUE" in [word[0] for word in ours] and step.name == "param_set"


def is_wrong_type(said, step, ours, theirs):
    return errors(ours) == errors(theirs) == [TYPE_MISMATCH]


def is_whole_float(said, step, ours, theirs):
    return errors(theirs) == [TYPE_MISMATCH] and not errors(ours) and step.arguments[2] == REAL32


def is_nameless(said, step, ours, theirs):
    return step.arguments[0] == b"" and ours and not theirs


ABOUT_PARAMETERS = [
    Difference(
        "a value refused",
        "MAVSDK's parameters have no ranges and accept NaN; ours stay unchanged and report the error (P-14)",
        is_refused,
        is_over=True,
    ),
    Difference(
        "another type",
        "both refuse; we also send the value, for clients that do not know PARAM_ERROR (P-14), and the index -1, because the "
        "request was by name",
        is_wrong_type,
    ),
    Difference(
        "a whole float for an integer",
        "MAVSDK refuses it; we take it, because MAVProxy sends nothing else after `param ftp` (P-19)",
        is_whole_float,
        is_over=True,
    ),
    Difference("no name", "MAVSDK does not answer; we answer that the parameter does not exist (P-13)", is_nameless),
]


@pytest.mark.parametrize("seed", range(2))
def test_parameters_are_exchanged_as_with_the_mavsdk_server(ours, seed, figure):
    rng, note = random.Random(seed), collections.Counter()
    known = parameters(ours)
    with Pair(ours, known) as pair:
        for _ in range(CONVERSATIONS):
            difference, said = pair.compare(about_parameters(rng, known), ABOUT_PARAMETERS, note)
            if difference and difference.is_over:
                # Restores our value in MAVSDK, which accepted the change.
                name, _, _ = said[-1][0].arguments
                send(ours, Step("param_request_read", (name, -1)))
                _, _, kind, bits = answer(ours.wait("PARAM_VALUE"))
                send(pair.theirs.gcs, Step("param_set", (name, struct.unpack("<f", bits)[0], kind)))
                hear([pair.theirs.gcs])
    assert note["the same"] >= CONVERSATIONS // 4, note
    figure(f"MAVSDK's param_server and ours, {CONVERSATIONS} conversations: {dict(note)}")
