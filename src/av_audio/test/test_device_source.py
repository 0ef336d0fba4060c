"""What DeviceSource makes of the blocks of its capturing process, with a clock that is known."""

import sys
import time

import numpy as np
import pytest

from av_audio import DeviceSource, RingBuffer, device_source
from av_audio.device_process import HEADER

RATE, BLOCK = 48_000, 1600


class Capture:
    """A source that is fed by hand, as its thread would."""

    def __init__(self):
        self.now = 1000.0
        self.source = DeviceSource('', RATE, now=lambda: self.now)
        self.source._buffer = self.buffer = RingBuffer(2)

    def take(self, overflowed=False, later=0.0):
        """A block that was captured right after the one before, or so much later in s; the index of its first sample."""
        self.now += BLOCK / RATE + later
        self.source._take(HEADER.pack(BLOCK / RATE, overflowed) + np.full((BLOCK, 2), 0.25, np.float32).tobytes())
        first, samples = self.buffer.read()
        assert len(samples) in (0, BLOCK)
        return first


def test_overflows_are_counted_and_what_was_lost_is_a_gap():
    capture = Capture()
    firsts = [capture.take() for _ in range(60)]
    assert np.all(np.diff(firsts[20:]) == BLOCK)
    after = capture.take(overflowed=True, later=0.1)
    assert capture.source.overflows == 1
    assert abs(after - firsts[-1] - BLOCK - 0.1 * RATE) < 0.002 * RATE
    assert capture.take() == after + BLOCK
    assert abs(capture.source.time_of(after) - (capture.now - 2 * BLOCK / RATE)) < 2e-3


def test_what_is_missed_while_it_is_stopped_is_a_gap(monkeypatch):
    capture = Capture()
    firsts = [capture.take() for _ in range(60)]
    for step in ('_open', '_run', '_end_process'):
        monkeypatch.setattr(capture.source, step, lambda: None)
    capture.source.stop()
    capture.source.start(capture.buffer)
    after = capture.take(later=0.6)
    assert abs(after - firsts[-1] - BLOCK - 0.6 * RATE) < 0.002 * RATE and not capture.source.lost
    assert abs(capture.source.time_of(after) - (capture.now - BLOCK / RATE)) < 2e-3


def test_an_overflow_before_the_clock_is_known_is_counted():
    """As of simulated time that has not begun."""
    capture = Capture()
    capture.now = -10.0
    assert capture.take() == capture.take(overflowed=True) == 0
    assert capture.source.overflows == 1


def test_a_device_is_opened_again_after_there_was_no_memory_for_it(monkeypatch):
    attempts = [OSError('Cannot allocate memory'), None]

    def open_again():
        if error := attempts.pop(0):
            raise error

    source = DeviceSource('', RATE)
    monkeypatch.setattr(device_source, 'RETRY_S', 0.01)
    monkeypatch.setattr(source, '_open', open_again)
    monkeypatch.setattr(source, '_end_process', lambda: None)
    source._reopen()
    assert source.reopened == 1


def test_warnings_of_drivers_without_end_do_not_stop_the_capture(monkeypatch):
    monkeypatch.setattr(device_source, 'OPEN_WITHIN_S', 20.0)
    source = DeviceSource('', RATE)
    program = 'import sys; sys.stderr.write(200_000 * "w" + "\\nno card"); sys.stderr.flush(); {}'
    source._command = [sys.executable, '-c', program.format('print("ready", flush=True)')]
    source._process = source._open()
    source._end_process()
    source._command = [sys.executable, '-c', program.format('sys.exit(1)')]
    with pytest.raises(ValueError, match='^no card$'):
        source._open()


def test_a_device_that_is_lost_can_be_closed(monkeypatch):
    monkeypatch.setattr(device_source, 'RETRY_S', 60.0)
    source = DeviceSource('', RATE)
    source._command = [sys.executable, '-c', 'print("ready", flush=True)']
    source.start(RingBuffer(2))
    end = time.monotonic() + 60.0
    while not source.lost and time.monotonic() < end:
        time.sleep(0.01)
    source.stop()
    assert source.lost


def test_an_overflow_that_lost_nothing_leaves_no_gap():
    capture = Capture()
    firsts = [capture.take() for _ in range(60)]
    assert capture.take(overflowed=True) == firsts[-1] + BLOCK
    assert capture.source.overflows == 1


def test_a_block_that_only_comes_late_is_no_gap():
    capture = Capture()
    firsts = [capture.take() for _ in range(60)]
    assert capture.take(later=0.3) == firsts[-1] + BLOCK
    assert capture.source.overflows == 0


def times_of_blocks(seconds, ppm=0.0, late=lambda k, rng: rng.exponential(0.003)):
    """A source whose blocks come late by some s; times (n,) of its blocks in s, and the true ones."""
    rng, arrival = np.random.default_rng(0), [0.0]
    source = DeviceSource('', RATE, now=lambda: arrival[0])
    source._buffer = RingBuffer(2)
    times, true = [], []
    for k in range(round(seconds * RATE / BLOCK)):
        true.append(1.7e9 + k * BLOCK / RATE * (1.0 + 1e-6 * ppm))
        arrival[0] = true[-1] + BLOCK / RATE + late(k, rng)
        source._take(HEADER.pack(BLOCK / RATE, False) + bytes(8 * BLOCK))
        times.append(source.time_of(k * BLOCK))
    return source, np.array(times), np.array(true)


@pytest.mark.parametrize('ppm', [-120.0, 0.0, 85.0])
@pytest.mark.parametrize('jitter_s', [0.0003, 0.003])
def test_times_are_regular_and_drift_is_found(ppm, jitter_s):
    source, times, true = times_of_blocks(120.0, ppm, lambda k, rng: rng.exponential(jitter_s))
    settled = slice(len(times) // 2, None)
    assert np.abs(np.diff(times) - BLOCK / RATE).max() < 2e-3 and np.abs(np.diff(times) - BLOCK / RATE)[60:].max() < 2e-4
    assert np.abs((times - true)[settled]).max() < 1.5e-3
    assert source.ppm == pytest.approx(ppm, abs=10.0)
    assert source.clock.restarts == source.clock.refused == 0


@pytest.mark.parametrize('rate', [0.98, 0.995, 1.0005, 1.02])
def test_a_wrong_rate_is_found(rate):
    source, times, true = times_of_blocks(60.0, 1e6 * (rate - 1.0), lambda k, rng: rng.exponential(0.002))
    assert np.abs(times - true).max() < 0.03
    assert source.clock.restarts == source.clock.refused == 0
    assert source.ppm == pytest.approx(1e6 * (rate - 1.0), abs=600.0)


@pytest.mark.parametrize('step', [-3600.0, -1e9, 60.0, 3600.0])
def test_a_step_of_the_system_clock_is_followed_after_a_second(step):
    source, times, true = times_of_blocks(20.0, late=lambda k, rng: step if k >= 300 else 0.0)
    assert source.clock.restarts == 1 and 30 <= source.clock.refused < 45
    np.testing.assert_allclose(times[350:], true[350:] + step, rtol=0.0, atol=1e-3)


@pytest.mark.parametrize('late', [lambda k: 0.2 * (k == 0), lambda k: 0.4 * (300 <= k < 312), lambda k: 0.1 * (k % 7 == 0)])
def test_late_blocks_move_nothing(late):
    source, times, true = times_of_blocks(20.0, late=lambda k, rng: late(k))
    np.testing.assert_allclose(times[1:], true[1:], rtol=0.0, atol=1e-3)
    assert source.clock.restarts == source.clock.refused == 0
