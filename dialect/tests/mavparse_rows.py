#!/usr/bin/env python3
"""Prints the wire format that pymavlink's parser computes for MAVLink definitions, in the format of definitions/wire.csv.

    mavparse_rows.py DIRECTORY...

Each XML file in the first directory is a dialect. Its includes are searched in all directories. By default, the definitions
in the pymavlink package are read.
"""

import contextlib
import csv
import io
import os
import sys

import pymavlink
from pymavlink.generator import mavparse

HEADER = "dialect,id,name,crc_extra,min_len,max_len,target_system_offset,target_component_offset,wire_order"


def find(name, directories):
    for directory in directories:
        path = os.path.join(directory, name)
        if os.path.isfile(path):
            return os.path.realpath(path)
    sys.exit(f"{name}: in none of {directories}")


def messages(path, directories):
    """The messages of a file and of all that it includes."""
    seen, todo, found = set(), [path], []
    while todo:
        path = todo.pop()
        if path not in seen:
            seen.add(path)
            # The parser prints remarks on enumerations.
            with contextlib.redirect_stdout(io.StringIO()):
                xml = mavparse.MAVXML(path, mavparse.PROTOCOL_2_0)
            found += xml.message
            todo += [find(name, [os.path.dirname(path), *directories]) for name in xml.include]
    return sorted(found, key=lambda message: message.id)


def row(dialect, message):
    order = message.ordered_fieldnames
    offset = {name: message.field_offsets[name] for name in order}
    return [
        dialect,
        message.id,
        message.name,
        message.crc_extra,
        message.wire_min_length,
        message.wire_length,
        offset.get("target_system", ""),
        offset.get("target_component", ""),
        " ".join(order),
    ]


def main():
    packaged = os.path.join(os.path.dirname(pymavlink.__file__), "dialects", "v20")
    directories = sys.argv[1:] or [packaged]
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(HEADER.split(","))
    names = {name for directory in directories[:1] for name in os.listdir(directory) if name.endswith(".xml")}
    for name in sorted(names, key=lambda name: name[: -len(".xml")]):
        for message in messages(find(name, directories), directories):
            out.writerow(row(name[: -len(".xml")], message))


if __name__ == "__main__":
    main()
