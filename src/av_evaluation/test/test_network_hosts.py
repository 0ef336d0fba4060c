"""Rigs as hosts: what a medium delivers, what pictures say, and that light rigs say what simulated rigs would."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from av_evaluation.hosts.light_rig import message_of
from av_evaluation.hosts.pictures import Picture, agreement, phase, run_of
from av_evaluation.hosts.switch import Medium, without_checksum
from av_evaluation.network import cases
from av_network.messages import LEAST_INFORMATION, LEAST_SIGMA, report_of

EVERYBODY = b'\xff' * 6


def frame(to, sender, rest=b'\x08\x06'):
    """An Ethernet frame; hosts are numbers."""
    address = EVERYBODY if to is None else bytes([2, 0, 0, 0, 0, to])
    return address + bytes([2, 0, 0, 0, 0, sender]) + rest


def test_frames_go_to_everybody_or_to_the_known_host():
    """And never back; a host is known from its first frame on. All are late by the delay."""
    medium = Medium(3)
    medium.impair(0.2, 0.0)
    assert medium.deliveries(frame(1, 0), 0, 5.0) == [(5.2, 1), (5.2, 2)]
    assert medium.deliveries(frame(None, 1), 1, 6.0) == [(6.2, 0), (6.2, 2)]
    assert medium.deliveries(frame(1, 0), 0, 7.0) == [(7.2, 1)]


def test_sides_do_not_hear_each_other_until_healed():
    medium = Medium(4)
    medium.part([{0, 1}, {2, 3}])
    assert medium.deliveries(frame(None, 0), 0, 0.0) == [(0.0, 1)]
    assert medium.deliveries(frame(None, 2), 2, 0.0) == [(0.0, 3)]
    assert medium.deliveries(frame(2, 0), 0, 0.0) == []
    medium.part(())
    assert medium.deliveries(frame(2, 0), 0, 0.0) == [(0.0, 2)]


def test_each_receiver_loses_a_share_of_the_frames_independently():
    """Counts within 4 standard deviations of the binomial distribution, for each receiver and for both."""
    medium, count = Medium(3, seed=4), 4000
    medium.impair(0.0, 0.2)
    found = [{host for _, host in medium.deliveries(frame(None, 0), 0, 0.0)} for _ in range(count)]
    for received, share in ((sum(1 in each for each in found), 0.8), (sum(2 in each for each in found), 0.8),
                            (sum(len(each) == 2 for each in found), 0.64)):
        assert abs(received - count * share) < 4.0 * math.sqrt(count * share * (1.0 - share))


def packet(protocol, fragment=0, words=5):
    """An Ethernet frame with IPv4 of so many words of header, and 16 bytes of payload."""
    header = struct.pack('!BBHHHBBH8s', 0x40 | words, 0, 4 * words + 16, 1, fragment, 64, protocol, 0, bytes(8))
    return frame(1, 0, b'\x08\x00') + header + bytes(4 * (words - 5)) + bytes(range(1, 17))


@pytest.mark.parametrize('words', [5, 7])
def test_the_checksum_of_udp_is_left_out(words):
    """It is at byte 6 of the UDP header (RFC 768), which begins behind that of IP (RFC 791), and nothing else changes."""
    given = packet(17, words=words)
    at = 14 + 4 * words + 6
    assert without_checksum(given) == given[:at] + b'\0\0' + given[at + 2:] != given


@pytest.mark.parametrize('given', [packet(6), packet(17, fragment=185), frame(1, 0), packet(17)[:30]])
def test_other_frames_are_not_changed(given):
    """TCP, a later fragment of UDP, which has no header, ARP, and a frame that is cut off."""
    assert without_checksum(given) == given


def test_a_light_rig_says_what_the_simulated_one_would():
    """The report that a node reads from the message is that of the simulation, at another time."""
    simulation = cases.square(3, 2, 2, 3.0)
    for _, report in simulation.arrivals():
        read = report_of(message_of(report, 1000.0), report.rig, report.position, 0.0)
        assert read.time == pytest.approx(1000.0 + report.time, abs=1e-8) and len(read.sightings) == len(report.sightings)
        for one, other in zip(read.sightings, report.sightings, strict=True):
            assert (one.id, one.by_sound, one.resolved) == (other.id, other.by_sound, other.resolved)
            assert (one.azimuth, one.elevation) == pytest.approx((other.azimuth, other.elevation), abs=1e-6)
            known = np.linalg.inv(np.linalg.inv(other.covariance) + LEAST_INFORMATION * np.eye(2))
            assert np.allclose(one.covariance, known + LEAST_SIGMA**2 * np.eye(2), rtol=1e-5)
            assert one.measured == pytest.approx(1000.0 + other.measured, abs=1e-8)


def pictures_of(simulation, without=(math.inf, -math.inf), name=7):
    """Pictures each 0.1 s that hold the true place of the first drone 0.05 s earlier, except in a time."""
    found = []
    for time in np.arange(0.0, simulation.duration, 0.1):
        before, after = (simulation.truth(time + step)[0] for step in (-0.01, 0.01))
        true = [name, *simulation.truth(time)[0], *((after - before) / 0.02)]
        found.append(Picture(time, [] if without[0] <= time < without[1] else [true]))
    return found


def test_figures_of_a_node_that_sees_one_of_two_drones():
    simulation = cases.square(3, 2, 2, 10.0)
    found = phase(run_of(pictures_of(simulation), simulation), 2.0, 8.0)
    assert (found.missed, found.false) == (1.0, 0.0) and found.error < 0.1
    stale = phase(run_of([Picture(0.0, pictures_of(simulation)[0].targets)], simulation), 2.0, 8.0)
    assert stale.missed == 2.0 and math.isnan(stale.error)


def test_pictures_agree_from_the_last_difference_on():
    """One of the nodes has the drone back 1.5 s after the partition, with another id: a track of it is lost."""
    simulation = cases.square(3, 2, 1, 12.0)
    whole = run_of(pictures_of(simulation), simulation)
    late = run_of(pictures_of(simulation, (5.0, 8.5)), simulation)
    found = agreement([whole, late], 4.0, 7.0)
    assert found.lost == 0 and (found.first, found.healed) == pytest.approx((1.5, 1.5), abs=0.15)
    assert found.apart == pytest.approx(1.5 / 5.0, abs=0.03)
    renamed = run_of(pictures_of(simulation)[:45] + pictures_of(simulation, name=8)[45:], simulation)
    assert agreement([whole, renamed], 4.0, 7.0).lost == 1
