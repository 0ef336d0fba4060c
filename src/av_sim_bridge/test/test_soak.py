"""A long stream over loopback: no sample is lost and memory does not grow.

AV_SOAK_SECONDS=3600 streams an hour, thirty times as fast as real time where the machine can.
"""

import os
import threading
from pathlib import Path

import numpy as np
import pytest
from test_loopback import Listener, free_ports

from av_sim_bridge.config_files import find_config
from av_sim_bridge.rig import load_rig
from av_sim_bridge.scenario import load_scenario
from av_sim_bridge.simulator import Simulator, WireOptions
from av_sim_bridge.wire.audio import AudioFormat
from av_sim_bridge.world import World

SECONDS = float(os.environ.get('AV_SOAK_SECONDS', '90'))
SPEED = 30.0


class Canned(World):
    """A world whose sound is a counter: the stream is put to the test here, not how sound is made."""

    def advance(self, samples):
        self.dynamics.step(self.time, (self._samples + samples) / self.sample_rate)
        index = np.arange(self._samples, self._samples + samples)[:, np.newaxis] * 2 + [0, 1]
        self._samples += samples
        return (index % 60_000 - 30_000) / 32768.0


def resident_mib():
    lines = Path('/proc/self/status').read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith('VmRSS'))


@pytest.mark.timeout(60.0 + 3 * SECONDS)
def test_a_long_stream_loses_nothing_and_memory_stays():
    options = WireOptions(ports=free_ports(), audio_header=True, renderer='painter', image_rate=0.2, speed=SPEED)
    world = Canned(load_scenario(find_config('circle', 'scenarios')), load_rig(find_config('rig')))
    simulator, listener = Simulator(world, options), Listener(options.ports, AudioFormat())
    listener.images, listener.boxes = [], []
    listener.pictures._on_image = listener.pictures._on_boxes = lambda *_: None
    sender = threading.Thread(target=simulator.run, args=(SECONDS,))
    sender.start()
    heard, wrong, memory = 0, 0, []
    while sender.is_alive() or listener.ring.available:
        if not listener.ring.wait(0.5):
            continue
        first, samples = listener.ring.read()
        wrong += first != heard
        index = np.arange(first, first + len(samples))[:, np.newaxis] * 2 + [0, 1]
        wrong += int((samples != index % 60_000 - 30_000).any())
        heard = first + len(samples)
        listener.states.clear()
        if int(world.time) % 30 == 0:
            memory.append(resident_mib())
    simulator.close()
    listener.stop()
    assert wrong == 0
    assert heard == simulator.counts.audio_frames == round(SECONDS * 48_000)
    assert listener.audio.decoder.counts.lost == 0 and listener.ring.overwritten == 0
    settled = memory[len(memory) // 3:]
    print(f'{SECONDS:.0f} s: {heard} frames, none lost; memory {settled[0]:.1f} to {settled[-1]:.1f} MiB')
    assert settled[-1] - settled[0] < (3.0 if SECONDS >= 600 else 12.0)    # windows of statistics have to fill first
