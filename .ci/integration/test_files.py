"""Files by FTP with pymavlink, MAVProxy and MAVSDK: parameters and plans as files, and component metadata (F-4, F-8, F-9, F-12, F-13,
F-14, F-20, F-23, P-22, O-1)."""

import io
import json
import lzma
import pathlib
import queue
import random
import struct
import time
import zlib

import pytest
from mavsdk.plugins.ftp import Ftp
from mavsdk.plugins.ftp.ftp import FtpError, FtpResult
from plans import FENCE, MISSION, PLANS, RALLY, differences, plan
from pymavlink import mavftp, mavutil
from test_mavproxy import FENCE_FILE, MISSION_FILE, RALLY_FILE, MavProxy, items, rows
from test_params import DEFAULTS, fetch, to_float
from transfer import ACCEPTED, clear_all, download, ids, plan_id, upload

# The build compresses it.
PARAMETERS = (pathlib.Path(__file__).parents[2] / "examples/demo/metadata/parameters.json").read_bytes()
# The types of the packed file: integers without a sign are in the next larger type.
PACKED = {1: 2, 2: 1, 3: 3, 4: 2, 5: 3, 6: 3, 9: 4}


def crc(content):
    """MAVLink's CRC-32."""
    return zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF


class Files:
    """pymavlink's client."""

    def __init__(self, gcs, **settings):
        self.client = mavftp.MAVFTP(gcs.link, 1, 1)
        for name, value in settings.items():
            setattr(self.client.ftp_settings, name, value)

    def get(self, path, timeout=30):
        content = []
        self.client.cmd_get([path], callback=lambda file: content.append(file and file.read()))
        result = self.client.process_ftp_reply("OpenFileRO", timeout=timeout)
        assert content, f"{path}: {result.error_code}"
        return content[-1]

    def put(self, path, content, timeout=30):
        """Returns the number of bytes that were sent, or None if they were refused."""
        sent = []
        self.client.cmd_put([path, path], fh=io.BytesIO(content), callback=sent.append)
        self.client.process_ftp_reply("CreateFile", timeout=timeout)
        return sent[-1]


def decode(content):
    """Returns values and defaults by name, as MAVProxy decodes them."""
    from MAVProxy.modules.lib import param_ftp

    data = param_ftp.ftp_param_decode(content)
    assert data, "not a packed file"
    entries = {name.decode(): (value, kind) for name, value, kind in data.params}
    return entries, {name.decode(): value for name, value, _ in data.defaults or []}


@pytest.mark.parametrize("size", [80, 239])
def test_pymavlink_reads_files(gcs, size):
    files = Files(gcs, burst_read_size=size)
    assert lzma.decompress(files.get("/parameters.json.xz")) == PARAMETERS
    assert json.loads(files.get("general.json"))["version"] == 1


def test_pymavlink_reads_files_over_a_bad_line(gcs):
    # pymavlink's client draws its losses from the global generator.
    random.seed(8)
    files = Files(gcs, burst_read_size=239, pkt_loss_tx=10, pkt_loss_rx=10)
    assert lzma.decompress(files.get("parameters.json.xz", timeout=60)) == PARAMETERS


def test_pymavlink_reads_parameters(gcs, other, figure):
    begin = time.monotonic()
    listed = fetch(other)
    by_list = time.monotonic() - begin
    files = Files(gcs, burst_read_size=239)
    begin = time.monotonic()
    content = files.get("@PARAM/param.pck?withdefaults=1")
    figure(f"{len(listed)} parameters: {by_list:.2f} s as a list, {time.monotonic() - begin:.2f} s as a file")
    entries, defaults = decode(content)
    assert list(entries) == [value.name for value in listed]
    for value in listed:
        found, kind = entries[value.name]
        assert kind == PACKED[value.type], value
        assert found == pytest.approx(value.value) or value.name.startswith("STAT_"), value
        assert value.name in defaults
    plain, none = decode(files.get("@PARAM/param.pck"))
    assert list(plain) == list(entries) and not none


def test_pymavlink_is_refused(gcs):
    files = Files(gcs)
    client = files.client
    for result in (
        client.cmd_rm(["general.json"]),
        client.cmd_mkdir(["new"]),
        client.cmd_rename(["general.json", "other.json"]),
    ):
        assert result.error_code == mavftp.FtpError.FileProtected, result.operation_name
    files.client.cmd_get(["missing"], callback=lambda _: None)
    result = files.client.process_ftp_reply("OpenFileRO", timeout=10)
    assert result.error_code == mavftp.FtpError.FileNotFound


def test_mavproxy_lists_and_gets(port, tmp_path):
    proxy = MavProxy(port, tmp_path, "ftp")
    try:
        proxy.expect("Detected vehicle")
        proxy.say("ftp list")
        proxy.expect_all("general.json", "parameters.json.xz\t", "D @PARAM", "Total size")
        proxy.say("ftp list @PARAM")
        proxy.expect("param.pck")
        proxy.say("ftp get parameters.json.xz got.xz")
        proxy.expect("Wrote ", timeout=60)
        compressed = (tmp_path / "got.xz").read_bytes()
        assert lzma.decompress(compressed) == PARAMETERS
        proxy.say("ftp crc parameters.json.xz")
        proxy.expect(f"crc: parameters.json.xz 0x{crc(compressed):08x}")
        proxy.say("ftp get missing")
        proxy.expect("ftp open failed")
    finally:
        proxy.end()


def test_mavproxy_loads_parameters(port, other, tmp_path):
    """MAVProxy loads the file by itself when it connects, and sends a file of changes: all of them, or none."""
    proxy = MavProxy(port, tmp_path, "param,ftp")
    kinds = {name: DEFAULTS[name][0] for name in ("MPC_XY_CRUISE", "SIM_BAT_START", "SIM_GPS_SATS")}
    try:
        proxy.expect("parameters (ftp)", timeout=60)
        proxy.say("param ftp")
        proxy.expect("parameters (ftp)", timeout=60)
        (tmp_path / "new.parm").write_text("MPC_XY_CRUISE 6.5\nSIM_BAT_START 90\nSIM_GPS_SATS 11\n")
        other.drain()
        proxy.say(f"param ftpload {tmp_path / 'new.parm'}")
        proxy.expect("Parameter upload done", timeout=60)
        values = {value.name: value.value for value in fetch(other)}
        assert (values["MPC_XY_CRUISE"], values["SIM_BAT_START"], values["SIM_GPS_SATS"]) == (6.5, 90, 11)
        (tmp_path / "bad.parm").write_text("MPC_XY_CRUISE 7.5\nSIM_BAT_START 101\n")
        proxy.say(f"param ftpload {tmp_path / 'bad.parm'}")
        proxy.expect("Failed to send parameters", timeout=60)
        values = {value.name: value.value for value in fetch(other)}
        assert (values["MPC_XY_CRUISE"], values["SIM_BAT_START"]) == (6.5, 90)
    finally:
        proxy.end()
        for name, kind in kinds.items():
            value = to_float(kind, DEFAULTS[name][1])
            other.mav.param_set_send(1, 1, name.encode(), value, kind)
            assert other.wait("PARAM_VALUE", where=lambda value: value.param_id == name)


PLAN_FILES = {MISSION: "@MISSION/mission.dat", FENCE: "@MISSION/fence.dat", RALLY: "@MISSION/rally.dat"}


def to_plan_file(found, kind):
    """Returns the file of a plan, as MAVProxy writes it."""
    item = mavutil.mavlink.MAVLink_mission_item_int_message
    content = struct.pack("<HHHHH", 0x763D, kind, 0, 0, len(found))
    for fields in found:
        fields = dict(fields, target_system=0, target_component=0, mission_type=kind)
        content += item.unpacker.pack(*(fields[name] for name in item.ordered_fieldnames))
    return content


def test_pymavlink_reads_and_sends_plans(gcs, other, figure):
    """F-20, F-23: a plan has the same items and the same id, whichever way it was sent."""
    # A put ends after this silence.
    files = Files(gcs, burst_read_size=239, write_size=239, idle_detection_time=1.1)
    sent = plan(100)
    assert upload(other, sent).type == ACCEPTED
    content = to_plan_file(sent, MISSION)
    begin = time.monotonic()
    assert files.get(PLAN_FILES[MISSION]) == content
    read = time.monotonic() - begin
    begin = time.monotonic()
    assert download(other).items
    figure(f"100 items: {read:.2f} s as a file, {time.monotonic() - begin:.2f} s by messages")
    assert files.put(PLAN_FILES[MISSION], to_plan_file(plan(100, 1), MISSION)) == len(content)
    assert differences(plan(100, 1), download(other).items) == []
    stored = ids(other)
    for kind in (FENCE, RALLY):
        assert files.put(PLAN_FILES[kind], to_plan_file(PLANS[kind](10), kind)) is not None
        back = download(other, kind)
        assert differences(PLANS[kind](10), back.items) == []
        assert plan_id(upload(other, PLANS[kind](10), kind)) == back.id != 0
    wrong = plan(10)
    wrong[7]["command"] = 31_999
    assert files.put(PLAN_FILES[MISSION], to_plan_file(wrong, MISSION)) is None
    assert ids(other)[MISSION] == stored[MISSION]
    clear_all(other)
    assert files.get(PLAN_FILES[MISSION]) == to_plan_file([], MISSION)


def test_mavproxy_reads_and_sends_plans(port, other, tmp_path):
    """F-20, F-23: `wp ftpload` and `wp ftp`, and the same of fences and rally points."""
    proxy = MavProxy(port, tmp_path, "wp,fence,rally,ftp")
    try:
        proxy.expect("Detected vehicle")
        for kind, command, name, text in [
            (MISSION, "wp", "waypoints", MISSION_FILE),
            (FENCE, "fence", "fence items", FENCE_FILE),
            (RALLY, "rally", "rally items", RALLY_FILE),
        ]:
            (tmp_path / f"{command}.txt").write_text(text)
            count = len(rows(text))
            proxy.say(f"{command} ftpload {command}.txt")
            proxy.expect(f"of length {count} in")
            assert differences(items(text), download(other, kind).items) == []
            proxy.say(f"{command} ftp")
            proxy.expect(f"Saved {name} to")
            proxy.say(f"{command} save saved-{command}.txt")
            proxy.expect(f"Saved {count} {name} to saved-{command}.txt")
            assert differences(items(text), items((tmp_path / f"saved-{command}.txt").read_text())) == []
        (tmp_path / "bad.txt").write_text(MISSION_FILE.replace("3	0	3	16	", "3	0	3	82	"))
        proxy.say("wp ftpload bad.txt")
        proxy.expect_all("Failed to send waypoints", "Mission item 3: command not supported")
        assert differences(items(MISSION_FILE), download(other).items) == []
    finally:
        proxy.end()
        clear_all(other)


def transfer(start):
    """Waits for the end of MAVSDK's transfer."""
    results = queue.Queue()
    start(lambda result, *_: results.put(result))
    while (result := results.get(timeout=60)) == FtpResult.NEXT:
        pass
    return result


@pytest.mark.parametrize("use_burst", [False, True])
def test_mavsdk_downloads(system, tmp_path, use_burst):
    ftp = Ftp(system)
    name = "parameters.json.xz"
    result = transfer(lambda done: ftp.download_async(name, str(tmp_path), use_burst, done))
    assert result == FtpResult.SUCCESS
    assert lzma.decompress((tmp_path / name).read_bytes()) == PARAMETERS


def test_mavsdk_lists_and_compares(system, tmp_path):
    ftp = Ftp(system)
    listing = ftp.list_directory("/")
    names = ["@MAV_LOG", "@MISSION", "@PARAM", "events.json.xz", "general.json", "parameters.json.xz"]
    assert [entry.name for entry in listing.entries] == names
    general = tmp_path / "general.json"
    assert transfer(lambda done: ftp.download_async(general.name, str(tmp_path), True, done)) == FtpResult.SUCCESS
    assert ftp.are_files_identical(str(general), "general.json")
    assert not ftp.are_files_identical(str(general), "parameters.json.xz")
    with pytest.raises(FtpError) as refusal:
        ftp.remove_file("general.json")
    assert refusal.value.result == FtpResult.FILE_PROTECTED
    assert transfer(lambda done: ftp.download_async("missing", "/tmp", True, done)) == FtpResult.FILE_DOES_NOT_EXIST


def test_metadata_names_the_file(gcs):
    """O-1: the general file's checksum is that of the file, and it has those of the others."""
    files = Files(gcs)
    general = files.get("general.json")
    for entry in json.loads(general)["metadataTypes"]:
        assert entry["fileCrc"] == crc(files.get(entry["uri"].removeprefix("mftp://"))), entry
    for unused in (0.0, float("nan")):
        gcs.send_command(512, 397, *[unused] * 6)
        # pymavlink does not have this message yet.
        message = gcs.hear("UNKNOWN_397")
        assert message, f"no answer with {unused}"
        payload = bytes(message.get_msgbuf())[10:-2].ljust(108, b"\0")
        file_crc, uri = struct.unpack_from("<I100s", payload, 4)
        assert (uri.rstrip(b"\0"), file_crc) == (b"mftp:///general.json", crc(general)), "F-15"
