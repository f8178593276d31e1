#!/usr/bin/env python3
"""Generates common.bin and unknown.bin: frames that the reference implementation encodes, from our own definitions.

    python3 tests/golden/make_vectors.py

pymavlink's mavgen generates Python modules (protocol 2.0 and 1.0) from dialect/definitions/common.xml, with its schema
check. These modules encode every message of common with three payloads: all zeros; values drawn with a fixed seed,
including NaN, infinities and the extremes of integers; all bits set. For each message there is the trimmed v2 frame;
then, for ids up to 255, the v1 frame.

common.bin is these frames end to end, as on a wire: each frame contains its length. Messages are sorted by id, and
sequence numbers count up. Run this again after a change of the definitions; unchanged messages keep their bytes.

unknown.bin has one v2 frame of each message in the same form. Each field has the value of its `invalid` attribute, or
zero if there is none. The notations are parsed independently of our generator, as MAVLink describes them:
https://mavlink.io/en/guide/xml_schema.html.

It runs in its own virtual environment (target/golden), with pinned versions.
"""

import importlib.util
import os
import random
import struct
import subprocess
import sys
import tempfile
import venv

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
DEFINITIONS = os.path.join(ROOT, "dialect", "definitions", "common.xml")
OUTPUT = os.path.join(HERE, "common.bin")
UNKNOWN = os.path.join(HERE, "unknown.bin")
PINNED = ["pymavlink==2.4.50", "fastcrc==0.5.0", "lxml==6.1.3"]
SYSTEM, COMPONENT = 42, 17


def module(protocol, directory):
    """Returns the Python module that mavgen generates for a protocol version."""
    from pymavlink.generator import mavgen, mavparse

    wire = {"1.0": mavparse.PROTOCOL_1_0, "2.0": mavparse.PROTOCOL_2_0}[protocol]
    path = os.path.join(directory, f"common_v{protocol[0]}.py")
    options = mavgen.Opts(path, wire_protocol=wire, language="Python3", validate=True)
    if not mavgen.mavgen(options, [DEFINITIONS]):
        sys.exit("mavgen refuses the definitions")
    # The generated code reads the protocol from an environment variable.
    os.environ["MAVLINK20"] = "1" if protocol == "2.0" else ""
    spec = importlib.util.spec_from_file_location(f"common_v{protocol[0]}", path)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def integer(rng, code):
    bits = 8 * struct.calcsize("<" + code)
    low, high = (0, (1 << bits) - 1) if code.isupper() else (-(1 << bits - 1), (1 << bits - 1) - 1)
    return rng.choice([low, high, 0, 1, low + 1, high - 1, rng.randint(low, high), rng.randint(low, high)])


def real(rng, code):
    largest = 3.4028234663852886e38 if code == "f" else 1.7976931348623157e308
    least = 1.401298464324817e-45 if code == "f" else 5e-324
    special = [float("nan"), float("inf"), float("-inf"), -0.0, 0.0, largest, -largest, least]
    return rng.choice(special + [rng.uniform(-1e3, 1e3) for _ in special])


def element(rng, code):
    if code == "s":
        return bytes([rng.choice([0, 0xFF, rng.randrange(256), rng.randrange(32, 127)])])
    return real(rng, code) if code in "fd" else integer(rng, code)


def payloads(message):
    """Returns the three payloads, in wire order, untrimmed."""
    layout = message.unpacker
    yield bytes(layout.size)
    rng = random.Random(f"golden {message.msgname}")
    # Counts in the format: `4H` is four elements, `16s` a text of 16 bytes.
    codes, count = [], ""
    for char in layout.format.lstrip("<"):
        if char.isdigit():
            count += char
        else:
            codes += [char.replace("c", "s")] * int(count or 1)
            count = ""
    yield b"".join(struct.pack("<" + code, element(rng, code)) for code in codes)
    yield b"\xff" * layout.size


def frames(protocol, generated, message, sequence):
    """Returns a message's frames. The reference decodes the payloads and encodes the frames from the fields."""
    link = generated.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
    for payload in payloads(message):
        if protocol == "2.0":
            head = struct.pack("<BBBBBBHB", len(payload), 0, 0, 0, 0, 0, message.id & 0xFFFF, message.id >> 16)
            start = b"\xfd"
        else:
            head, start = struct.pack("<BBBBB", len(payload), 0, 0, 0, message.id), b"\xfe"
        checksum = generated.x25crc(head + payload)
        checksum.accumulate(struct.pack("B", message.crc_extra))
        decoded = link.decode(bytearray(start + head + payload + struct.pack("<H", checksum.crc)))
        link.seq = next(sequence) % 256
        yield decoded.pack(link)


def constant(text, entries):
    """Returns a single value of the attribute `invalid`."""
    limits = {f"UINT{bits}_MAX": (1 << bits) - 1 for bits in (8, 16, 32, 64)}
    limits |= {f"INT{bits}_MAX": (1 << bits - 1) - 1 for bits in (8, 16, 32, 64)}
    if text in limits or text in entries:
        return limits.get(text, entries.get(text))
    return float(text) if text.lower() == "nan" or "." in text else int(text, 0)


def invalid(field, entries):
    """Returns the elements of an unknown field; zero if the definition has no such value."""
    count, text = field.array_length or 1, field.invalid
    if not text:
        values = []
    elif not text.startswith("["):
        values = [constant(text, entries)] * count
    elif text.endswith(":]"):
        values = [constant(text[1:-2], entries)]
    elif "," in text:
        values = [constant(part, entries) if part else 0 for part in text[1:-1].split(",")]
    else:
        values = [constant(text[1:-1], entries)] * count
    return (values + [0] * count)[:count]


def unknown(field, entries):
    """Returns the same in the form that the generated code needs."""
    values = invalid(field, entries)
    if field.type == "char":
        return bytes(values)
    values = [float(value) for value in values] if field.type in ("float", "double") else values
    return values if field.array_length else values[0]


def unknown_frames(generated):
    """Yields a frame of each message, with every field unknown."""
    from pymavlink.generator import mavparse

    directory = os.path.dirname(DEFINITIONS)
    files = [os.path.join(directory, name) for name in ("minimal.xml", "standard.xml", "common.xml")]
    parsed = [mavparse.MAVXML(path, mavparse.PROTOCOL_2_0) for path in files]
    entries = {entry.name: int(entry.value) for xml in parsed for enum in xml.enum for entry in enum.entry}
    link = generated.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
    for message in sorted((message for xml in parsed for message in xml.message), key=lambda message: message.id):
        fields = {field.name: unknown(field, entries) for field in message.fields}
        made = generated.mavlink_map[message.id]
        yield made(**{name: fields[name] for name in made.fieldnames}).pack(link)
        link.seq = (link.seq + 1) % 256


def main():
    sequence = iter(range(1 << 32))
    with tempfile.TemporaryDirectory() as directory:
        v2, v1 = module("2.0", directory), module("1.0", directory)
        out = bytearray()
        for number, message in sorted(v2.mavlink_map.items()):
            if number < 0:
                continue
            for frame in frames("2.0", v2, message, sequence):
                out += frame
            if number <= 255:
                for frame in frames("1.0", v1, v1.mavlink_map[number], sequence):
                    out += frame
    with open(OUTPUT, "wb") as file:
        file.write(out)
    print(f"{OUTPUT}: {next(sequence)} frames, {len(out)} bytes")
    out = b"".join(unknown_frames(v2))
    with open(UNKNOWN, "wb") as file:
        file.write(out)
    print(f"{UNKNOWN}: {len(out)} bytes")


def enter_environment(script):
    """Runs a script again, with the pinned packages."""
    directory = os.path.join(os.environ.get("CARGO_TARGET_DIR", os.path.join(ROOT, "target")), "golden")
    python = os.path.join(directory, "Scripts" if os.name == "nt" else "bin", "python")
    if not os.path.exists(python):
        venv.create(directory, with_pip=True)
    subprocess.run([python, "-m", "pip", "install", "--quiet", *PINNED], check=True)
    sys.exit(subprocess.run([python, script, "--inside"]).returncode)


if __name__ == "__main__":
    main() if sys.argv[1:] == ["--inside"] else enter_environment(os.path.abspath(__file__))
