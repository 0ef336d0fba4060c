"""`source:=file` and `drone_recording:=` with real recordings: a drone in binaural sound, and an outdoor video."""

from __future__ import annotations

import math

import numpy as np
import pytest
from machine_load import skip_figures_where_overloaded
from real_recordings import CLIPS, COCO, boxes_of, moving_drone, needs_data
from rig_process import RigProcess
from udp_ports import free_offset

from av_common.angles import wrap
from av_evaluation.experiments.physical import filmed

pytestmark = [pytest.mark.system, needs_data]


def read(path):
    """A table of a run."""
    return np.genfromtxt(path, delimiter=',', names=True)


def test_a_real_drone_is_followed_by_ear(tmp_path):
    """Measured ear responses at known azimuths: the bearing follows, mirror images folded, without any calibration.

    The head is no pair of free microphones 0.2 m apart: its delays are those of such a pair within 3 degrees.
    """
    azimuths = np.concatenate([np.arange(-60.0, 61.0, 5.0), np.arange(55.0, -1.0, -5.0)])
    moving_drone(tmp_path / 'drone.wav', azimuths, step_s=0.5)
    rig = RigProcess('source:=file', f'audio:={tmp_path}/drone.wav', f'out:={tmp_path}/out', 'duration:=22')
    assert rig.finish() == 0, rig.output
    assert not rig.leftovers()
    skip_figures_where_overloaded()
    fused, sound = read(tmp_path / 'out' / 'fused.csv'), read(tmp_path / 'out' / 'sound.csv')
    # The monitor may miss the first directions, of which there are ten a second.
    begins = sound['time'][0] - 0.25 - np.arange(0.0, 3.0, 0.1)
    elapsed, truth, error = min((followed(fused, begin, azimuths) for begin in begins), key=lambda found: np.median(found[-1]))
    assert np.ptp(elapsed) > 14.0 and np.ptp(truth) > 90.0
    assert np.median(error) < 3.0 and np.percentile(error, 90) < 5.0


def followed(fused, begin, azimuths):
    """Of bearings: time since the file began, true azimuth and error in degrees, if it began at `begin`."""
    elapsed = fused['time'] - begin
    moving = (fused['state'] > 0) & (elapsed > 2.0) & (elapsed < 0.5 * (len(azimuths) - 1))
    truth = np.interp(elapsed[moving], 0.5 * np.arange(len(azimuths)), azimuths)
    return elapsed[moving], truth, np.abs(np.degrees(np.arcsin(np.sin(fused['azimuth'][moving]))) - truth)


def test_a_real_drone_is_followed_by_eye(tmp_path):
    """A real clip through camera_node and a real YOLO: most images give the drone within half a degree of its label."""
    clip = 'V_DRONE_013'
    rig = RigProcess('source:=file', f'video:={CLIPS}/video/{clip}.mp4', f'model:={COCO}', 'classes:=airplane,bird,kite',
                     f'out:={tmp_path}', 'duration:=14')
    assert rig.finish() == 0, rig.output
    assert not rig.leftovers()
    skip_figures_where_overloaded()
    sight = read(tmp_path / 'sight.csv')
    seen = np.isfinite(sight['azimuth'])
    assert seen.mean() > 0.5 and seen.sum() > 50
    focal = 320.0 / math.tan(math.radians(35.0))
    centres = np.array([boxes_of(clip)[frame][0] + 0.5 * boxes_of(clip)[frame][2] for frame in sorted(boxes_of(clip))])
    labelled = -np.arctan((centres - 319.5) / focal)
    nearest = np.abs(sight['azimuth'][seen][:, None] - labelled).min(axis=1)
    assert np.degrees(np.median(nearest)) < 0.5
    fused = read(tmp_path / 'fused.csv')
    assert (fused['state'] == 1).mean() > 0.4


def test_a_drone_that_the_camera_lost_is_followed_by_ear():
    """Real video and sound, the lens covered for half of the time: one source is one direction, also while it moves.

    What measured ears heard of it twice at the same place began a second track, which took its sound over.
    """
    log, _ = filmed('V_DRONE_080', CLIPS.parent, ())
    time = log.fused['time']
    error = np.degrees(wrap(log.fused['azimuth'] - log.true_azimuth(time)))
    assert np.all(log.fused['state'] > 0) and np.sqrt(np.mean(np.square(error))) < 2.5


def test_the_simulated_drone_emits_a_recording(tmp_path):
    """A recording at 44.1 kHz as the drone's signal: resampled, propagated, received and followed."""
    rig = RigProcess('scenario:=circle', 'oracle:=true', f'drone_recording:={CLIPS}/audio/DRONE_001.flac', 'duration:=12',
                     f'out:={tmp_path}', f'port_offset:={free_offset()}')
    assert rig.finish() == 0, rig.output
    assert not rig.leftovers()
    skip_figures_where_overloaded()
    assert rig.value('coverage') > 80.0 and rig.value('median') < 3.0, rig.output
