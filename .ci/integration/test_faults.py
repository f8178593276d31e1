"""Link faults on a real connection: a client that sends damaged frames.

The other rows of the fault matrix run inside the firmware (`cargo xtask faults`). They include stalled links, which sockets cannot
simulate because they buffer too much. `test_power.py` resets the emulated processor during uploads and commits.
"""

import random
import time

from plans import differences, plan
from pymavlink import mavutil
from transfer import ACCEPTED, download, next_word, send_item

mavlink = mavutil.mavlink


def test_upload_completes_over_a_damaged_line(gcs, figure):
    """S-13, M-40: every tenth frame has flipped, lost or additional bytes."""
    chance = random.Random(5)
    write, damaged = gcs.link.write, 0

    def write_badly(frame):
        nonlocal damaged
        frame = bytearray(frame)
        if chance.random() < 0.1:
            damaged += 1
            at = chance.randrange(len(frame))
            kind = chance.randrange(3)
            if kind == 0:
                frame[at] ^= 1 << chance.randrange(8)
            elif kind == 1:
                del frame[at]
            else:
                frame[at:at] = bytes([0xFD, *chance.randbytes(chance.randrange(60))])
        return write(bytes(frame))

    items = plan(100)
    gcs.link.write = write_badly
    began = time.monotonic()
    asked = False
    while True:
        if not asked:
            gcs.mav.mission_count_send(1, 1, len(items), mavlink.MAV_MISSION_TYPE_MISSION)
        message = next_word(gcs, mavlink.MAV_MISSION_TYPE_MISSION, 0.7)
        if message and message.get_type() == "MISSION_ACK":
            break
        if message:
            asked = True
            send_item(gcs, items[message.seq])
        elif asked:
            # The last answer may be unsolicited.
            send_item(gcs, items[-1])
        assert time.monotonic() < began + 60, "the upload does not end"
    gcs.link.write = write
    assert message.type == ACCEPTED
    took = time.monotonic() - began
    assert damaged > 3 and not differences(items, download(gcs).items)
    figure(f"100 items up a bad line: {damaged} frames damaged, {took:.1f} s")
