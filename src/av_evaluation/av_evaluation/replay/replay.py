"""A bag through the rig's stages: no node, no wall clock, the same bytes every time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

from av_audio.stage import DoaStage, make_doa_stage
from av_bags import topics as names
from av_bags.converters import AudioLayout
from av_bags.definitions import BagError, serialiser
from av_bags.feed import SECOND, BagRecord, Feed
from av_bags.reader import Bag
from av_bags.topics import Found, absolute, find_topics
from av_bags.writer import DEFAULT_QOS, LATCHED, BagWriter
from av_common.body_odometry import BodyOdometry
from av_common.camera import PinholeCamera
from av_common.freshness import CLOCK_TOLERANCE_S, FUTURE_S
from av_common.gimbal_history import GimbalHistory, sample_of
from av_common.microphone_array import MicrophoneArray
from av_common.parameters import check_parameter_file, node_modules, node_parameters
from av_common.rig import CAMERAS, CameraMount, camera_topic, camera_topics, load_rig
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.replay.pipeline import Pipeline, SensorFrames
from av_fusion.measurement.converter import MeasurementConverter
from av_fusion.settings import make_tracker
from av_fusion.stage import FusionStage, make_fusion_stage
from av_pointing.stage import make_pointing_stage
from av_simulator.config_files import find_config
from av_vision.messages import image_from_message
from av_vision.stage import DetectionStage, make_detection_stage

Result = TypeVar('Result')
STAGES = ('raw', 'doa', 'bearing')
TRUTHS = (names.TRUE_TARGET, names.TRUE_RIG)
CONTEXT = (names.FRAMES, names.ODOMETRY, names.GIMBAL, *TRUTHS)
# What is done without topics that are not in the bag.
WITHOUT = {
    names.CAMERA: "the camera of the rig's description is assumed",
    names.AUDIO: 'sound is not used',
    names.DETECTIONS: 'the camera is not used',
    names.IMAGE: 'the camera is not used',
    names.DOA: 'sound is not used',
    names.ODOMETRY: 'the rig counts as standing still',
    names.TRUE_TARGET: 'errors cannot be computed',
    names.TRUE_RIG: 'errors cannot be computed',
}


@dataclass(frozen=True)
class ReplaySettings:
    """What to compute, and with what. Raises BagError.

    Parameters:
        stage: one of STAGES from which on results are computed, empty for as early as the bag allows.
        rig, array: files, empty for the shipped ones.
        model: a detector's ONNX file or 'shipped', empty for the recorded detections.
        classes: of the model that are taken for the target.
        parameters: parameter files as the nodes read them.
        remappings: topics of the bag by the rig's names.
        namespace: of the recorded rig.
        audio: layout of sound in bare bytes.
        commands: whether pointing commands are computed, although nothing obeys them.
        start, duration (s): part of the bag to replay.
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
    """Computes what the rig would have published.

    Raises BagError when the bag cannot be replayed, ValueError or OSError when the files that describe the rig cannot be
    used.

    Attributes:
        stage: the one of STAGES from which on results are computed.
        log: truth, measurements, and the bearing.
        frames: the rig's, by the bag and its description.
        notes: what is missing and how it is made up for; after `run` also what could not be used.
        lost: whether messages that were read could not be used.

    Parameters:
        bag: to replay.
        settings: see `ReplaySettings`.
        keeps_events: whether the log gets what the tracker is given, for other trackers.
        estimators: further methods of estimating directions, whose results go to the log.
    """

    def __init__(self, bag: Bag, settings: ReplaySettings = ReplaySettings(), keeps_events: bool = False,
                 estimators: Sequence[str] = ()) -> None:
        self._bag, self._settings = bag, settings
        self.notes: list[str] = []
        self.lost = False
        self._out: BagWriter | None = None
        if settings.start > bag.length:
            raise BagError(f'{bag.path} is {bag.length:.1f} s long, start is {settings.start:g} s')
        found = find_topics(bag, names.KINDS, settings.remappings, settings.namespace)
        self._rig, self._estimators, self._segment = load_rig(settings.rig or find_config('rig')), estimators, 0
        senses = names.DOA, *camera_topics(self._rig.cameras, names.DETECTIONS)
        self.stage = settings.stage or ('raw' if names.AUDIO in found else
                                        'doa' if any(name in found for name in senses) else 'bearing')
        self.log = RunLog(keeps_events=keeps_events and self.stage != 'bearing')
        for file in settings.parameters:
            check_parameter_file(file, [absolute(node, settings.namespace) for node in node_modules()])
        self._topics = self._choose(found)
        self._feed = Feed(bag, self._topics, settings.audio, settings.start, settings.start + settings.duration)
        self._build()

    def run(self, out: BagWriter | None = None, progress: Callable[[float], None] | None = None) -> RunLog:
        """Replay. `out` gets what is computed, and of the bag what it rests on but for sound and images.

        `progress` is called about each second of the bag with the time done, in s. Raises OSError when `out` refuses.
        """
        self._out = out
        done, before = 0.0, math.nan
        reported = 0.0
        for record in self._feed:
            if record.segment != self._segment:
                self._begin_segment(record.segment, record.arrival - before)
                before = record.arrival
            done += record.arrival - before if math.isfinite(before) else 0.0
            before = record.arrival
            if progress is not None and done - reported >= 1.0:
                reported = done
                progress(done)
            self._take(record)
        self._conclude()
        return self.log

    def _begin_segment(self, number: int, gap: float) -> None:
        """Begin anew behind a gap (s): nothing is computed in it, and the log leaves it out."""
        self._conclude_stages()
        self._segment = number
        self.log.left_out += gap
        self._build()

    def _take(self, record: BagRecord) -> None:
        name, arrival, message, data, _ = record
        if name != names.FRAMES:  # which may be older than all else
            self._pipeline.advance(arrival)  # before it is written, so that the output is in order of time
        if name not in (names.AUDIO, *camera_topics(CAMERAS, names.IMAGE)):
            self._publish(name, arrival, message, data)
        if name in TRUTHS:
            try:
                self.log.on_truth(name, message, arrival)
            except ValueError as error:
                self.log.notes[name] = f'poses left out, such as this: {error}'
        elif name != names.FRAMES:
            try:
                message = self._odometry.of_body(message) if name == names.ODOMETRY else message
                if name == names.GIMBAL and self._fusion is None:
                    self._gimbal.add(sample_of(message), arrival)
            except ValueError as error:
                self._pipeline.problems[f'{name}: {error}'] += 1
                return
            self._pipeline.take(name, message, arrival)

    def _publish(self, name: str, time: float, message: Any, data: bytes = b'') -> None:
        """Write a message of a time in s to the output; `data` is the message in CDR where that is known."""
        if self._out is not None:
            topic = absolute(name, self._settings.namespace)
            if topic not in self._out.counts:
                self._out.add_topic(topic, names.KINDS[name][0], LATCHED if name == names.FRAMES else DEFAULT_QOS)
            self._out.write(topic, round(time * SECOND), data or serialiser(names.KINDS[name][0])(message))

    def _choose(self, found: Found) -> dict[str, str]:
        """The topics of the bag that this replay reads. Raises BagError when there is nothing to compute from."""
        cameras, detects = tuple(self._rig.cameras), self.stage == 'raw' and bool(self._settings.model)
        seen, detections = (camera_topics(cameras, name) for name in (names.IMAGE if detects else names.DETECTIONS,
                                                                      names.DETECTIONS))
        inputs = {'raw': (names.AUDIO, *seen), 'doa': (names.DOA, *detections), 'bearing': (names.BEARING,)}
        wanted = inputs[self.stage]
        if not any(name in found for name in wanted):
            all_inputs = () if self._settings.stage else (names.AUDIO, names.DOA, names.DETECTIONS)
            reasons = '; '.join(found.missing[name] for name in (*wanted, *all_inputs))
            raise BagError(f'{self._bag.path} cannot be replayed from {self.stage}: {reasons}')
        for name in (*wanted, *camera_topics(cameras, names.CAMERA), names.ODOMETRY, *TRUTHS):
            if name in found.missing and not (name == names.ODOMETRY and self.stage == 'bearing'):
                without = WITHOUT[names.of_camera(name)[1]]
                (self._lose if name in found.unused else self._note)(f'{found.missing[name]}: {without}')
        beside: tuple[str, ...] = (names.STATE, names.TARGETS, names.DOA, *detections) if self.stage == 'bearing' else ()
        beside += (names.ODDS,) if self.stage == 'doa' else ()
        beside += (names.CUE,) if self._parameters('av_fusion', 'fusion_node').use_cues else ()
        beside += (names.MOTORS,) if self.stage == 'raw' and names.AUDIO in found else ()
        beside += camera_topics(cameras, names.CAMERA, *(() if detects else (names.VISIBILITY,)))
        return {name: found.topics[name] for name in (*wanted, *beside, *CONTEXT) if name in found}

    def _build(self) -> None:
        fusion, rig = self._parameters('av_fusion', 'fusion_node'), self._rig
        self._gimbal = GimbalHistory()
        self.frames = SensorFrames(rig, self._gimbal)
        self._odometry = BodyOdometry(self.frames.fixed)
        if names.FRAMES in self._topics:
            self.frames.learn(self._bag, self._topics[names.FRAMES])
        models = {camera: self._model(camera, mount) for camera, mount in rig.cameras.items()}
        self._converter = MeasurementConverter(self.frames.rotation, cameras=models)
        self._fusion: FusionStage | None = None
        if self.stage != 'bearing':
            self._fusion = make_fusion_stage(fusion, self.frames.rotation, models, self.log,
                                             make_tracker(fusion, rig.gimbal), self._gimbal if rig.gimbal else None,
                                             tuple(rig.cameras))
            self._fusion.converter.optical_frames = rig.optical_frames
        pointing = None
        if self._settings.commands or self.stage == 'bearing':
            pointing = make_pointing_stage(self._parameters('av_pointing', 'pointing_node', {'enabled': True}), rig.gimbal)
        doa = self._doa = self._doa_stage()
        others = {method: stage for method in self._estimators if (stage := self._doa_stage(method=method)) is not None}
        detection = {camera: self._detection_stage(camera, mount, models[camera]) for camera, mount in rig.cameras.items()
                     if camera_topic(camera, names.IMAGE) in self._topics}
        self._pipeline = Pipeline(doa, detection, self._fusion, pointing, self.log, self._converter, self._publish,
                                  others)

    def _doa_stage(self, **changes: Any) -> DoaStage | None:
        if self.stage != 'raw' or names.AUDIO not in self._topics:
            return None
        array = MicrophoneArray.load(self._settings.array) if self._settings.array else self._rig.array.geometry
        return make_doa_stage(self._parameters('av_audio', 'doa_node'), array, **changes)

    def _detection_stage(self, camera: str, mount: CameraMount, model: PinholeCamera) -> DetectionStage:
        """As `av_bringup.launching.detector_nodes`: the first camera has the model given, others the shipped one."""
        file = self._settings.model if camera == CAMERAS[0] and self._settings.model != 'shipped' else ''
        given = {'model': file, 'camera_kind': mount.images,
                 'keep_classes': list(self._settings.classes) if camera == CAMERAS[0] else []}
        stage = make_detection_stage(self._parameters('av_vision', 'detector_node', {k: v for k, v in given.items() if v}))
        stage.mount(self.frames.rotation, model)
        return stage

    def _parameters(self, package: str, node: str, given: dict[str, Any] | None = None) -> SimpleNamespace:
        files: list[str | Path] = [find_config('rig_params'), *self._settings.parameters]
        return node_parameters(package, node, files, given, self._settings.namespace)

    def _model(self, camera: str, mount: CameraMount) -> PinholeCamera:
        """By the bag's first usable CameraInfo, else by the description. Raises ValueError where images do not fit that."""
        told = self._first(camera_topic(camera, names.CAMERA), PinholeCamera.from_camera_info)
        if told is not None:
            return told
        image = self._first(camera_topic(camera, names.IMAGE), image_from_message)
        return mount.model if image is None else mount.model.scaled(image.shape[1], image.shape[0])

    def _first(self, name: str, read: Callable[[Any], Result]) -> Result | None:
        """What the first usable message of a topic holds, None without one; the pipeline notes the others."""
        for topic, _, data in self._bag.messages([self._topics[name]]) if name in self._topics else ():
            with suppress(ValueError, RuntimeError):
                return read(self._bag.decode(topic, data))
        return None

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _lose(self, text: str) -> None:
        """Note messages that could not be used."""
        self.lost = True
        self._note(text)

    def _conclude(self) -> None:
        for note in (*self._bag.notes, *self._bag.problems, *self._feed.notes):
            self._note(note)
        for problem in self._feed.lost:
            self._lose(problem)
        self._conclude_stages()

    def _conclude_stages(self) -> None:
        """Note what the stages could not use since they began, and what is wrong with the rig."""
        for problem, count in sorted(self._pipeline.problems.items()):
            self._lose(f'{count} message{"s" if count > 1 else ""} of {problem}')
        if self._doa is not None:
            self._conclude_sound(self._doa)
        if self._fusion is not None:
            self._conclude_fusion(self._fusion)
        for frame in sorted(self._odometry.assumed):
            self._note(f"odometry of {frame!r}: no transform from it to the body, it counts as the body's")
        for frame in sorted(self.frames.impossible):
            self._lose(f'the transform of {frame!r} is left out: its rotation is no unit quaternion')
        for frame in sorted(self.frames.unknown):
            self._lose(f'no transform from {frame!r} to the body: what is measured in it is left out')

    def _conclude_sound(self, doa: DoaStage) -> None:
        for fault in doa.faults:
            self._note(f'{names.AUDIO}: {fault}')
        if doa.restarts:
            self._note(f'{names.AUDIO}: {doa.restarts} windows began anew, after gaps or steps back of first_sample, or '
                       'samples that are not finite')

    def _conclude_fusion(self, fusion: FusionStage) -> None:
        fault = fusion.consistency.fault if fusion.consistency is not None else None
        if fault is not None:
            self._note(f'the rig is not as described: {fault}')
        if fusion.untransformed:
            self._lose(f'{fusion.untransformed} measurements left out: the gimbal\'s orientation at their time is not known')
        for name, count in fusion.gate.foreign_stamps.items():
            if count:
                self._lose(f"{count} messages of {name} left out: their stamps are more than {CLOCK_TOLERANCE_S:.0f} s "
                           f"before the bag's time, or {FUTURE_S:g} s after it")
