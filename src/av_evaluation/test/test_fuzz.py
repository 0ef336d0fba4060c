"""No sequence of messages, valid or not, leads to a command beyond its limits, or to a motion on old inputs.

Each sequence mixes plausible messages with hostile ones, in a time that stalls and jumps. Stages may raise ValueError only;
bearings and tracks are finite; commands are finite and within their limits, and move the body on fresh inputs only.
"""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from nav_msgs.msg import Odometry
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

from av_common.freshness import Instant
from av_common.parameters import node_parameters
from av_common.rig import CameraMount
from av_common.stamps import to_stamp
from av_evaluation.attack import judges
from av_evaluation.attack.hostile import HostileValues
from av_evaluation.attack.judges import CommandJudge
from av_fusion.stage import make_fusion_stage
from av_interfaces.msg import Bearing, Doa, DoaArray
from av_pointing.stage import make_pointing_stage

pytestmark = pytest.mark.filterwarnings('ignore:.*:RuntimeWarning')    # of absurd numbers
METHODS = ('bayes', 'bayes', 'gated')    # the default one in two of three sequences
STEPS_S = (0.0, 0.02, 0.05, 0.5, -0.1, 30.0)
STEP_SHARES = (0.1, 0.5, 0.3, 0.06, 0.03, 0.01)
SHARES = (0.0, 0.0, 0.02, 0.2)    # of a message's fields that are hostile
FINITE = ('azimuth', 'elevation', 'azimuth_world', 'azimuth_world_rate', 'requested_rotation')


class Mixture:
    """Random messages for a fusion and a pointing stage.

    Parameters:
        seed: of the random draws.
    """

    def __init__(self, seed):
        self._random, self._steady, self._now = Random(seed), 100.0, 1000.0 + 1e5 * seed    # of which the latter may step back
        self._hostile = HostileValues(self._random, lambda: self._now)
        method = self._random.choice(METHODS)
        self._fusion = make_fusion_stage(node_parameters('av_fusion', 'fusion_node', overrides={'method': method}),
                                         lambda frame, time: np.eye(3), CameraMount().model)
        self._pointing = make_pointing_stage(node_parameters('av_pointing', 'pointing_node', overrides={'enabled': True}))
        self._judge = CommandJudge(self._pointing.controller.settings)

    def run(self, messages):
        """Use a number of messages; returns the first fault, '' for none."""
        try:
            for _ in range(messages):
                step = self._random.choices(STEPS_S, STEP_SHARES)[0]
                self._now, self._steady = self._now + step, self._steady + max(step, 0.0)
                if fault := self._use(self._random.choice((self._doa, self._image, self._odometry))()):
                    return fault
        except Exception as error:  # noqa: BLE001  every exception but ValueError is a fault
            return f'{type(error).__name__}: {error}'
        self._judge.judge(math.inf)
        return next(iter((*self._judge.findings.bad, *self._judge.findings.moves)), '')

    def _use(self, message):
        """Give a message to the stages, and what follows; returns a fault."""
        if share := self._random.choice(SHARES):
            self._hostile.disturb(message, share)
        now, outputs = Instant(self._steady, self._now), []
        self._judge.on_input('odometry' if isinstance(message, Odometry) else 'measurement', self._steady, self._steady)
        takes = {DoaArray: self._fusion.on_doa, Detection2DArray: self._fusion.on_detections,
                 Odometry: self._fusion.on_odometry}
        try:
            outputs.append(takes[type(message)](message, self._now))
            if isinstance(message, Odometry):
                self._pointing.on_odometry(message, now)
        except ValueError:
            outputs.clear()
        outputs += self._fusion.outputs_until(self._now)
        for output in filter(None, outputs):
            if fault := check(output):
                return fault
            self._obey(self._pointing.on_bearing(output.bearing, now))
        self._obey(self._pointing.on_time(now))
        return ''

    def _obey(self, command):
        self._judge.on_command(command, self._steady, self._steady)

    def _stamped(self, message, late):
        message.header.stamp, message.header.frame_id = to_stamp(self._now - late), 'sensor'
        return message

    def _doa(self):
        azimuth, variance = self._random.gauss(0.0, 1.0), 10.0 ** self._random.uniform(-5.0, 0.0)
        return self._stamped(DoaArray(window=0.5, axis=Vector3(y=1.0), hypotheses=[
            Doa(direction=Vector3(x=math.cos(a), y=math.sin(a)), azimuth=a, azimuth_variance=variance, cosine=math.sin(azimuth),
                elevation_variance=math.inf, cosine_variance=variance, confidence=self._random.random(), drone_probability=0.9)
            for a in (azimuth, math.pi - azimuth)]), 0.25)

    def _image(self):
        found = []
        for _ in range(self._random.randrange(3)):
            found.append(Detection2D(results=[ObjectHypothesisWithPose()]))
            found[-1].bbox.center.position.x, found[-1].bbox.center.position.y = 640.0 * self._random.random(), 240.0
            found[-1].bbox.size_x = found[-1].bbox.size_y = 30.0
            found[-1].results[0].hypothesis.class_id, found[-1].results[0].hypothesis.score = 'drone', self._random.random()
        return self._stamped(Detection2DArray(detections=found), 0.1)

    def _odometry(self):
        message, half = self._stamped(Odometry(), 0.01), 0.1 * math.sin(self._now)
        message.pose.pose.orientation.w, message.pose.pose.orientation.z = math.cos(half), math.sin(half)
        return message


def check(output):
    """The fault of what fusion states, '' for none."""
    bearing, targets = output.bearing, output.targets
    if bearing.state != Bearing.STATE_NONE and not all(math.isfinite(getattr(bearing, name)) for name in FINITE):
        return f'the bearing is not finite: {bearing}'
    ids = [track.id for track in targets.tracks]
    if len(ids) != len(set(ids)) or targets.selected not in (0, *ids):
        return f'targets {ids}, of which {targets.selected} is selected'
    for track in targets.tracks:
        if not (0.0 <= track.existence <= 1.0 and math.isfinite(track.azimuth) and math.isfinite(track.elevation)):
            return f'the target is impossible: {track}'
    return ''


def faults(first, count, messages):
    """The first fault of each sequence, by the seeds that repeat them."""
    found = {seed: Mixture(seed).run(messages) for seed in range(first, first + count)}
    return {seed: fault for seed, fault in found.items() if fault}


def test_invalid_messages_neither_crash_nor_break_a_limit():
    assert faults(0, 300, 20) == {}


def test_a_motion_that_outlasts_its_inputs_is_found(monkeypatch):
    """The body may move for 0.4 s after them; where a tenth of a second is asked for, sequences break."""
    monkeypatch.setattr(judges, 'MOTION_LIFETIME_S', 0.1)
    assert any('after the newest' in fault for fault in faults(0, 30, 40).values())
