#!/usr/bin/env python3
"""Generates signed.txt: frames that the reference implementation signs, from our own definitions.

    python3 tests/golden/make_signed.py

One line per frame: key, link id, timestamp and frame, in hexadecimal except the numbers. Runs in the environment of
make_vectors.py, with the same pinned versions.
"""

import hashlib
import os
import random
import sys
import tempfile

import make_vectors

OUTPUT = os.path.join(make_vectors.HERE, "signed.txt")


def messages(dialect):
    """From the shortest frame to the longest, trimmed and not."""
    rng = random.Random("signed")
    text = bytes(rng.randrange(1, 256) for _ in range(249))
    return [
        dialect.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3),
        dialect.MAVLink_heartbeat_message(0, 0, 0, 0, 0, 0),
        dialect.MAVLink_command_long_message(1, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_setup_signing_message(1, 1, list(range(32)), 0x0000_1234_5678_9ABC),
        dialect.MAVLink_statustext_message(6, b"Signed"),
        dialect.MAVLink_file_transfer_protocol_message(0, 1, 1, list(text) + [9, 9]),
        dialect.MAVLink_tunnel_message(1, 1, 0, 128, [0] * 128),
    ]


def main():
    with tempfile.TemporaryDirectory() as directory:
        dialect = make_vectors.module("2.0", directory)
        keys = [bytes(32), b"\xff" * 32, hashlib.sha256(b"a passphrase").digest()]
        timestamps = [0, 1, 0xFFFF_FFFF, 0x1_0000_0000, 37_000_000_000_000, (1 << 48) - 2]
        lines = []
        for number, key in enumerate(keys):
            for timestamp in timestamps:
                for message in messages(dialect):
                    link = dialect.MAVLink(None, srcSystem=42, srcComponent=17)
                    link.seq = len(lines) % 256
                    link_id = (len(lines) * 37 + number) % 256
                    link.signing.secret_key, link.signing.link_id = key, link_id
                    link.signing.timestamp, link.signing.sign_outgoing = timestamp, True
                    frame = message.pack(link)
                    lines.append(f"{key.hex()} {link_id} {timestamp} {frame.hex()}\n")
    with open(OUTPUT, "w", encoding="ascii") as file:
        file.writelines(lines)
    print(f"{OUTPUT}: {len(lines)} frames")


if __name__ == "__main__":
    main() if sys.argv[1:] == ["--inside"] else make_vectors.enter_environment(os.path.abspath(__file__))
