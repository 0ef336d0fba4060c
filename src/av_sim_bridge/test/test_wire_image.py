"""Image fragments: both headers, order, loss, bounded memory, garbage."""

import contextlib
import itertools
import struct

import pytest
from fake_rflysim import image_datagrams

from av_sim_bridge.wire import WireError
from av_sim_bridge.wire.image import EncodedImage, ImageAssembler, decode_fragment, encode_image


def assemble(assembler, datagrams):
    return [image for datagram in datagrams if (image := assembler.add(decode_fragment(datagram)))]


def test_headers_follow_rflysim(rng):
    data = rng.bytes(130_000)
    assert encode_image(EncodedImage(2.5, data)) == image_datagrams(data, 2.5)


@pytest.mark.parametrize('frame_id', [None, 4])
def test_fragments_in_any_order_make_the_image(rng, frame_id):
    image = EncodedImage(1.25, rng.bytes(250_000))
    datagrams = image_datagrams(image.data, image.time, frame_id)
    assembler = ImageAssembler()
    assert assemble(assembler, [datagrams[n] for n in rng.permutation(len(datagrams))]) == [image]
    assert assembler.incomplete == 0


def test_a_lost_fragment_drops_one_image_and_is_counted(rng):
    images = [EncodedImage(n / 15, rng.bytes(100_000)) for n in range(5)]
    datagrams = [encode_image(image) for image in images]
    del datagrams[2][1]
    assembler = ImageAssembler()
    assert assemble(assembler, itertools.chain(*datagrams)) == images[:2] + images[3:]
    assert assembler.incomplete == 1


def test_repeated_fragments_do_not_repeat_the_image(rng):
    image = EncodedImage(1.0, rng.bytes(100_000))
    assembler = ImageAssembler()
    assert assemble(assembler, encode_image(image) * 2) == [image]


def test_memory_is_bounded_when_no_image_is_ever_complete(rng):
    assembler = ImageAssembler()
    for n in range(1000):
        assemble(assembler, encode_image(EncodedImage(float(n), rng.bytes(70_000)))[:1])
    assert len(assembler._partial) == 4
    assert assembler.incomplete == 996


def test_contradicting_packet_counts_are_refused():
    first = struct.pack('<4i1d', 1234567890, 28, 0, 3, 1.0) + bytes(4)
    second = struct.pack('<4i1d', 1234567890, 28, 1, 2, 1.0) + bytes(4)
    assembler = ImageAssembler()
    assembler.add(decode_fragment(first))
    with pytest.raises(WireError, match='2 packets'):
        assembler.add(decode_fragment(second))


@pytest.mark.parametrize(('fields', 'message'), [
    ((1, 28, 0, 1, 0.0), 'magic 1'),
    ((1234567890, 99, 0, 1, 0.0), 'header states 99'),
    ((1234567890, 28, 3, 3, 0.0), 'packet 3 of 3'),
    ((1234567890, 28, 0, 10**9, 0.0), 'packet 0 of 1000000000'),
    ((1234567890, 28, 0, 1, float('nan')), 'time is nan'),
])
def test_bad_headers_are_named(fields, message):
    with pytest.raises(WireError, match=message):
        decode_fragment(struct.pack('<4i1d', *fields) + bytes(4))


def test_garbage_raises_nothing_but_wire_errors(rng):
    assembler = ImageAssembler()
    good = image_datagrams(rng.bytes(100), 1.0, 3)[0]
    for n in range(2000):
        datagram = bytearray(good if n % 2 else rng.bytes(int(rng.integers(0, 200))))
        for position in rng.integers(0, 40, 3):
            if position < len(datagram):
                datagram[position] = rng.integers(256)
        with contextlib.suppress(WireError):
            assembler.add(decode_fragment(bytes(datagram)))
