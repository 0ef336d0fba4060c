"""Every codec against RFlySim's documented byte offsets, round trips, and garbage."""

import contextlib
import struct

import numpy as np
import pytest
from fake_rflysim import short_truth_datagram
from scipy.spatial.transform import Rotation

from av_sim_bridge.wire import WireError
from av_sim_bridge.wire.gimbal import GimbalSample, decode_gimbal, encode_gimbal
from av_sim_bridge.wire.imu import ImuSample, decode_imu, encode_imu
from av_sim_bridge.wire.oracle import OracleBox, decode_oracle, encode_oracle, is_oracle
from av_sim_bridge.wire.ports import Ports
from av_sim_bridge.wire.rig_control import RigControl, decode_rig_control, encode_rig_control
from av_sim_bridge.wire.time_sync import TimeSync, decode_time_sync, encode_time_sync
from av_sim_bridge.wire.truth import VehicleTruth, decode_truth, encode_truth

EULER = np.array([0.1, -0.2, 2.5])
TRUTH = VehicleTruth(
    copter_id=2, vehicle_type=3, time=12.345678901, position_ned=np.array([1.5, -2.25, -30.0]),
    velocity_ned=np.array([3.0, 4.0, -0.5]), euler_rad=EULER,
    quaternion_wxyz=Rotation.from_euler('ZYX', EULER[::-1]).as_quat()[[3, 0, 1, 2]],
    motor_rpm=np.arange(8) * 1000.0, acceleration_frd=np.array([0.1, 0.2, -9.8]), rate_frd=np.array([0.01, 0.02, 0.03]),
    gps=np.array([47.5, 8.25, 400.125]))
SHORT_TRUTH = short_truth_datagram(2, TRUTH.time, TRUTH.position_ned, TRUTH.velocity_ned, EULER, TRUTH.motor_rpm,
                                   (475_000_000, 82_500_000, 400_125))
BOXES = [OracleBox(2, 0.75, 10.0, 20.0, 30.5, 40.5), OracleBox(3, 0.0, 0.0, 0.0, 1.0, 1.0)]


def test_long_truth_lies_at_the_documented_offsets():
    data = encode_truth(TRUTH)
    assert len(data) == 168
    assert struct.unpack_from('<3i', data) == (123456789, 2, 3)
    for offset, layout, expected in [(16, '<3f', TRUTH.velocity_ned), (28, '<3f', EULER),
                                     (40, '<4f', TRUTH.quaternion_wxyz), (56, '<8f', TRUTH.motor_rpm),
                                     (88, '<3f', TRUTH.acceleration_frd), (100, '<3f', TRUTH.rate_frd),
                                     (112, '<d', [TRUTH.time]), (120, '<3d', TRUTH.position_ned),
                                     (144, '<3d', TRUTH.gps)]:
        np.testing.assert_allclose(struct.unpack_from(layout, data, offset), expected, rtol=1e-6)


@pytest.mark.parametrize('short', [False, True])
def test_truth_round_trip(short):
    truth = decode_truth(SHORT_TRUTH if short else encode_truth(TRUTH))
    assert (truth.copter_id, truth.vehicle_type, truth.time) == (2, 3, TRUTH.time)
    for name in ('position_ned', 'velocity_ned', 'euler_rad', 'quaternion_wxyz', 'motor_rpm', 'gps'):
        np.testing.assert_allclose(getattr(truth, name), getattr(TRUTH, name), atol=1e-6, err_msg=name)
    assert truth.rate_frd.any() != short


def test_imu_round_trip_and_size():
    sample = ImuSample(7, 1.25, np.array([0.5, 0.25, -9.75]), np.array([0.125, 0.0, -1.0]))
    data = encode_imu(sample)
    decoded = decode_imu(data)
    assert len(data) == 40
    assert (decoded.sequence, decoded.time) == (7, 1.25)
    np.testing.assert_array_equal(decoded.acceleration_frd, sample.acceleration_frd)
    np.testing.assert_array_equal(decoded.rate_frd, sample.rate_frd)


def test_gimbal_round_trip_and_size():
    sample = GimbalSample(7, 1.25, np.array([0.5, -0.5, 0.5, 0.5]), 0.25)
    data = encode_gimbal(sample)
    decoded = decode_gimbal(data)
    assert len(data) == 40
    assert (decoded.sequence, decoded.time, decoded.variance) == (7, 1.25, 0.25)
    np.testing.assert_array_equal(decoded.orientation_wxyz, sample.orientation_wxyz)


def test_time_sync_round_trip_and_order():
    sync = TimeSync(1, 1_700_000_000_000, 1_700_000_012_345, 17)
    data = encode_time_sync(sync)
    assert len(data) == 32
    assert decode_time_sync(data) == sync
    with pytest.raises(WireError, match='before the start'):
        decode_time_sync(encode_time_sync(TimeSync(1, 2000, 1000, 1)))


def test_oracle_round_trip_and_nothing_seen():
    assert decode_oracle(encode_oracle(BOXES)) == BOXES
    assert decode_oracle(encode_oracle([])) == []


@pytest.mark.parametrize(('box', 'message'), [
    (OracleBox(1, 1.5, 0, 0, 1, 1), 'is 1.5'),
    (OracleBox(1, 0.5, 5, 0, 1, 1), 'are swapped'),
    (OracleBox(1, float('nan'), 0, 0, 1, 1), 'not finite'),
])
def test_oracle_names_what_is_wrong(box, message):
    with pytest.raises(WireError, match=message):
        decode_oracle(encode_oracle([box]))


@pytest.mark.parametrize('command', [
    RigControl(5, 1, yaw_rate=-0.5), RigControl(6, 2, pan=0.25, tilt=-0.125), RigControl(7, 0),
    RigControl(8, 1, 0.5, 1.5, 0.25)])
def test_rig_control_round_trip(command):
    assert decode_rig_control(encode_rig_control(command)) == command


def test_rig_control_of_another_version_is_refused():
    data = bytearray(encode_rig_control(RigControl(1, 1, 0.5)))
    struct.pack_into('<i', data, 4, 99)
    with pytest.raises(WireError, match='version 99'):
        decode_rig_control(bytes(data))


CODECS = {
    'truth': (decode_truth, encode_truth(TRUTH)), 'short truth': (decode_truth, SHORT_TRUTH),
    'gimbal': (decode_gimbal, encode_gimbal(GimbalSample(1, 1.0, np.array([1.0, 0.0, 0.0, 0.0]), 1e-6))),
    'imu': (decode_imu, encode_imu(ImuSample(1, 1.0, np.zeros(3), np.zeros(3)))),
    'time sync': (decode_time_sync, encode_time_sync(TimeSync(1, 1, 2, 3))),
    'oracle': (decode_oracle, encode_oracle(BOXES)),
    'rig control': (decode_rig_control, encode_rig_control(RigControl(1, 1, 0.5, 0.5, 0.5))),
}


@pytest.mark.parametrize('name', CODECS)
def test_wrong_length_and_magic_are_wire_errors(name):
    decode, good = CODECS[name]
    for bad in (b'', good[:-1], good + b'\0', good + bytes(65_507 - len(good)), b'\xff' * 4 + good[4:]):
        with pytest.raises(WireError):
            decode(bad)


@pytest.mark.parametrize('name', CODECS)
def test_garbage_raises_nothing_but_wire_errors(name, rng):
    decode, good = CODECS[name]
    for _ in range(500):
        datagram = bytearray(rng.bytes(int(rng.integers(0, 300))) if rng.random() < 0.5 else good)
        for position in rng.integers(0, max(len(datagram), 1), 4):
            if datagram:
                datagram[position] = rng.integers(256)
        with contextlib.suppress(WireError):
            decode(bytes(datagram))


def test_an_image_fragment_is_not_an_oracle():
    assert not is_oracle(struct.pack('<4i1d', 1234567890, 124, 0, 1, 0.5) + bytes(100))


def test_ports_of_a_second_rig():
    ports = Ports().shifted(100)
    assert (ports.audio, ports.control) == (28103, 30200)
