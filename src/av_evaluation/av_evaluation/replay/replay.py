"""A bag through the rig's algorithms: no middleware, no wall clock, the same bytes every time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from rclpy.serialization import serialize_message

from av_audio.stage import make_doa_stage
from av_bags import topics as names
from av_bags.converters import AudioLayout
from av_bags.errors import BagError
from av_bags.feed import CLOCK_TOLERANCE_S, SECOND, BagRecord, Feed
from av_bags.reader import FOREVER, Bag
from av_bags.topics import Found, find_topics
from av_bags.writer import BagWriter
from av_common.camera import PinholeCamera
from av_common.microphone_array import MicrophoneArray
from av_common.parameters import node_parameters
from av_common.rig import Rig, load_rig
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.replay.messages import MessageMaker
from av_evaluation.replay.output_queue import OutputQueue
from av_evaluation.replay.pipeline import Chain
from av_evaluation.replay.run_recorder import Journal
from av_evaluation.replay.sensor_frames import SensorFrames
from av_evaluation.replay.stages import DetectionReplay, DoaReplay
from av_evaluation.runs.recording import Recording, RecordingTracker
from av_fusion.measurement.converter import MeasurementConverter
from av_fusion.settings import make_tracker
from av_fusion.stage import make_fusion_stage
from av_pointing.stage import make_pointing_stage
from av_simulator.config_files import find_config
from av_vision.stage import make_detection_stage

STAGES = ('raw', 'doa', 'bearing')
# Known as a whole before anything else is read.
READ_AHEAD = (names.CAMERA, names.FRAMES)
# Needed at the end only.
TRUTHS = (names.TRUE_TARGET, names.TRUE_RIG)
# What is done without topics that are not in the bag.
WITHOUT = {
    names.CAMERA: "the camera of the rig's description is assumed",
    names.AUDIO: 'the rig is deaf',
    names.DETECTIONS: 'the rig is blind',
    names.IMAGE: 'the rig is blind',
    names.DOA: 'the rig is deaf',
    names.ODOMETRY: 'the rig counts as standing still',
    names.TRUE_TARGET: 'errors cannot be told',
    names.TRUE_RIG: 'errors cannot be told',
}


@dataclass(frozen=True)
class ReplaySettings:
    """What to compute, and with what.

    stage: from which of STAGES on to compute anew, empty for as early as the bag allows; rig, array: files, empty for
    the shipped ones; model: a detector's ONNX file, empty takes the recorded detections; parameters: files as the
    nodes read them; commands: of pointing, too, though nobody obeys; start, duration: of the part to replay, in s from
    the bag's start. Raises BagError.
    """

    stage: str = ''
    rig: str = ''
    array: str = ''
    model: str = ''
    classes: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    remappings: dict[str, str] = field(default_factory=dict)
    namespace: str = ''
    audio: AudioLayout | None = None
    commands: bool = False
    start: float = 0.0
    duration: float = math.inf

    def __post_init__(self) -> None:
        if self.stage not in ('', *STAGES):
            raise BagError(f'cannot replay from {self.stage!r}, expected {", ".join(STAGES)}')
        if not (self.start >= 0.0 and self.duration > 0.0):
            raise BagError(f'start is {self.start} s, duration {self.duration} s, expected at least 0 and more than 0')


class Replay:
    """Computes what the rig would have said.

    `notes` say what is missing and how it is made up for, and after `run` what could not be used. Raises BagError when
    the bag cannot be replayed, ValueError or OSError when the files that describe the rig cannot be used.
    """

    def __init__(self, bag: Bag, settings: ReplaySettings = ReplaySettings(), recording: Recording | None = None,
                 estimators: Sequence[str] = ()) -> None:
        """`recording` gets what the tracker is told, and what further `estimators` of hearing make of the sound."""
        self._bag, self._settings = bag, settings
        self._recording, self._estimators = recording, estimators
        self._journal, self._make = Journal(recording), MessageMaker()
        self.notes: list[str] = []
        self._out: OutputQueue | None = None
        found = find_topics(bag, names.KINDS, settings.remappings, settings.namespace)
        self.stage = settings.stage or ('raw' if names.AUDIO in found else
                                        'doa' if names.DOA in found or names.DETECTIONS in found else 'bearing')
        self._topics = self._choose(found)
        start_ns = bag.start_ns + round(settings.start * SECOND)
        stop_ns = FOREVER if math.isinf(settings.duration) else start_ns + round(settings.duration * SECOND)
        self._feed = Feed(bag, self._topics, settings.audio, start_ns, stop_ns)
        self._chain = self._build(load_rig(settings.rig or find_config('rig')))

    @property
    def log(self) -> RunLog:
        """Truth, what the senses said, and the bearing."""
        return self._journal.log

    def run(self, out: BagWriter | None = None, progress: Callable[[float], None] | None = None) -> RunLog:
        """Replay. `out` gets what is computed, and of the bag what it rests on but for sound and pictures.

        `progress` is called about each second of the bag with the time done, in s since the bag's start.
        """
        self._out = OutputQueue(out, self._settings.namespace) if out is not None else None
        first = told = None
        try:
            for record in self._feed:
                if first is None:
                    first = told = record.arrival
                if progress is not None and record.arrival - told >= 1.0:
                    told = record.arrival
                    progress(told - first)
                self._take(record)
        finally:
            if self._out is not None:
                self._out.flush()
        self._conclude()
        return self.log

    def _take(self, record: BagRecord) -> None:
        name, now, message, data = record
        if self._out is not None and name not in (names.AUDIO, names.IMAGE):
            self._out.put(name, now, data or serialize_message(message))
        if self._others and name == names.AUDIO:
            self._compare(message, now)
        if name in TRUTHS:
            self._journal.know(name, message)
        elif name not in READ_AHEAD:
            if now >= self._chain.due:
                self._chain.wait(now)
            self._chain.take(name, message, now)

    def _compare(self, content: Any, now: float) -> None:
        """What the other estimators hear in the same sound."""
        for estimator, hearing in self._others.items():
            for name, _, data in hearing.take(content, now):
                sounds = self._converter.doa(self._make.deserialise(name, data))[:1]
                self._recording.sounds.setdefault(estimator, []).extend(sounds)

    def _tell(self, name: str, time: float, content: Any) -> None:
        """Put what was computed to the output."""
        if self._out is not None:
            self._out.put(name, time, self._make.output(name, content))

    def _choose(self, found: Found) -> dict[str, str]:
        """The topics of the bag that this replay reads. Raises BagError when there is nothing to compute from."""
        seeing = names.IMAGE if self.stage == 'raw' and self._settings.model else names.DETECTIONS
        senses = {'raw': (names.AUDIO, seeing), 'doa': (names.DOA, names.DETECTIONS), 'bearing': (names.BEARING,)}
        wanted = senses[self.stage]
        if not any(name in found for name in wanted):
            reasons = '; '.join(found.missing[name] for name in wanted)
            raise BagError(f'{self._bag.path} cannot be replayed from {self.stage}: {reasons}')
        for name in (*wanted, names.CAMERA, names.ODOMETRY, names.TRUE_TARGET, names.TRUE_RIG):
            if name in found.missing and not (name == names.ODOMETRY and self.stage == 'bearing'):
                self._note(f'{found.missing[name]}: {WITHOUT[name]}')
        context = (names.CAMERA, names.ODOMETRY, names.TRUE_TARGET, names.TRUE_RIG, names.FRAMES)
        beside = (names.STATE, names.DOA, names.DETECTIONS) if self.stage == 'bearing' else ()
        beside += (names.MOTORS,) if self.stage == 'raw' and names.AUDIO in found else ()
        beside += (names.VISIBILITY,) if seeing == names.DETECTIONS else ()
        return {name: found.topics[name] for name in (*wanted, *beside, *context) if name in found}

    def _build(self, rig: Rig) -> Chain:
        fusion = self._parameters('av_fusion', 'fusion_node')
        self._make.frame = fusion.base_frame
        self._frames = SensorFrames(rig, fusion.base_frame)
        if names.FRAMES in self._topics:
            self._frames.learn(self._bag, self._topics[names.FRAMES])
        camera = self._camera(rig)
        self._converter = MeasurementConverter(self._frames.rotation, fusion.target_classes, camera)
        self._hearing = self._seeing = self._fusing = None
        self._others: dict[str, DoaReplay] = {}
        if self.stage == 'raw' and names.AUDIO in self._topics:
            array = MicrophoneArray.load(self._settings.array) if self._settings.array else rig.array.geometry
            p = self._parameters('av_audio', 'doa_node')
            self._hearing = DoaReplay(make_doa_stage(p, array), self._make)
            self._others = {method: DoaReplay(make_doa_stage(p, array, method=method), self._make)
                            for method in self._estimators}
        if names.IMAGE in self._topics:
            model = self._settings.model if self._settings.model != 'shipped' else ''
            given = {'model': model, 'keep_classes': list(self._settings.classes) or None}
            p = self._parameters('av_vision', 'detector_node', {k: v for k, v in given.items() if v})
            self._seeing = DetectionReplay(make_detection_stage(p, camera), self._make)
        if self.stage != 'bearing':
            tracker = make_tracker(fusion)
            if self._recording is not None:
                tracker = RecordingTracker(tracker, self._recording)
            self._fusing = make_fusion_stage(fusion, self._frames.rotation, camera, self._journal, tracker)
        pointing = None
        if self._settings.commands or self.stage == 'bearing':
            pointing = make_pointing_stage(self._parameters('av_pointing', 'pointing_node', {'enabled': True}))
        return Chain(self._converter, self._journal, self._hearing, self._seeing, self._fusing, pointing, self._make,
                     self._tell)

    def _parameters(self, package: str, node: str, given: dict[str, Any] | None = None) -> SimpleNamespace:
        files = (find_config('rig_params'), *self._settings.parameters)
        return node_parameters(package, node, files, given, self._settings.namespace)

    def _camera(self, rig: Rig) -> PinholeCamera:
        topic = self._topics.get(names.CAMERA)
        if topic is None:
            return rig.camera.model
        _, _, data = next(self._bag.messages([topic]))
        return PinholeCamera.from_camera_info(self._bag.decode(topic, data))

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _conclude(self) -> None:
        for problem in (*self._bag.problems, *self._feed.problems):
            self._note(problem)
        for stage in (self._hearing, self._seeing):
            for problem in sorted(stage.problems if stage else ()):
                self._note(problem)
        for name, count in (self._fusing.foreign_stamps if self._fusing else {}).items():
            if count:
                self._note(f'{count} messages of {name} left out: their stamps are more than {CLOCK_TOLERANCE_S:.0f} s off '
                           "the bag's time")
        for frame in sorted(self._frames.unknown):
            self._note(f'no transform from {frame!r} to the body: what is measured in it is left out')
