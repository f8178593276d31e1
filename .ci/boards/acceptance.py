"""The acceptance test of a port: a ground station uses the rover of `examples/boards` on an emulated board, through its UART.

`cargo xtask boards --run` starts the board and calls this with the TCP ports of its link and of the emulator's control port. The path
of Python modules has `.ci/integration`.
"""

import argparse
import contextlib
import itertools
import math
import time
from collections import Counter

import qgc
from conftest import Gcs, is_armed
from gdb import Gdb
from plans import NAV_WAYPOINT, differences, plan, single
from power import Qmp
from pymavlink import mavutil
from transfer import ACCEPTED, download, upload

mavlink = mavutil.mavlink

HOLD, MISSION = 4 << 16 | 3 << 24, 4 << 16 | 4 << 24
PARAMETERS = {"BAT_V_LOW", "FS_GCS_ENABLE", "SPEED_MAX", "SYS_ID"}
# The longest wait for an answer (s).
PATIENCE = 10
# Hz
RATES = {"HEARTBEAT": 1, "SYS_STATUS": 1, "GPS_RAW_INT": 1, "VFR_HUD": 2, "ATTITUDE": 4, "BATTERY_STATUS": 0.5}


class Station(Gcs):
    """A ground station that checks each frame of the vehicle and, while it waits, sends heartbeats."""

    beats = True
    last_beat = 0.0

    def __init__(self, port):
        self.bad = self.lost = self.frames = 0
        self.sequence = None
        super().__init__(port)
        # Before the first heartbeat, the connection may have begun in the middle of a frame.
        self.link.message_hooks.append(self.check)
        self.link.handle_eof = self.end

    def end(self):
        raise AssertionError("the emulator has ended")

    def check(self, _, message):
        if message.get_type() == "BAD_DATA":
            self.bad += 1
            return
        self.frames += 1
        sequence = message.get_seq()
        if self.sequence is not None:
            self.lost += (sequence - self.sequence - 1) % 256
        self.sequence = sequence

    def forget(self):
        """After a reset: the next frame does not continue the last one."""
        self.forget_half_a_frame()
        self.sequence = None

    def beat(self):
        """Sends a heartbeat, if one is due."""
        now = time.monotonic()
        if self.beats and now - self.last_beat >= 1:
            self.last_beat = now
            self.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    def hear(self, kind, timeout=3.0, where=lambda message: True):
        # On a busy machine the emulator may stand still for seconds.
        deadline = time.monotonic() + (max(timeout, PATIENCE) if kind else timeout)
        while (now := time.monotonic()) < deadline:
            self.beat()
            message = super().hear(kind, min(deadline - now, 0.1), where)
            if message:
                return message
        return None

    def heartbeat(self, where, timeout=3.0):
        beat = self.wait("HEARTBEAT", timeout, where)
        assert beat, "no such heartbeat"
        return beat

    def count(self, seconds):
        """Counts the messages of some seconds."""
        counts = Counter()
        self.hear(None, seconds, lambda message: counts.update([message.get_type()]))
        return counts


@contextlib.contextmanager
def step(name):
    """Prints the step with its figures, which the block appends, and its duration."""
    began, figures = time.monotonic(), []
    try:
        yield figures.append
    except BaseException:
        print(f"{time.monotonic() - began:5.1f} s  {name}: FAILED; {', '.join(figures)}", flush=True)
        raise
    print(f"{time.monotonic() - began:5.1f} s  {name}: {', '.join(figures)}", flush=True)


def connect(gcs, figure):
    """QGroundControl's connection sequence, up to "ready"."""
    station = qgc.Qgc(gcs)
    station.connect()
    assert all(step.is_answered for step in station.steps), station.steps
    assert station.steps[-1].name == "ready"
    assert set(station.parameters) == PARAMETERS, station.parameters
    ready = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    status = gcs.wait("SYS_STATUS")
    sensors = (status.onboard_control_sensors_present, status.onboard_control_sensors_enabled)
    assert all(flags & ready for flags in (*sensors, status.onboard_control_sensors_health)), status
    figure(f"{len(station.steps)} steps, {sum(step.retries for step in station.steps)} retries")


def set_parameter(gcs, name, value):
    gcs.mav.param_set_send(1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32)
    answer = gcs.wait("PARAM_VALUE", where=lambda answer: answer.param_id == name)
    assert answer, f"no answer to PARAM_SET {name}"
    return answer.param_value


def parameter(gcs, name):
    gcs.mav.param_request_read_send(1, 1, name.encode(), -1)
    answer = gcs.wait("PARAM_VALUE", where=lambda answer: answer.param_id == name)
    assert answer, f"no answer to PARAM_REQUEST_READ {name}"
    return answer.param_value


def waypoints(count):
    items = [item for item in plan(2 * count) if item["command"] == NAV_WAYPOINT][:count]
    return [item | {"seq": seq, "current": int(seq == 0)} for seq, item in enumerate(items)]


def set_mode(gcs, mode):
    main, sub = mode >> 16 & 0xFF, mode >> 24
    flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    assert gcs.command(mavlink.MAV_CMD_DO_SET_MODE, flags, main, sub) == mavlink.MAV_RESULT_ACCEPTED
    gcs.heartbeat(lambda beat: beat.custom_mode == mode)


def arm(gcs, is_wanted):
    result = gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, int(is_wanted))
    assert result == mavlink.MAV_RESULT_ACCEPTED, result
    gcs.heartbeat(lambda beat: is_armed(beat) == is_wanted)


def measure(gcs, seconds, rates):
    """Returns the rates of these messages (Hz), and of all. On a busy machine the emulator is late: then it measures again."""
    for _ in range(5):
        counts = gcs.count(seconds)
        missing = {kind: rate * seconds - counts[kind] for kind, rate in rates.items()}
        tolerance = {kind: 1 + 0.1 * rate * seconds for kind, rate in rates.items()}
        # Never too often.
        assert all(missing[kind] >= -tolerance[kind] for kind in rates), counts
        if all(missing[kind] <= tolerance[kind] for kind in rates):
            return {kind: counts[kind] / seconds for kind in rates} | {"all": sum(counts.values()) / seconds}
    raise AssertionError(f"too few in {seconds} s: {counts}")


@contextlib.contextmanager
def load(qmp, figure, name):
    """Prints which share of the processor's time is used meanwhile, if the emulator counts it."""
    if not qmp:
        yield
        return
    before = qmp.execute("query-counters")
    yield
    after = qmp.execute("query-counters")
    awake, passed = (after[key] - before[key] for key in ("awake", "passed"))
    figure(f"{name}: {awake / passed:.1%} of the processor")


def streams(gcs, figure, counter):
    with load(counter, figure, "streams"):
        rates = measure(gcs, 6, RATES)
    interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    assert gcs.command(interval, mavlink.MAVLINK_MSG_ID_ATTITUDE, 50_000) == mavlink.MAV_RESULT_ACCEPTED
    fast = measure(gcs, 3, {"ATTITUDE": 20})
    assert gcs.command(interval, mavlink.MAVLINK_MSG_ID_ATTITUDE, 0) == mavlink.MAV_RESULT_ACCEPTED
    figure(f"{rates['all']:.0f} messages/s, ATTITUDE at {fast['ATTITUDE']:.1f} of 20 Hz on request")


def flood(gcs, figure, counter):
    """Commands at the rate of the line, at twice that rate, and as fast as TCP takes them, which no UART could: what does not fit
    into the receive queue is lost, but the vehicle's own frames stay whole, and its heartbeats in time."""
    beats = [time.monotonic()]

    def receive(counts, probe):
        gcs.beat()
        while message := gcs.link.recv_match(type=["COMMAND_ACK", "HEARTBEAT", "PARAM_VALUE"], blocking=False):
            if message.get_type() == "PARAM_VALUE" and message.param_id != probe:
                continue
            counts[message.get_type()] += 1
            if message.get_type() == "HEARTBEAT":
                beats.append(time.monotonic())
            elif message.get_type() == "COMMAND_ACK":
                assert message.result == mavlink.MAV_RESULT_UNSUPPORTED
        time.sleep(0.002)

    # A command has 44 bytes, and 57,600 bit/s carry 131 in a second.
    floods = [("at 131/s", 131, 393), ("at 262/s", 262, 786), ("at once", math.inf, 1_000)]
    for (name, rate, total), probe in zip(floods, sorted(PARAMETERS), strict=True):
        began, sent, counts = time.monotonic(), 0, Counter()
        with load(counter, figure, name):
            while sent < total:
                while sent < total and sent <= (time.monotonic() - began) * rate:
                    gcs.send_command(mavlink.MAV_CMD_NAV_LAND)
                    sent += 1
                receive(counts, probe)
            # Until a request is answered that is sent behind the flood. A ground station repeats its requests.
            asked = -math.inf
            while not counts["PARAM_VALUE"]:
                now = time.monotonic()
                assert now - began < 30, f"no answer after the commands {name}"
                if now - asked > 1:
                    gcs.mav.param_request_read_send(1, 1, probe.encode(), -1)
                    asked = now
                receive(counts, probe)
        passed = time.monotonic() - began
        figure(f"{counts['COMMAND_ACK']} of {total} answered {name} in {passed:.1f} s")
        least = {131: 0.5, 262: 0.25}.get(rate, 0) * total
        assert counts["COMMAND_ACK"] >= least, counts
    gap = max(late - early for early, late in zip(beats, beats[1:]))
    assert gap < PATIENCE / 2, f"no heartbeat for {gap:.1f} s"
    figure(f"heartbeats at most {gap:.2f} s apart")


def lose_station(gcs, figure):
    """The failsafe: an armed rover in Mission holds when the station falls silent."""
    set_mode(gcs, MISSION)
    arm(gcs, True)
    gcs.beats, began = False, time.monotonic()
    text = gcs.wait("STATUSTEXT", where=lambda text: text.text.startswith("Ground station lost"))
    assert text, "no text about the lost station"
    passed = time.monotonic() - began
    beat = gcs.heartbeat(lambda beat: beat.custom_mode == HOLD)
    assert is_armed(beat) and beat.system_status == mavlink.MAV_STATE_CRITICAL, beat
    gcs.beats = True
    gcs.heartbeat(lambda beat: beat.system_status == mavlink.MAV_STATE_ACTIVE, 5)
    figure(f"holds after {passed:.1f} s")


@contextlib.contextmanager
def restart(gcs):
    """The block resets the processor. Returns when it runs again: disarmed, in Hold."""
    bad = gcs.bad
    yield
    beat = gcs.heartbeat(lambda _: True, 5)
    # The last frame before the reset may be incomplete, and a UART may send a byte when it starts.
    gcs.bad = bad
    assert not is_armed(beat) and beat.custom_mode == HOLD, beat
    assert gcs.wait("ATTITUDE").time_boot_ms < 5_000, "the clock did not restart"


def reset(gcs, qmp):
    """Resets the processor. Nothing that it sent before is received afterwards."""
    qmp.execute("stop", event="STOP")
    gcs.take_all()
    qmp.execute("system_reset", event="RESET")
    gcs.forget()
    qmp.execute("cont", event="RESUME")


def change(gcs, items, speed):
    """Changes what is stored. While the rover is armed it stores nothing."""
    arm(gcs, True)
    assert set_parameter(gcs, "SPEED_MAX", speed) == speed
    assert upload(gcs, items).type == ACCEPTED


def others(items):
    """Two missions, and two values of the parameter, to store in turn."""
    return [items, [item | {"param1": 1.0} for item in items]], [single(math.pi), single(math.e)]


def store(gcs, qmp, items, is_lossless, figure):
    """How long a pass of the loop takes while a mission and a parameter are stored, and how many commands are lost meanwhile."""
    missions, speeds = others(items)
    change(gcs, missions[1], speeds[1])
    before = qmp.execute("query-counters")
    sent = answered = 0
    began = last = time.monotonic()
    gcs.send_command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    # The last answers may be late, on a busy machine.
    while (now := time.monotonic()) - began < PATIENCE or (answered < sent and now - last < 2):
        gcs.beat()
        # In bursts, which are longer than a UART's FIFO when an erase begins.
        if sent < 900 and sent <= 100 * (now - began):
            for _ in range(10):
                gcs.send_command(mavlink.MAV_CMD_NAV_LAND)
            sent += 10
        while message := gcs.link.recv_match(type="COMMAND_ACK", blocking=False):
            if message.command == mavlink.MAV_CMD_NAV_LAND:
                answered, last = answered + 1, now
        time.sleep(0.002)
    gcs.heartbeat(lambda beat: not is_armed(beat))
    after = qmp.execute("query-counters")
    total, stall = after["writes"] - before["writes"], after["longest"] / 1e6
    figure(f"{total} writes, a pass of the loop takes up to {stall:.1f} ms, {answered} of {sent} commands answered")
    assert total > len(items) / 7, f"only {total} writes"
    # The emulator erases in 45 ms. The loop runs between two erases.
    assert 45 <= stall < 90, f"the loop stood still for {stall} ms"
    assert answered == sent or not is_lossless, "commands were lost"


def cut_in_flash(gcs, qmp, after):
    """Disarms the rover, which then stores what has changed, and resets the processor in the middle of a write of the flash, after so
    many more. Returns whether there was this write; if not, everything was stored before the reset."""
    resets = qmp.execute("query-counters")["resets"]
    qmp.execute("cut-in-flash", after=after)
    gcs.send_command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    writes = since = None
    while (counters := qmp.execute("query-counters"))["resets"] == resets:
        if counters["writes"] != writes:
            writes, since = counters["writes"], counters["passed"]
        if counters["passed"] - since > 5e9:
            qmp.execute("cut-in-flash", after=None)
            reset(gcs, qmp)
            return False
        gcs.beat()
        time.sleep(0.02)
    gcs.forget()
    qmp.execute("cont", event="RESUME")
    return True


def cut_between_words(port, address):
    """The same for QEMU: the reset comes between two words of the flash, 37 words later each time. `address` is read after each word."""

    def cut(gcs, qmp, after):
        gdb = Gdb(port, address)
        gcs.send_command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
        is_cut = gdb.run_until(1 + 37 * after, silence=PATIENCE)
        gcs.take_all()
        qmp.execute("system_reset", event="RESET")
        gcs.forget()
        gdb.leave()
        return is_cut

    return cut


def cuts(gcs, qmp, items, cut, figure):
    """Resets, each a little later, while a mission and a parameter are stored. Afterwards each is the old one or the new one, whole.
    Ends when everything was stored before the reset."""
    missions, speeds = others(items)

    def stored():
        """Returns which mission and which value of the parameter the rover has."""
        items, value = download(gcs).items, parameter(gcs, "SPEED_MAX")
        assert value in speeds, value
        for mission in (0, 1):
            if not differences(missions[mission], items):
                return mission, speeds.index(value)
        raise AssertionError(f"neither mission, but {len(items)} items")

    now, found = stored(), Counter()
    for after in itertools.count():
        old = now
        change(gcs, missions[1 - old[0]], speeds[1 - old[1]])
        with restart(gcs):
            is_cut = cut(gcs, qmp, after)
        now = stored()
        is_new = now[0] != old[0], now[1] != old[1]
        assert all(is_new) or is_cut, is_new
        found[is_new] += 1
        if not is_cut:
            break
        assert after < 200, "it stores without an end"
    names = {(False, False): "nothing", (False, True): "the parameter", (True, False): "the mission", (True, True): "both"}
    figure(f"{after} resets in between, new afterwards: " + ", ".join(f"{found[key]} times {name}" for key, name in names.items()))
    assert found[(False, False)] and found.total() > found[(False, False)] + found[(True, True)], found


def reopen(gcs, port, figure):
    """No program reads for a while: the link is backpressured, and its backlog is short."""
    before = gcs.wait("ATTITUDE").time_boot_ms
    gcs.close()
    time.sleep(5)
    again = Gcs(port, is_new=True)
    stale, began = 0, time.monotonic()
    while (message := again.hear("ATTITUDE", 5)).time_boot_ms < before + 5_000:
        stale += 1
    passed = time.monotonic() - began
    assert stale <= 8 and passed < PATIENCE / 2, (stale, passed, message)
    again.close()
    figure(f"{stale} ATTITUDE of before, then up to date after {passed:.1f} s")


def main():
    options = argparse.ArgumentParser()
    options.add_argument("--port", type=int, required=True)
    options.add_argument("--qmp-port", type=int, required=True)
    options.add_argument("--items", type=int, default=100, help="the longest mission of the board")
    options.add_argument("--forgets", action="store_true", help="the board has no storage")
    options.add_argument("--rp2040js", action="store_true", help="the emulator counts the load, and cuts writes to flash")
    options.add_argument("--gdb", type=lambda text: int(text, 0), nargs=2, help="QEMU's port, and what is read after a word is written")
    options.add_argument("--dma", action="store_true", help="no received byte is lost while the flash is erased")
    options.add_argument("--usb", action="store_true", help="the link is backpressured while no program reads")
    options = options.parse_args()
    items, speed = waypoints(options.items), single(math.pi)
    with step("heartbeat") as figure:
        gcs = Station(options.port)
        qmp = Qmp(options.qmp_port)
        counter = qmp if options.rp2040js else None
        beat = gcs.heartbeat(lambda _: True)
        assert beat.type == mavlink.MAV_TYPE_GROUND_ROVER and not is_armed(beat) and beat.custom_mode == HOLD, beat
        figure("a rover, disarmed, in Hold")
    with step("QGroundControl connects") as figure:
        connect(gcs, figure)
    with step("parameters") as figure:
        assert set_parameter(gcs, "SPEED_MAX", speed) == speed
        # Out of range: answered with the value that stays.
        assert set_parameter(gcs, "SPEED_MAX", 11.0) == speed
        figure("one set, one refused")
    with step("streams") as figure:
        streams(gcs, figure, counter)
    with step("mission up") as figure:
        assert upload(gcs, items).type == ACCEPTED
        figure(f"{len(items)} items")
    with step("mission down") as figure:
        back = download(gcs)
        assert not differences(items, back.items)
        figure(f"{len(items)} items, equal")
    with step("arm, disarm") as figure:
        arm(gcs, True)
        arm(gcs, False)
        figure("accepted")
    with step("flood of commands") as figure:
        flood(gcs, figure, counter)
    with step("failsafe") as figure:
        lose_station(gcs, figure)
    with step("reset while armed") as figure:
        with restart(gcs):
            reset(gcs, qmp)
        figure("runs again")
    with step("after the reset") as figure:
        kept, again = parameter(gcs, "SPEED_MAX"), download(gcs)
        if options.forgets:
            assert kept == 2.0 and not again.items
            figure("no mission, and the default of the parameter")
        else:
            assert kept == speed
            assert again.id == back.id and not differences(items, again.items)
            figure("parameter and mission as stored")
    if options.rp2040js:
        with step("while the flash is written") as figure:
            store(gcs, qmp, items, options.dma, figure)
    if options.rp2040js or options.gdb:
        with step("resets while it stores") as figure:
            cuts(gcs, qmp, items, cut_in_flash if options.rp2040js else cut_between_words(*options.gdb), figure)
    with step("all frames") as figure:
        figure(f"{gcs.frames} of the vehicle, {gcs.bad} bad, {gcs.lost} lost")
        assert gcs.bad == gcs.lost == 0
    if options.usb:
        with step("no reader") as figure:
            reopen(gcs, options.port, figure)
    gcs.close()


if __name__ == "__main__":
    main()
