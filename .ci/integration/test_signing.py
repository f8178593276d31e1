"""Signed sessions: the key is set on the companion's link, and the radio then accepts only frames signed with it (G-1 to G-17)."""

import hashlib
import time

import pytest
from pymavlink import mavutil
from satellite import Satellite
from test_mavproxy import MavProxy

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE
VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
PASSPHRASE = "correct-horse-battery-staple"
# Ground stations derive the key from a passphrase in this way.
KEY = hashlib.sha256(PASSPHRASE.encode()).digest()


def timestamp():
    """Returns the current signing time: 10 us since 2015."""
    return int((time.time() - 1_420_070_400) * 1e5)


def setup(client, key, stamp):
    """Sends SETUP_SIGNING, and returns the vehicle's text about it."""
    client.drain()
    client.mav.setup_signing_send(1, 1, key, stamp)
    text = client.wait("STATUSTEXT", where=lambda text: text.text.startswith("Signing"))
    assert text, "no text about the key"
    return text.text


@pytest.fixture
def signing(other):
    """Sets a key for the duration of the test."""
    assert setup(other, KEY, timestamp()) == "Signing key set"
    yield
    other.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196)
    assert setup(other, bytes(32), 0) == "Signing is off"


def is_signed(message):
    """Returns whether the message has a signature; `get_signed` returns whether it was verified."""
    return bool(message.get_msgbuf()[2] & mavlink.MAVLINK_IFLAG_SIGNED)


def stamp_of(frame):
    return int.from_bytes(frame[-12:-6], "little")


def request(client, stamp=None):
    """Returns the frame of a command that is always answered."""
    command = mavlink.MAVLink_command_long_message(1, 1, REQUEST, 0, VERSION, 0, 0, 0, 0, 0, 0)
    if stamp:
        client.mav.signing.timestamp = stamp
    return bytes(command.pack(client.mav))


def is_answered(client, frame):
    client.drain()
    client.link.write(frame)
    ack = client.wait("COMMAND_ACK", 1)
    assert not ack or ack.get_signed()
    return bool(ack)


def sign(mav, key=KEY, link_id=0):
    mav.signing.secret_key = key
    mav.signing.sign_outgoing = True
    mav.signing.link_id = link_id
    mav.signing.timestamp = timestamp()


def test_signed_session(gcs, other, signing):
    """G-1 to G-6: pymavlink verifies all received frames, and its commands are answered. Replayed and unsigned frames are not."""
    unsigned = request(gcs)
    assert not is_answered(gcs, unsigned)
    sign(gcs.mav)
    gcs.drain()
    deadline, verified = time.monotonic() + 3, 0
    while time.monotonic() < deadline:
        if not (message := gcs.link.recv_match(blocking=True, timeout=1)):
            continue
        assert message.get_type() != "BAD_DATA" and is_signed(message), message
        # pymavlink does not verify unknown messages.
        verified += message.get_signed()
    assert verified > 30
    frame = request(gcs)
    assert is_answered(gcs, frame)
    assert not is_answered(gcs, frame), "a replayed frame was accepted"
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    assert not is_answered(gcs, unsigned)
    bad = bytearray(request(gcs))
    bad[-1] ^= 1
    assert not is_answered(gcs, bytes(bad)), "a wrong signature was accepted"
    # Other frames with the same timestamp and with the one before it.
    assert not is_answered(gcs, request(gcs, stamp_of(frame)))
    assert not is_answered(gcs, request(gcs, stamp_of(frame) - 1))
    assert is_answered(gcs, request(gcs, timestamp()))
    # MAVLink 1 cannot sign.
    old = mavlink.MAVLink_command_long_message(1, 1, REQUEST, 0, VERSION, 0, 0, 0, 0, 0, 0)
    assert not is_answered(gcs, bytes(old.pack(gcs.mav, force_mavlink1=True)))
    # The companion's link still accepts unsigned frames.
    assert other.command(REQUEST, VERSION) == ACCEPTED


def test_frames_with_another_key_are_refused(gcs, signing):
    """G-10"""
    sign(gcs.mav, bytes(range(32)))
    frame = request(gcs)
    gcs.mav.signing.secret_key = None
    assert not is_answered(gcs, frame)


def test_wrong_key_on_the_wire_gets_a_hint(other, signing):
    """G-10, G-11: commands are not answered, but an unsigned text gives the reason."""
    sign(other.mav, bytes(range(32)))
    frame = request(other)
    # Otherwise pymavlink ignores unsigned frames.
    other.mav.signing.secret_key = None
    other.mav.signing.sign_outgoing = False
    other.drain()
    other.link.write(frame)
    hint = other.wait("STATUSTEXT", 3, lambda text: text.text.startswith("Wrong signing key"))
    assert hint and not is_signed(hint)
    assert not is_answered(other, frame)


@pytest.mark.parametrize("back, is_heard", [(59, True), (61, False)])
def test_client_clock_that_is_behind(gcs, signing, back, is_heard):
    """G-6: a new stream may be up to a minute behind the vehicle's time, which its frames show."""
    sign(gcs.mav)
    # On a busy machine the frame may be too old when it arrives. Then the test is repeated.
    for attempt in range(5):
        gcs.drain()
        began = time.monotonic()
        theirs = stamp_of(gcs.wait("ATTITUDE").get_msgbuf())
        # Another link id is another stream.
        gcs.mav.signing.link_id = 100 + back + 10 * attempt
        gcs.link.write(request(gcs, theirs - back * 100_000))
        took = time.monotonic() - began
        ack = gcs.wait("COMMAND_ACK", 1)
        assert not ack or ack.get_signed()
        if bool(ack) == is_heard or took < 0.5:
            break
    assert bool(ack) == is_heard


def test_signatures_follow_real_time(gcs, other, target):
    """G-4, G-14: timestamps follow the vehicle's clock, or, without a clock, start at the time of the key. An unsigned SYSTEM_TIME
    does not move them."""
    has_clock = target == "sitl"
    hour = 3_600 * 100_000
    began = timestamp()
    assert setup(other, KEY, began - (hour if has_clock else 0)) == "Signing key set"
    try:
        for client in (gcs, other):
            client.mav.system_time_send(int(time.time() * 1e6) + 3_600_000_000, 1000)
        ahead, deadline = [], time.monotonic() + 60
        # Four in a row: on a busy machine this program may see one late.
        while len(ahead) < 4 or min(ahead[-4:]) <= -50_000 or max(ahead[-4:]) - min(ahead[-4:]) >= 30_000:
            assert time.monotonic() < deadline, f"it does not follow within 0.3 s: {ahead}"
            beat = gcs.wait("HEARTBEAT").get_msgbuf()
            # After a start, the signing time may be a minute ahead of the clock, and it follows peers that signed before.
            ahead.append(stamp_of(beat) - timestamp())
        assert max(ahead) < hour / 2, "an unsigned SYSTEM_TIME moved it"
        told = gcs.wait("SYSTEM_TIME", 3).time_unix_usec
        assert abs(told / 1e6 - time.time()) < 3 if has_clock else told == 0
    finally:
        setup(other, bytes(32), 0)


def test_first_key_is_set_again(gcs, other, signing, target):
    """G-8, G-17: another key, no key, then the first key again with a timestamp more than a minute ahead: recorded frames
    are not accepted again, and a client that follows the vehicle's time is heard. A vehicle that knows the time accepts
    none that is older than a minute."""
    sign(gcs.mav, link_id=7)
    recorded = timestamp() - 55 * 100_000
    frame = request(gcs, recorded)
    assert is_answered(gcs, frame)
    before = stamp_of(gcs.wait("HEARTBEAT").get_msgbuf())
    assert setup(other, bytes(range(32)), timestamp()) == "Signing key set"
    assert setup(other, bytes(32), 0) == "Signing is off"
    ahead = max(before, timestamp()) + 62 * 100_000
    assert setup(other, KEY, ahead) == "Signing key set"
    assert stamp_of(gcs.wait("HEARTBEAT").get_msgbuf()) >= ahead
    if target == "sitl":
        time.sleep(max(0, 61 - (timestamp() - recorded) / 100_000))
    assert not is_answered(gcs, frame), "a replayed frame was accepted"
    assert is_answered(gcs, request(gcs, ahead))


def test_client_clock_that_is_years_ahead(gcs, other, signing, target):
    """G-17: a vehicle with a clock refuses it. Without a clock, setting another key undoes its effect."""
    sign(gcs.mav, link_id=8)
    wrong = timestamp() + 14 * 365 * 86_400 * 100_000
    assert is_answered(gcs, request(gcs, wrong)) == (target != "sitl")
    if target != "sitl":
        assert stamp_of(gcs.wait("HEARTBEAT").get_msgbuf()) >= wrong
        assert setup(other, bytes(range(32)), timestamp()) == "Signing key set"
        assert setup(other, KEY, timestamp()) == "Signing key set"
        # A ground station must forget the wrong time: it does not verify frames with earlier timestamps.
        gcs.mav.signing.secret_key, gcs.mav.signing.sign_outgoing = None, False
        assert gcs.wait("HEARTBEAT", where=lambda heartbeat: stamp_of(heartbeat.get_msgbuf()) < wrong)
        gcs.mav.signing.stream_timestamps.clear()
    sign(gcs.mav, link_id=9)
    assert is_answered(gcs, request(gcs, timestamp()))


def test_signing_over_the_satellite(gcs, other, port, signing):
    """G-9, G-16: only a sender with the key can start the reports, which are signed."""
    satellite = Satellite(port + 2)
    try:
        satellite.send_command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, 1)
        assert satellite.listen(1.5) == []
        sign(satellite.mav, link_id=2)
        assert satellite.control(1) == ACCEPTED
        (report,) = satellite.until("HIGH_LATENCY2")
        assert report.get_signed()
        assert satellite.control(0) == ACCEPTED
    finally:
        satellite.socket.close()
        other.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, 0)


def test_key_is_accepted_on_the_wire_only(gcs, other):
    """G-11: a key is refused on the radio, as a broadcast, and while the vehicle is armed."""
    gcs.mav.setup_signing_send(1, 1, KEY, timestamp())
    assert gcs.wait("STATUSTEXT", 2, lambda text: "not by this link" in text.text)
    other.mav.setup_signing_send(0, 0, KEY, timestamp())
    assert not other.wait("STATUSTEXT", 1)
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED, "it has none"
    assert "armed" in setup(other, KEY, timestamp())
    assert not is_signed(gcs.wait("HEARTBEAT")) and not is_signed(other.wait("HEARTBEAT"))
    assert gcs.command(REQUEST, VERSION) == ACCEPTED


def test_mavproxy_signs(signing, port, tmp_path):
    """MAVProxy works as before, once its user has entered the passphrase."""
    mavproxy = MavProxy(port, tmp_path, "arm,signing")
    try:
        mavproxy.expect("Detected vehicle 1:1")
        mavproxy.say("signing key something-else")
        mavproxy.say("arm throttle")
        time.sleep(2)
        assert "ARM_DISARM" not in mavproxy.output
        mavproxy.say(f"signing key {PASSPHRASE}")
        mavproxy.say("arm throttle")
        mavproxy.expect("ARM_DISARM: ACCEPTED")
    finally:
        mavproxy.end()


@pytest.fixture
def vehicle(vehicle):
    """Removes the key after the test."""
    yield vehicle
    setup(vehicle.gcs, bytes(32), 0)


def test_key_survives_a_power_cut(vehicle):
    """G-13, G-15: the key survives, and no timestamp is used twice."""

    def stamp():
        beat = vehicle.gcs.wait("HEARTBEAT")
        return is_signed(beat) and stamp_of(beat.get_msgbuf())

    assert setup(vehicle.gcs, KEY, timestamp()) == "Signing key set"
    # The key is written a moment later.
    time.sleep(1)
    before = stamp()
    assert before
    vehicle.cut()
    after = stamp()
    assert after and after > before
