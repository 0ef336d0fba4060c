"""A stream over loopback: no sample is lost or changed. `ros2 run av_evaluation soak` is the long run."""

import threading

import numpy as np
import pytest
from test_simulator import Listener
from udp_ports import free_ports

from av_common.rig import load_rig
from av_sim_bridge.wire.audio import AudioFormat
from av_simulator import Simulator, WireOptions, World, find_config, load_scenario

pytestmark = pytest.mark.system

SECONDS = 8.0    # at the speed of time, since stamps of another speed are not dated


class Canned(World):
    """A world whose sound is a counter: the stream is put to the test here, not how sound is made."""

    def advance(self, samples):
        self.dynamics.step(self.time, (self._samples + samples) / self.sample_rate)
        index = np.arange(self._samples, self._samples + samples)[:, np.newaxis] * 2 + [0, 1]
        self._samples += samples
        return (index % 60_000 - 30_000) / 32768.0


def test_a_stream_arrives_as_it_was_sent():
    options = WireOptions(ports=free_ports(), audio_header=True, image_rate=0.0)
    world = Canned(load_scenario(find_config('circle', 'scenarios')), load_rig(find_config('rig')))
    simulator, listener = Simulator(world, options), Listener(options.ports, AudioFormat())
    sender = threading.Thread(target=simulator.run, args=(SECONDS,))
    sender.start()
    heard = wrong = 0
    while sender.is_alive() or listener.ring.available:
        if not listener.ring.wait(0.5):
            continue
        first, samples = listener.ring.read()
        wrong += first != heard
        index = np.arange(first, first + len(samples))[:, np.newaxis] * 2 + [0, 1]
        wrong += int((samples != index % 60_000 - 30_000).any())
        heard = first + len(samples)
    simulator.close()
    listener.stop()
    assert wrong == 0
    assert heard == simulator.counts['audio_frames'] == SECONDS * 48_000
    assert listener.audio.decoder.counts.lost == 0 and listener.ring.overwritten == 0
