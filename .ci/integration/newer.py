"""Adds messages that pymavlink's definitions of common lack."""

import struct

from pymavlink import mavutil
from pymavlink.dialects.v20 import development

mavlink = mavutil.mavlink


class CommandCancel(mavlink.MAVLink_message):
    """COMMAND_CANCEL. The definitions mark it as work in progress, so pymavlink's dialects leave it out."""

    id = 80
    msgname = "COMMAND_CANCEL"
    fieldnames = ["target_system", "target_component", "command"]
    ordered_fieldnames = ["command", "target_system", "target_component"]
    fieldtypes = ["uint8_t", "uint8_t", "uint16_t"]
    native_format = bytearray(b"<HBB")
    orders = [1, 2, 0]
    lengths = [1, 1, 1]
    array_lengths = [0, 0, 0]
    crc_extra = 14
    unpacker = struct.Struct("<HBB")

    def __init__(self, target_system, target_component, command):
        super().__init__(self.id, self.msgname)
        self._fieldnames = self.fieldnames
        self.target_system = target_system
        self.target_component = target_component
        self.command = command

    def pack(self, mav, force_mavlink1=False):
        payload = self.unpacker.pack(self.command, self.target_system, self.target_component)
        return self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)


class ControlStatus(mavlink.MAVLink_message):
    """CONTROL_STATUS of development.xml, which pymavlink's dialect of that name leaves out too."""

    id = 512
    msgname = "CONTROL_STATUS"
    fieldnames = ["flags", "gcs_main", "gcs_secondary"]
    ordered_fieldnames = fieldnames
    fieldtypes = ["uint8_t", "uint8_t", "uint8_t"]
    native_format = bytearray(b"<BBB")
    orders = [0, 1, 2]
    lengths = [1, 1, 10]
    array_lengths = [0, 0, 10]
    crc_extra = 21
    unpacker = struct.Struct("<BB10B")

    def __init__(self, flags, gcs_main, gcs_secondary):
        super().__init__(self.id, self.msgname)
        self._fieldnames = self.fieldnames
        self.flags = flags
        self.gcs_main = gcs_main
        self.gcs_secondary = gcs_secondary


AVAILABLE_MODES = development.MAVLINK_MSG_ID_AVAILABLE_MODES
CURRENT_MODE = development.MAVLINK_MSG_ID_CURRENT_MODE
AVAILABLE_MODES_MONITOR = development.MAVLINK_MSG_ID_AVAILABLE_MODES_MONITOR

for message in [
    development.MAVLink_available_modes_message,
    development.MAVLink_current_mode_message,
    development.MAVLink_available_modes_monitor_message,
    CommandCancel,
    ControlStatus,
]:
    mavlink.mavlink_map.setdefault(message.id, message)
