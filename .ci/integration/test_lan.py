"""The firmwares on Ethernet, on a network with other hosts."""

import time

import pytest
from firmware import running
from lan import PORT, Lan
from pymavlink import mavutil

mavlink = mavutil.mavlink


@pytest.mark.parametrize("app", ["ethernet", "ethernet-embassy"])
def test_a_station_that_answers_no_arp_does_not_stop_the_others(app, request, tmp_path):
    """Two stations on the network. The vehicle cannot resolve the address of one, whose datagrams fill the queue of the socket."""
    option = request.config.getoption
    base = option("spare_port_base")
    lan = Lan(base + 3, base)
    heartbeat = lan.mav.heartbeat_encode(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
    pilot, silent = 50, 66
    lan.answering.add(pilot)

    def hears(hosts, timeout, silence=0):
        """Whether the pilot gets a frame within `timeout` (s) but not within `silence` (s). These hosts send a heartbeat each second."""
        began, due = time.monotonic(), 0
        while (elapsed := time.monotonic() - began) < timeout:
            if elapsed >= due:
                due += 1
                for host in hosts:
                    lan.send(host, heartbeat)
            received = lan.receive(0.1)
            if received and received[0] == pilot and elapsed >= silence:
                return True
        return False

    try:
        with running(option, app, tmp_path / "output.txt", f"--udp=127.0.0.1:{PORT}", f"--nic={lan.nic}"):
            assert lan.receive(15), "the vehicle does not broadcast"
            assert hears([pilot], 10), "the vehicle does not answer"
            hears([pilot, silent], 3, silence=3)
            assert hears([pilot], 15, silence=2), "the silent station stops the other one"
    finally:
        lan.close()


def test_an_expired_address_is_given_up(request, tmp_path):
    """The lease cannot be renewed. When it expires, the vehicle is silent until it takes its fixed address: another host may have its
    old one."""
    option = request.config.getoption
    base = option("spare_port_base")
    lan = Lan(base + 3, base)
    heartbeat = lan.mav.heartbeat_encode(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
    pilot, leased, seconds = 50, 77, 8
    lan.answering.add(pilot)
    lan.lease = leased, seconds
    heard = {}
    try:
        with running(option, "ethernet", tmp_path / "output.txt", f"--udp=127.0.0.1:{PORT}", f"--nic={lan.nic}"):
            began, due = time.monotonic(), 0
            while lan.VEHICLE not in heard and (elapsed := time.monotonic() - began) < 40:
                if lan.source and elapsed >= due:
                    due = elapsed + 1
                    lan.send(pilot, heartbeat)
                if lan.receive(0.1):
                    heard.setdefault(lan.source, []).append(time.monotonic())
    finally:
        lan.close()
    assert set(heard) == {leased, lan.VEHICLE}, heard
    assert heard[leased][-1] - heard[leased][0] <= seconds + 1
    # The fixed address is due three seconds after the lease has ended. Otherwise heartbeats are a second apart.
    assert heard[lan.VEHICLE][0] - heard[leased][-1] > 2.5
