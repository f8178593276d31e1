"""QGroundControl's connection sequence: the same requests in the same order, with the same timeouts and numbers of retries
(its InitialConnectStateMachine, MavCommandQueue, RequestMessageCoordinator, StandardModes,
RequestMetaDataTypeStateMachine, ParameterManager and PlanManager)."""

import time
from collections import Counter, namedtuple

import newer
from plans import FENCE, MISSION, RALLY
from pymavlink import mavutil
from transfer import as_dict

mavlink = mavutil.mavlink

# s
ACK_TIMEOUT = 1.2
MESSAGE_TIMEOUT = 1.0
PARAM_LIST_TIMEOUT = 5.0
PARAM_SILENCE = 3.0
PLAN_TIMEOUT = 1.5
ITEM_TIMEOUT = 0.25

MESSAGE_TRIES = 3
# A failed request for AUTOPILOT_VERSION is repeated once.
VERSION_TRIES = 2
PARAM_LIST_TRIES = 5
# Requests for missing parameters: the number in flight, and the tries for each.
PARAM_BATCH = 10
PARAM_TRIES = 5
PLAN_RETRIES = 6

COMPONENT_METADATA, COMPONENT_INFORMATION = 397, 395

# A step of the connection: whether the vehicle answered, the number of retries, the duration (s).
Step = namedtuple("Step", "name is_answered retries duration")


class NoAnswer(Exception):
    """No try was answered."""


class Line:
    """A client's link, without losses."""

    def __init__(self, gcs):
        self.gcs = gcs

    def receive(self, timeout):
        return self.gcs.link.recv_match(blocking=True, timeout=timeout)

    def send(self, message):
        self.gcs.mav.send(message)


class BadLine(Line):
    """Loses every fifth received message of each kind, and every fourth sent one."""

    def __init__(self, gcs):
        super().__init__(gcs)
        self.received, self.sent = Counter(), Counter()

    def receive(self, timeout):
        message = super().receive(timeout)
        if not message or message.get_type() == "HEARTBEAT":
            return message
        self.received[message.get_type()] += 1
        return None if self.received[message.get_type()] % 5 == 0 else message

    def send(self, message):
        self.sent[message.get_type()] += 1
        if self.sent[message.get_type()] % 4:
            super().send(message)


class Qgc:
    """QGroundControl without a window."""

    def __init__(self, gcs, line=Line):
        self.address = gcs.address
        self.line = line(gcs)
        self.steps = []
        self.retries = 0
        self.beat = 0.0
        self.system = self.version = None
        self.modes = []
        self.parameters, self.parameter_count = {}, None
        self.plans = {}

    @property
    def is_ready(self):
        """Whether the connection is complete."""
        return [step.name for step in self.steps[-3:]] == ["fence", "rally points", "ready"]

    def connect(self):
        """Runs all steps from the first heartbeat to "ready". A step without an answer is recorded as failed."""
        self.system = self.next(["HEARTBEAT"], 3, lambda beat: beat.get_srcComponent() == 1).get_srcSystem()
        self.step("version", self.request_version)
        self.step("modes", self.request_modes)
        self.step("metadata", self.request_metadata)
        self.step("parameters", self.load_parameters)
        for _ in range(2):
            self.send(mavlink.MAVLink_system_time_message(time.time_ns() // 1000, 0))
        self.step("mission", self.load_plan, MISSION)
        for name, kind, capability in [
            ("fence", FENCE, mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE),
            ("rally points", RALLY, mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY),
        ]:
            if self.version and self.version.capabilities & capability:
                self.step(name, self.load_plan, kind)
        self.steps.append(Step("ready", True, 0, 0.0))

    def step(self, name, action, *arguments):
        retries, began = self.retries, time.monotonic()
        try:
            action(*arguments)
            is_answered = True
        except NoAnswer:
            is_answered = False
        self.steps.append(Step(name, is_answered, self.retries - retries, time.monotonic() - began))

    def send(self, message):
        self.line.send(message)

    def next(self, kinds, timeout, where=lambda message: True):
        """Returns the next matching message of these kinds, or None. Sends heartbeats in the meantime."""
        deadline = time.monotonic() + timeout
        while True:
            now = time.monotonic()
            if now - self.beat >= 1:
                self.beat = now
                self.send(mavlink.MAVLink_heartbeat_message(6, 8, 192, 0, 4, 3))
            message = self.line.receive(max(min(deadline - now, 0.1), 0.001))
            if message and message.get_type() in kinds and where(message):
                return message
            if time.monotonic() >= deadline:
                return None

    def command(self, command, *params):
        """Sends a command and returns its result. No retries: QGroundControl retries only requests for messages."""
        params = [*params, *[0.0] * (7 - len(params))]
        self.send(mavlink.MAVLink_command_long_message(self.system, 1, command, 0, *params))
        ack = self.next(["COMMAND_ACK"], ACK_TIMEOUT, lambda ack: ack.command == command)
        if not ack:
            raise NoAnswer
        assert (ack.target_system, ack.target_component) == self.address
        return ack.result

    def request_message(self, number, index=0):
        """Requests a message and returns it, or None if the request is refused. The message may precede the COMMAND_ACK."""
        kind = mavlink.mavlink_map[number].msgname if number in mavlink.mavlink_map else f"UNKNOWN_{number}"
        for confirmation in range(MESSAGE_TRIES):
            self.retries += confirmation > 0
            command = mavlink.MAV_CMD_REQUEST_MESSAGE
            params = [float(number), float(index), 0, 0, 0, 0, 0]
            self.send(mavlink.MAVLink_command_long_message(self.system, 1, command, confirmation, *params))
            found = None
            deadline = time.monotonic() + ACK_TIMEOUT
            while (left := deadline - time.monotonic()) > 0:
                message = self.next(["COMMAND_ACK", kind], left)
                if message and message.get_type() == kind:
                    found = message
                elif message and message.command == command:
                    if message.result != mavlink.MAV_RESULT_ACCEPTED:
                        return None
                    found = found or self.next([kind], MESSAGE_TIMEOUT)
                    if not found:
                        raise NoAnswer
                    return found
        raise NoAnswer

    def request_version(self):
        for attempt in range(VERSION_TRIES):
            try:
                self.version = self.request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
                return
            except NoAnswer:
                self.retries += 1
                if attempt + 1 == VERSION_TRIES:
                    raise

    def request_modes(self):
        """Requests the modes one by one, as many as the vehicle reports."""
        self.modes = []
        while not self.modes or self.modes[-1].mode_index < self.modes[-1].number_modes:
            mode = self.request_message(newer.AVAILABLE_MODES, len(self.modes) + 1)
            if not mode:
                return
            self.modes.append(mode)

    def request_metadata(self):
        """Requests COMPONENT_METADATA and, if that is refused, the older COMPONENT_INFORMATION."""
        if not self.request_message(COMPONENT_METADATA):
            self.request_message(COMPONENT_INFORMATION)

    def load_parameters(self):
        """Requests the list. After a silence, requests the missing parameters by index."""
        self.parameters, missing, tries, asked = {}, {}, Counter(), set()

        def take(message):
            asked.discard(message.param_index)
            missing.pop(message.param_index, None)
            self.parameters[message.param_id] = message
            self.parameter_count = message.param_count

        def ask():
            for index in [index for index in missing if index not in asked][: PARAM_BATCH - len(asked)]:
                tries[index] += 1
                if tries[index] > PARAM_TRIES:
                    raise NoAnswer
                asked.add(index)
                self.retries += 1
                self.send(mavlink.MAVLink_param_request_read_message(self.system, 1, b"", index))

        def is_listed(message):
            return message.param_index != 0xFFFF

        for attempt in range(PARAM_LIST_TRIES):
            self.retries += attempt > 0
            self.send(mavlink.MAVLink_param_request_list_message(self.system, 0))
            first = self.next(["PARAM_VALUE"], PARAM_LIST_TIMEOUT, is_listed)
            if first:
                break
        else:
            raise NoAnswer
        missing.update(dict.fromkeys(range(first.param_count)))
        take(first)
        is_batched = False
        while missing:
            message = self.next(["PARAM_VALUE"], PARAM_SILENCE)
            if message:
                take(message)
            else:
                is_batched = True
                asked.clear()
            if is_batched:
                ask()

    def load_plan(self, kind):
        items = self.plans[kind] = []

        def ask(request, answer, timeout, where):
            for attempt in range(1 + PLAN_RETRIES):
                self.retries += attempt > 0
                self.send(request)
                fits = lambda word: word.mission_type == kind and (word.get_type() != answer or where(word))
                word = self.next([answer, "MISSION_ACK"], timeout, fits)
                if word:
                    assert word.get_type() == answer, f"instead of {answer}: {word}"
                    return word
            raise NoAnswer

        request = mavlink.MAVLink_mission_request_list_message(self.system, 1, kind)
        count = ask(request, "MISSION_COUNT", PLAN_TIMEOUT, lambda count: True).count
        for seq in range(count):
            request = mavlink.MAVLink_mission_request_int_message(self.system, 1, seq, kind)
            items.append(as_dict(ask(request, "MISSION_ITEM_INT", ITEM_TIMEOUT, lambda item: item.seq == seq)))
        self.send(mavlink.MAVLink_mission_ack_message(self.system, 1, mavlink.MAV_MISSION_ACCEPTED, kind))
