"""Adds messages that pymavlink's definitions of common lack. They leave out what was work in progress at their time."""

import struct

from pymavlink import mavutil
from pymavlink.dialects.v20 import development

mavlink = mavutil.mavlink


def declare(number, name, crc_extra, **fields):
    """Returns the class of a message. Each field is its format in `struct`, in the order on the wire; `40B` is an array."""
    lengths = [int(form[:-1] or 1) for form in fields.values()]

    class Declared(mavlink.MAVLink_message):
        id = number
        msgname = name
        fieldnames = ordered_fieldnames = list(fields)
        fieldtypes = [{"B": "uint8_t", "H": "uint16_t", "I": "uint32_t"}[form[-1]] for form in fields.values()]
        native_format = bytearray("<" + "".join(form[-1] for form in fields.values()), "ascii")
        orders = list(range(len(fields)))
        array_lengths = [length if length > 1 else 0 for length in lengths]
        unpacker = struct.Struct("<" + "".join(fields.values()))

        def __init__(self, *values):
            super().__init__(self.id, self.msgname)
            self._fieldnames = self.fieldnames
            for field, value in zip(fields, values):
                setattr(self, field, value)

        def pack(self, mav, force_mavlink1=False):
            payload = self.unpacker.pack(*(getattr(self, field) for field in fields))
            return self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)

    Declared.lengths, Declared.crc_extra = lengths, crc_extra
    return Declared


# Of development.xml; pymavlink's dialect of that name leaves it out too.
ControlStatus = declare(512, "CONTROL_STATUS", 21, flags="B", gcs_main="B", gcs_secondary="10B")
# Work in progress.
CommandCancel = declare(80, "COMMAND_CANCEL", 14, command="H", target_system="B", target_component="B")
# No longer work in progress, but newer than pymavlink's definitions.
Event = declare(
    410,
    "EVENT",
    160,
    event="I",
    event_time_boot_ms="I",
    sequence="H",
    destination_component="B",
    destination_system="B",
    log_levels="B",
    arguments="40B",
)
CurrentEventSequence = declare(411, "CURRENT_EVENT_SEQUENCE", 106, sequence="H", flags="B")
RequestEvent = declare(
    412, "REQUEST_EVENT", 33, first_sequence="H", last_sequence="H", target_system="B", target_component="B"
)
ResponseEventError = declare(
    413,
    "RESPONSE_EVENT_ERROR",
    77,
    sequence="H",
    sequence_oldest_available="H",
    target_system="B",
    target_component="B",
    reason="B",
)

AVAILABLE_MODES = development.MAVLINK_MSG_ID_AVAILABLE_MODES
CURRENT_MODE = development.MAVLINK_MSG_ID_CURRENT_MODE
AVAILABLE_MODES_MONITOR = development.MAVLINK_MSG_ID_AVAILABLE_MODES_MONITOR

for message in [
    development.MAVLink_available_modes_message,
    development.MAVLink_current_mode_message,
    development.MAVLink_available_modes_monitor_message,
    CommandCancel,
    ControlStatus,
    Event,
    CurrentEventSequence,
    RequestEvent,
    ResponseEventError,
]:
    mavlink.mavlink_map.setdefault(message.id, message)
