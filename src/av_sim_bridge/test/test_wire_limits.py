"""Numbers that no rig, target or clock has: every decoder refuses them, in whatever field, and keeps nothing of them."""

import contextlib
import itertools
import math
import struct
import tracemalloc

import numpy as np
import pytest

from av_sim_bridge.wire import WireError
from av_sim_bridge.wire.audio import AudioFormat, decode_header
from av_sim_bridge.wire.error import FARTHEST_M, LATEST_S
from av_sim_bridge.wire.gimbal import decode_gimbal
from av_sim_bridge.wire.image import EncodedImage, ImageAssembler, decode_fragment, encode_image
from av_sim_bridge.wire.imu import decode_imu
from av_sim_bridge.wire.oracle import decode_oracle, is_oracle
from av_sim_bridge.wire.rig_control import RigControl, decode_rig_control, encode_rig_control
from av_sim_bridge.wire.time_sync import decode_time_sync
from av_sim_bridge.wire.truth import decode_truth

# Decoder, layout, and the fields of a datagram that it accepts.
DATAGRAMS = {
    'truth': (decode_truth, '<4i24f7d', [123456789, 1, 3, 0, *[1.0] * 6, 1.0, 0.0, 0.0, 0.0, *[100.0] * 8, *[0.5] * 6, 12.0,
                                         *[5.0] * 3, 47.0, 8.0, 400.0]),
    'short truth': (decode_truth, '<6i14f4d', [1234567891, 1, 3, 470000000, 80000000, 400000, *[100.0] * 8, *[1.0] * 3,
                                               *[0.1] * 3, *[5.0] * 3, 12.0]),
    'imu': (decode_imu, '<2i1d6f', [1234567898, 7, 12.0, *[1.0] * 6]),
    'gimbal': (decode_gimbal, '<3i1d5f', [1234567951, 1, 7, 12.0, 0.5, -0.5, 0.5, 0.5, 0.01]),
    'time sync': (decode_time_sync, '<2i3q', [123456789, 1, 1_700_000_000_000, 1_700_000_001_000, 1]),
    'oracle': (decode_oracle, '<ii5f', [1, 2, 0.5, 10.0, 20.0, 30.0, 40.0]),
    'rig control': (decode_rig_control, '<5i3f', [1234567950, 1, 3, 1, 3, 0.5, 0.25, 0.125]),
    'audio': (lambda datagram: decode_header(AudioFormat(), datagram), '<4id4x', [1234567960, 28, 3, 1, 12.0]),
    'image': (decode_fragment, '<4id4x', [1234567890, 28, 0, 1, 12.0]),
    'new image': (decode_fragment, '<6id4x', [1234567893, 36, 0, 1, 5, 0, 12.0]),
}
HARMLESS = {'truth': {2, 3}, 'short truth': {2, 3, 4, 5}, 'time sync': {1}, 'oracle': {1}, 'new image': {4, 5}, 'audio': {0}}
ABSURD = {'f': [math.nan, math.inf, -math.inf, 3e38, -3e38], 'd': [math.nan, math.inf, -math.inf, 1e300, -1e300, 1e17],
          'i': [-2**31, 2**31 - 1], 'q': [-2**63, 2**63 - 1]}
# Ids and sequence numbers.
MAY_BE_LARGE = {'truth': {1}, 'short truth': {1}, 'imu': {1}, 'gimbal': {2}, 'rig control': {2}, 'audio': {2}}


def types(layout):
    """The type of each field of a layout."""
    return list(itertools.chain.from_iterable(
        kind * int(count or 1) for count, kind in zip(*[iter(split(layout))] * 2, strict=True) if kind != 'x'))


def split(layout):
    number = ''
    for character in layout[1:]:
        if character.isdigit():
            number += character
        else:
            yield from (number, character)
            number = ''


@pytest.mark.parametrize('name', DATAGRAMS)
def test_every_field_has_its_limits(name):
    decode, layout, fields = DATAGRAMS[name]
    decode(struct.pack(layout, *fields))
    for index, kind in enumerate(types(layout)):
        for value in ABSURD[kind]:
            if index in HARMLESS.get(name, ()) or (value > 0 and kind == 'i' and index in MAY_BE_LARGE.get(name, ())):
                continue
            changed = [*fields[:index], value, *fields[index + 1:]]
            with pytest.raises(WireError):
                decode(struct.pack(layout, *changed))


@pytest.mark.parametrize('name', DATAGRAMS)
def test_numbers_of_any_bits_raise_nothing_but_wire_errors(name, rng):
    """Structured datagrams: the size and most fields are right. What is accepted has finite numbers."""
    decode, layout, fields = DATAGRAMS[name]
    special = {'f': [0.0, -0.0, 1e-45, 1e6, -1e6, math.nan, math.inf], 'd': [0.0, 5e-324, LATEST_S, FARTHEST_M, math.nan, -1.0],
               'i': [0, 1, -1, 255, 256, 2**31 - 1, -2**31], 'q': [0, -1, 2**63 - 1, -2**63]}
    kinds, accepted = types(layout), 0
    for _ in range(1000):
        changed = list(fields)
        for index in rng.integers(0, len(kinds), rng.integers(1, 4)):
            kind = kinds[index]
            raw = struct.unpack('<' + kind, rng.bytes(struct.calcsize('<' + kind)))[0]
            changed[index] = special[kind][rng.integers(len(special[kind]))] if rng.random() < 0.6 else raw
        with contextlib.suppress(WireError):
            decoded = decode(struct.pack(layout, *changed))
            accepted += 1
            for value in vars(decoded[0] if isinstance(decoded, list) and decoded else decoded).values() if decoded else ():
                if isinstance(value, float | np.ndarray):
                    assert np.isfinite(value).all()
    assert accepted


def test_a_truth_far_away_names_what_is_wrong():
    decode, layout, fields = DATAGRAMS['truth']
    fields = [*fields[:29], 1e300, *fields[30:]]
    with pytest.raises(WireError, match=r'truth: position_ned is 1e\+300, not finite or beyond \+-1e\+06'):
        decode(struct.pack(layout, *fields))


@pytest.mark.parametrize('command', [RigControl(1, 1, yaw_rate=1e30), RigControl(1, 1, yaw_rate=math.nan),
                                     RigControl(1, 1, pan=1e3, tilt=0.0), RigControl(-1, 1), RigControl(1, 999)])
def test_an_impossible_command_is_not_sent(command):
    with pytest.raises(WireError, match='rig control'):
        encode_rig_control(command)


@pytest.mark.parametrize(('channels', 'rate'), [(0, 48_000), (65, 48_000), (2, 0), (2, 2**32 - 1)])
def test_formats_of_sound_have_limits(channels, rate):
    with pytest.raises(ValueError, match='channels is'):
        AudioFormat('s16le', channels, rate)


def test_images_in_assembly_have_a_size_limit():
    """Neither one image nor all incomplete ones together take more than `most_bytes`."""
    assembler, piece = ImageAssembler(most_bytes=200_000), bytes(60_000)
    assert assembler.add(decode_fragment(encode_image(EncodedImage(1.0, piece))[0])).data == piece
    tracemalloc.start()
    refused = 0
    for number in range(2000):
        fragments = encode_image(EncodedImage(2.0 + number // 20, bytes(60_000 * 20)))
        try:
            assembler.add(decode_fragment(fragments[number % 20]))
        except WireError as error:
            assert 'more than 200000 bytes' in str(error)
            refused += 1
    del fragments
    memory = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert refused and memory < 400_000
    image = EncodedImage(1e6, piece * 3)
    assert [assembler.add(decode_fragment(datagram)) for datagram in encode_image(image)][-1] == image


def test_an_oracle_of_any_count_takes_no_more_than_its_datagram():
    assert not is_oracle(struct.pack('<i', 2**31 - 1) + bytes(24))
    with pytest.raises(WireError):
        decode_oracle(struct.pack('<i', 2**31 - 1) + bytes(24))
