"""The audio stream against a known sample sequence: loss, order, alignment, clock, garbage."""

import contextlib

import numpy as np
import pytest

from av_sim_bridge.receiving.audio_decoder import AudioDecoder
from av_sim_bridge.wire import WireError
from av_sim_bridge.wire.audio import AudioFormat, AudioHeader, encode_audio

RATE = 48_000
FRAMES = 1600


def ramp(frames, channels=2):
    """Samples that tell their own index and channel: an exact int16 value for each."""
    index = np.arange(frames)[:, np.newaxis]
    return ((index * channels + np.arange(channels)) % 30_000) / 32768.0


def datagrams(layout, count, frames=FRAMES, header=False):
    samples = ramp(count * frames, layout.channels)
    return [encode_audio(layout, samples[n * frames:(n + 1) * frames],
                         AudioHeader(n, frames, n * frames / RATE) if header else None) for n in range(count)]


def arrivals(count, jitter, rng):
    """Arrival of each datagram: its last sample's time, a constant delay and a positive jitter."""
    return 100.0 + (np.arange(count) + 1) * FRAMES / RATE + jitter * rng.random(count)


def check(blocks, layout=AudioFormat()):  # noqa: B008 (frozen)
    """Every block must hold exactly the samples that its index promises."""
    expected = ramp(max(block.first_sample + len(block.samples) for block in blocks), layout.channels)
    for block in blocks:
        promised = expected[block.first_sample:][:len(block.samples)]
        np.testing.assert_array_equal(layout.to_float(block.samples), promised)


def decode(decoder, stream):
    return [block for datagram, arrival in stream for block in decoder.decode(datagram, arrival)]


@pytest.mark.parametrize('sample_format', ['s16le', 'f32le'])
@pytest.mark.parametrize('channels', [1, 2, 4])
@pytest.mark.parametrize('header', [False, True])
def test_all_samples_arrive_in_their_channels(rng, sample_format, channels, header):
    layout = AudioFormat(sample_format, channels)
    decoder = AudioDecoder(layout)
    blocks = decode(decoder, zip(datagrams(layout, 40, header=header), arrivals(40, 0.01, rng), strict=True))
    check(blocks, layout)
    assert sum(len(block.samples) for block in blocks) == 40 * FRAMES
    assert decoder.counts.lost == 0


def test_full_scale_survives_int16():
    layout = AudioFormat('s16le', 1)
    samples = layout.to_float(layout.decode(layout.encode(np.array([[1.5], [1.0], [-1.0], [-2.0], [0.5]]))))
    np.testing.assert_allclose(samples[:, 0], [1 - 2**-15, 1 - 2**-15, -1, -1, 0.5])


def test_partial_frames_are_carried_over(rng):
    layout = AudioFormat()
    data = layout.encode(ramp(20 * FRAMES))
    cuts = np.cumsum(rng.integers(6390, 6411, 18))
    pieces = [piece for piece in np.split(np.frombuffer(data, np.uint8), cuts) if len(piece)]
    ends = np.cumsum([len(piece) for piece in pieces]) / (4 * RATE)
    stream = [(piece.tobytes(), 10 + end) for piece, end in zip(pieces, ends, strict=True)]
    blocks = decode(AudioDecoder(layout), stream)
    check(blocks)
    assert sum(len(block.samples) for block in blocks) == 20 * FRAMES


@pytest.mark.parametrize('lost', [[30], [30, 31, 32], [40, 90, 130]])
@pytest.mark.parametrize('kind', ['header', 'bare', 'bare, cut inside frames'])
def test_lost_datagrams_are_counted_and_never_swap_channels(rng, lost, kind):
    layout = AudioFormat()
    if kind == 'header':
        sent = datagrams(layout, 200, header=True)
    else:
        data = layout.encode(ramp(201 * FRAMES))
        size = FRAMES * 4 + 2 * (kind != 'bare')
        sent = [data[n * size:(n + 1) * size] for n in range(200)]
    times = 100.0 + np.cumsum([(len(d) - 24 * (kind == 'header')) / (4 * RATE) for d in sent]) + 0.012 * rng.random(200)
    decoder = AudioDecoder(layout)
    blocks = decode(decoder, [(d, t) for n, (d, t) in enumerate(zip(sent, times, strict=True)) if n not in lost])
    if kind == 'bare':   # what is passed on before the loss is certain is numbered too low, for a second
        lag = FRAMES * len(lost)
        settled = [block for block in blocks if block.first_sample > (lost[-1] + 35) * FRAMES]
        assert len(settled) > 20
        check(settled, layout)
        for block in blocks:
            samples = np.rint(layout.to_float(block.samples) * 32768).astype(int)
            assert (samples[:, 0] % 2 == 0).all() and (samples[:, 1] % 2 == 1).all()
            assert 0 <= (samples[0, 0] // 2 - block.first_sample) % 15_000 <= lag
    else:
        check(blocks, layout)
    assert decoder.counts.lost == len(lost)
    assert abs(decoder.counts.lost_frames - len(lost) * FRAMES) <= 2 * len(lost)
    assert abs(blocks[-1].first_sample + len(blocks[-1].samples) - 200 * FRAMES) <= 100


@pytest.mark.parametrize('sizes', ['first is long', 'first is short', 'any'])
def test_a_loss_among_datagrams_of_different_lengths_never_swaps_channels(rng, sizes):
    """Whole frames each, as all senders have them that cut nothing: what was lost were frames, too."""
    layout = AudioFormat()
    lengths = 4 * (rng.integers(200, 5000, 120) if sizes == 'any' else np.full(250, FRAMES))
    lengths[0] = {'first is long': 64_000, 'first is short': 4}.get(sizes, lengths[0])
    ends = np.cumsum(lengths)
    times = 100.0 + ends / (4 * RATE) + 0.002 * rng.random(len(ends))
    data, decoder, blocks = layout.encode(ramp(ends[-1] // 4)), AudioDecoder(layout), []
    for number, (end, length, arrival) in enumerate(zip(ends, lengths, times, strict=True)):
        if number not in (60, 61):
            blocks += decoder.decode(data[end - length:end], arrival)
    found = [np.rint(layout.to_float(block.samples) * 32768).astype(int) for block in blocks]
    assert sum(map(len, found)) == (ends[-1] - lengths[60] - lengths[61]) // 4
    assert all((samples[:, 0] % 2 == 0).all() and (samples[:, 1] == samples[:, 0] + 1).all() for samples in found)
    begins = np.array([(samples[0, 0] // 2, block.first_sample) for samples, block in zip(found, blocks, strict=True)])
    errors = (begins[:, 0] - begins[:, 1] + 7500) % 15_000 - 7500
    assert not errors[:50].any() and np.abs(errors[-20:]).max() <= 0.002 * RATE


@pytest.mark.parametrize('cut', [0, 2])
def test_a_sender_that_catches_up_after_a_long_delay_takes_the_loss_back(rng, cut):
    """Numbers and channels are as before, also of datagrams that end within a frame."""
    layout, size = AudioFormat(), 4 * FRAMES + cut
    times = arrivals(200, 0.002, rng)
    times[60:130] += 0.1               # three datagrams late for over two seconds, then in time again
    times = np.maximum.accumulate(times)
    decoder, data = AudioDecoder(layout), layout.encode(ramp(201 * FRAMES))
    blocks = decode(decoder, [(data[n * size:(n + 1) * size], time) for n, time in enumerate(times)])
    assert 200 * size // 4 - sum(len(block.samples) for block in blocks) <= 2 * cut    # no sound is thrown away
    check([block for block in blocks if block.arrival < times[60] or block.arrival > times[130] + 0.1])
    assert (decoder.counts.lost, decoder.counts.lost_frames) == (0, 0)


def test_a_late_burst_is_not_a_loss(rng):
    layout = AudioFormat()
    times = arrivals(120, 0.005, rng)
    times[40:60] = times[60] + 1e-4 * np.arange(20)    # the network stalls for 0.7 s, then delivers all at once
    decoder = AudioDecoder(layout)
    blocks = decode(decoder, zip(datagrams(layout, 120), times, strict=True))
    check(blocks)
    assert decoder.counts.lost == 0
    assert sum(len(block.samples) for block in blocks) == 120 * FRAMES


def test_reordered_datagrams_are_put_in_order():
    layout = AudioFormat()
    sent = datagrams(layout, 20, header=True)
    sent[5], sent[6] = sent[6], sent[5]
    decoder = AudioDecoder(layout)
    blocks = decode(decoder, zip(sent, range(20), strict=True))
    check(blocks)
    assert [block.first_sample for block in blocks] == [n * FRAMES for n in range(20)]
    assert (decoder.counts.reordered, decoder.counts.lost) == (1, 0)


def test_a_datagram_that_comes_too_late_is_counted_and_dropped():
    layout = AudioFormat()
    sent = datagrams(layout, 20, header=True)
    late = sent.pop(5)
    sent.insert(12, late)
    decoder = AudioDecoder(layout)
    blocks = decode(decoder, zip(sent, range(20), strict=True))
    check(blocks)
    assert (decoder.counts.reordered, decoder.counts.lost) == (1, 1)
    assert sum(len(block.samples) for block in blocks) == 19 * FRAMES


@pytest.mark.parametrize(('order', 'taken'), [([0, 0, 1, 2, 3, 4], [0, 1, 2, 3, 4]), ([1, 0, 2, 3, 4], [1, 2, 3, 4])])
def test_the_first_datagram_twice_or_late_is_no_restart(order, taken):
    sent, decoder = datagrams(AudioFormat(), 5, header=True), AudioDecoder(AudioFormat())
    blocks = decode(decoder, [(sent[number], 0.0) for number in order])
    assert [block.samples.tobytes() for block in blocks] == [sent[number][24:] for number in taken]
    assert [block.first_sample for block in blocks] == [n * FRAMES for n in range(len(taken))]
    assert (decoder.counts.reordered, decoder.counts.lost, decoder.counts.restarts) == (1, 0, 0)


def test_a_restarted_sender_continues_the_index():
    layout = AudioFormat()
    sent = datagrams(layout, 10, header=True)
    decoder = AudioDecoder(layout)
    blocks = decode(decoder, zip(sent + sent, range(20), strict=True))
    assert [block.first_sample for block in blocks] == [n * FRAMES for n in range(20)]
    assert decoder.counts.restarts == 1


def test_samples_of_the_future_are_refused(rng):
    layout = AudioFormat()
    sent = list(zip(datagrams(layout, 100), arrivals(100, 0.002, rng), strict=True))
    decoder = AudioDecoder(layout)
    good = decode(decoder, sent[:60])
    with pytest.raises(WireError, match='before its samples'):
        decoder.decode(rng.bytes(6400), sent[59][1] + 0.005)
    check(good + decode(decoder, sent[60:]))


@pytest.mark.parametrize('sample_format', ['s16le', 'f32le'])
def test_garbage_raises_nothing_but_wire_errors(rng, sample_format):
    layout = AudioFormat(sample_format)
    sent = datagrams(layout, 400, header=True)
    decoder, refused = AudioDecoder(layout), 0
    blocks = decode(decoder, [(sent[0], 0.0)])
    for n in range(1, 400):
        try:
            decoder.decode(rng.bytes(int(rng.integers(0, 65_507))), n * 0.03)
        except WireError:
            refused += 1
        blocks += decoder.decode(sent[n], n * 0.03 + 0.01)
    check(blocks, layout)
    assert refused == 399


def test_float_garbage_is_refused(rng):
    with pytest.raises(WireError, match='float samples'):
        AudioDecoder(AudioFormat('f32le')).decode(rng.bytes(8000), 0.0)


@pytest.mark.parametrize('bad', [30, 33, 36])
def test_a_datagram_that_is_no_sound_costs_only_itself(bad):
    """Also while others are held back, as they end within frames and one is lost."""
    layout, size, lost = AudioFormat('f32le'), 8 * FRAMES + 4, 30
    data = layout.encode(ramp(101 * FRAMES))
    decoder, blocks = AudioDecoder(layout), []
    for number in range(100):
        datagram = np.full(size // 4, np.nan, '<f4').tobytes() if number == bad else data[number * size:(number + 1) * size]
        if number == lost != bad:
            continue
        with contextlib.suppress(WireError):
            blocks += decoder.decode(datagram, 10.0 + (number + 1) * size / (8 * RATE))
    check(blocks, layout)
    frames = 100 * size / 8 - sum(len(block.samples) for block in blocks)
    assert frames <= 2 * (FRAMES + 3) and abs(decoder.counts.lost_frames - frames) <= 4
    assert blocks[-1].first_sample + len(blocks[-1].samples) == 100 * size // 8


def test_datagrams_shorter_than_a_frame_keep_their_channels_behind_one_that_is_no_sound():
    layout, size = AudioFormat('f32le', 32), 44
    data, rate = layout.encode(ramp(400, 32)), layout.frame_bytes * RATE
    decoder, blocks = AudioDecoder(layout), []
    for number in range(len(data) // size):
        datagram = np.full(11, np.nan, '<f4').tobytes() if number == 500 else data[number * size:(number + 1) * size]
        with contextlib.suppress(WireError):
            blocks += decoder.decode(datagram, 10.0 + (number + 1) * size / rate)
    check(blocks, layout)
    assert sum(len(block.samples) for block in blocks) >= 396


def test_a_header_that_contradicts_its_datagram_is_named():
    layout = AudioFormat()
    datagram = encode_audio(layout, ramp(10), AudioHeader(0, 10, 0.0))
    with pytest.raises(WireError, match='header states'):
        AudioDecoder(layout).decode(datagram + b'\0\0', 0.0)


def test_too_many_channels_for_a_datagram_are_an_error():
    with pytest.raises(ValueError, match='do not fit'):
        encode_audio(AudioFormat('f32le', 16), np.zeros((1600, 16)))


def test_unknown_sample_format_is_named():
    with pytest.raises(ValueError, match="'u8'.*s16le, f32le"):
        AudioFormat('u8')


@pytest.mark.parametrize('size', [1, 3])
def test_tiny_datagrams_of_a_stream_without_headers_are_not_kept_for_ever(size):
    """A little too slow for the stream, so that it lags ever more and no loss explains it."""
    decoder, rate = AudioDecoder(AudioFormat()), 192_000.0
    for number in range(20_000):
        with contextlib.suppress(WireError):
            decoder.decode(bytes(size), 10.0 + 1.01 * number * size / rate)
    assert len(decoder._stream._held) <= 500 and len(decoder._stream._recent) <= 500
