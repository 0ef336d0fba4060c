"""Real-time simulation over UDP: RFlySim's datagrams are sent, and commands to the rig are received."""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from av_common.launched import BEAT_PERIOD_S, beat
from av_sim_bridge.receiving.allowed_senders import AllowedSenders, resolve
from av_sim_bridge.vehicle import VehicleState, from_truth, to_imu, to_truth
from av_sim_bridge.wire import WireError
from av_sim_bridge.wire.audio import AudioFormat, AudioHeader, encode_audio
from av_sim_bridge.wire.gimbal import encode_gimbal
from av_sim_bridge.wire.image import EncodedImage, encode_image
from av_sim_bridge.wire.imu import encode_imu
from av_sim_bridge.wire.oracle import encode_oracle
from av_sim_bridge.wire.ports import FIRST_TARGET, RIG, TIME_SYNC_GROUP, Ports
from av_sim_bridge.wire.rig_control import RigControl, decode_rig_control
from av_sim_bridge.wire.time_sync import TimeSync, encode_time_sync
from av_sim_bridge.wire.truth import VehicleTruth, decode_truth, encode_truth, is_truth
from av_simulator.motion.axes import COMMAND_LIFETIME
from av_simulator.rendering.render_process import CameraFrame, RenderProcess
from av_simulator.run import BLOCKS_PER_SECOND, TRUTH_RATE, times
from av_simulator.sockets import ControlPort, address_towards, sending_socket
from av_simulator.world import World

log = logging.getLogger('simulator')


@dataclass(frozen=True)
class WireOptions:
    """Addresses, rates and formats of the datagrams.

    Parameters:
        host: receiver of all streams except the time synchronisation, which is multicast.
        ports: UDP ports of the streams.
        bind_address: address of this machine from which is sent, and at which commands arrive; empty: by which `host` is
            reached.
        allowed_senders: senders of commands that are obeyed (see `AllowedSenders`); empty: the bridge at `host`, which sends
            them from the port of the rig's true state.
        audio_header: whether audio datagrams have this project's header, which allows exact detection of losses.
        image_rate (Hz): rate of images, 0 for none.
        depth: whether the depth of every image is sent to the next port.
        renderer: kind of renderer, see `make_renderer`.
    """

    host: str = '127.0.0.1'
    ports: Ports = field(default_factory=Ports)
    bind_address: str = ''
    allowed_senders: tuple[str, ...] = ()
    audio_header: bool = False
    image_rate: float = 15.0
    depth: bool = False
    renderer: str = 'auto'


class Simulator:
    """Runs a world in real time. `run` returns after the duration or when any thread calls `stop`.

    Attributes:
        counts: numbers of what was sent, received and omitted.

    Parameters:
        world: the simulated world.
        options: addresses, rates and formats.
        clock: source of time, which has `monotonic`, `time` and `sleep` as the module `time`.
        send: function of a datagram and its address (host, port); None for a UDP socket.
    """

    LATE = 0.1         # s, delay from which a block counts as late
    MOST_LATE = 1.0    # s, delay after which the schedule is shifted, or what is missed left out where others share the world

    def __init__(self, world: World, options: WireOptions = WireOptions(), clock: Any = time,
                 send: Callable[[bytes, tuple[str, int]], object] | None = None) -> None:
        self.world, self.options, self.counts = world, options, Counter[str]()
        self._layout = AudioFormat(channels=world.rig.array.geometry.channels, sample_rate=world.sample_rate)
        self._host = resolve('host', options.host)
        address = options.bind_address or address_towards(self._host)
        bridge = f'{self._host}:{options.ports.rig_truth}'
        self._control = ControlPort(options.ports.control, address, AllowedSenders(options.allowed_senders or [bridge]))
        self._socket = sending_socket(address)
        self._clock, self._send_to = clock, send or self._socket.sendto
        self._stopped = False
        self._renderers: dict[str, RenderProcess] = {}    # by camera
        self._start = math.nan    # s, monotonic time of the world's beginning, NaN before
        self._start_ms = 0
        self._sequence = 0
        self._newest: dict[type, tuple[float, float]] = {}    # number by the sender and time (s) of arrival, by what it is
        self._lossy = np.random.default_rng([world.seed, 16])
        self._begin: float | None = None
        self._beaten = -math.inf    # s, monotonic time of the newest heartbeat

    def stop(self) -> None:
        """End `run` within a block; may be called from a signal handler."""
        self._stopped = True

    def close(self) -> None:
        """Close the sockets."""
        self._socket.close()
        self._control.close()

    def run(self, duration: float, begin: float | None = None) -> None:
        """Simulate until the end of the duration or a call of `stop`. Raises exceptions of the renderer.

        Others whose beginning is the same share the world: this one joins them at the present simulated time, and never falls
        behind by shifting its schedule.

        Parameters:
            duration (s): simulated time.
            begin (s): Unix time of the start, None for now.
        """
        self._begin = begin
        samples = self.world.sample_rate // BLOCKS_PER_SECOND
        beat(busy=True)
        for camera in self.world.rig.cameras if self.options.image_rate else ():
            self._renderers[camera] = RenderProcess(
                self.world.renderer_factory(camera), self.options.renderer, self.world.view(0, 0.0, camera),
                self.options.depth and camera == 'camera')
        try:
            for renderer in self._renderers.values():
                renderer.open(lambda: not self._stopped)
            while self.world.time < duration and not self._stopped:
                self._step(samples)
        finally:
            beat(busy=True)
            for camera, renderer in self._renderers.items():
                self._send_images(camera, renderer.close())

    def _step(self, samples: int) -> None:
        self._beat()
        self._take_commands()
        begin = self.world.time
        sound = self.world.advance(samples)
        end = self.world.time
        if math.isnan(self._start):    # start after the first step, which is slower than the others
            self._start, self._start_ms = self._wait_for_begin()
        if self._begin is not None and self._lag(end) > self.MOST_LATE:
            self._join(begin)
            return
        for due, send in self._schedule(begin, end):
            if not self._wait_until(due):
                return
            send(due)
        if self._wait_until(end):
            self._send_sound(sound, begin)
            self._watch_lag(end)

    def _beat(self) -> None:
        """Tell the launch that the simulation goes on."""
        now = self._clock.monotonic()
        if now - self._beaten >= BEAT_PERIOD_S:
            beat()
            self._beaten = now

    def _wait_for_begin(self) -> tuple[float, int]:
        """Monotonic time (s) and Unix time (ms) of the world's beginning."""
        while self._begin is not None and (remaining := self._begin - self._clock.time()) > 0 and not self._stopped:
            self._beat()
            self._clock.sleep(min(remaining, 0.1))
        now = self._clock.time()
        begin = now if self._begin is None else min(self._begin, now)
        return self._clock.monotonic() - (now - begin), int(1e3 * begin)

    def _join(self, begin: float) -> None:
        """Go on at the present simulated time of a shared world, without the sound from `begin` (s) until then."""
        log.warning('%.1f s behind the others in this world: skipped', self._lag(self.world.time))
        while (lag := self._lag(self.world.time)) > 0.0 and not self._stopped:
            self._beat()
            self.world.skip(min(lag, 1.0))
        self._sequence += round((self.world.time - begin) * BLOCKS_PER_SECOND)

    def _schedule(self, begin: float, end: float) -> list[tuple[float, Callable[[float], None]]]:
        """Times in (begin, end] and the functions to call at them, in order."""
        moments = times(begin, end, TRUTH_RATE)
        targets = [self.world.target_states(number, moments) for number in range(len(self.world.scenario.targets))]
        events: list[tuple[float, Callable[[float], None]]] = [
            (moment, partial(self._send_truth, states)) for moment, *states in zip(moments, *targets, strict=True)]
        events += [(moment, self._request_image) for moment in times(begin, end, self.options.image_rate)]
        events += [(moment, self._send_time_sync) for moment in times(begin, end, 1.0)]
        return sorted(events, key=lambda event: event[0])

    def _wait_until(self, moment: float) -> bool:
        """Sleep until the simulated time `moment` (s) and send completed images meanwhile; False if stopped."""
        while True:
            left = max(-self._lag(moment), 0.0)
            busy = [camera for camera, renderer in self._renderers.items() if renderer.busy]
            for camera in busy:
                self._send_images(camera, self._renderers[camera].ready(left / len(busy)))
            if not busy:
                self._clock.sleep(left)
            if self._stopped or self._lag(moment) >= 0.0:
                return not self._stopped

    def _lag(self, moment: float) -> float:
        """Delay (s) of the simulated time `moment` (s) relative to real time."""
        return self._clock.monotonic() - self._start - moment

    def _watch_lag(self, moment: float) -> None:
        lag = self._lag(moment)
        if lag > self.LATE:
            self.counts['late_blocks'] += 1
            if self.counts['late_blocks'] == 1:
                log.warning('%.0f ms behind real time at %.1f s', 1e3 * lag, moment)
        if lag > self.MOST_LATE and self._begin is None:
            self._start += lag
            self._start_ms += round(1e3 * lag)
            self.counts['resynchronised'] += 1
            if self.counts['resynchronised'] in (1, 10, 100, 1000):
                log.warning('%.1f s behind real time: schedule shifted %d times so far', lag, self.counts['resynchronised'])

    def _take_commands(self) -> None:
        for datagram in self._control.receive():
            try:
                self._follow(decode_truth(datagram)) if is_truth(datagram) else self._obey(decode_rig_control(datagram))
            except WireError as error:
                self.counts['malformed_commands'] += 1
                log.debug('%s', error)
        self.counts['refused_commands'] = self._control.refusals.total

    def _is_new(self, kind: type, number: float) -> bool:
        """Whether a command or pose is not older than all before, or none came for COMMAND_LIFETIME: its sender began anew."""
        newest, arrived = self._newest.get(kind, (number, 0.0))
        new = number >= newest or self.world.time - arrived > COMMAND_LIFETIME
        if new:
            self._newest[kind] = number, self.world.time
        self.counts['commands' if new else 'old_commands'] += 1
        return new

    def _follow(self, pose: VehicleTruth) -> None:
        """Move the rig to a pose that is new. Raises WireError for that of another vehicle."""
        if pose.copter_id != RIG:
            raise WireError(f'control port: pose of vehicle {pose.copter_id}, expected {RIG}')
        if self._is_new(VehicleTruth, pose.time):
            self.world.dynamics.follow(from_truth(pose))

    def _obey(self, command: RigControl) -> None:
        """Execute a command that is new."""
        if not self._is_new(RigControl, command.sequence):
            return
        if command.yaw_rate is not None:
            self.world.dynamics.command(command.yaw_rate, self.world.time)
        if command.pan is not None and command.tilt is not None:
            self.world.dynamics.look(command.pan, command.tilt, self.world.time)

    def _send(self, datagram: bytes, port: int, host: str | None = None) -> None:
        if self._lossy.random() < self.world.scenario.faults.lost_datagrams:
            self.counts['lost_on_purpose'] += 1
            return
        try:
            self._send_to(datagram, (host or self._host, port))
        except OSError as error:
            self.counts['unsent'] += 1
            if self.counts['unsent'] == 1:
                log.warning('cannot send to %s:%d: %s', host or self.options.host, port, error.strerror)

    def _send_sound(self, sound: NDArray, begin: float) -> None:
        header = AudioHeader(self._sequence, len(sound), begin) if self.options.audio_header else None
        self._send(encode_audio(self._layout, sound, header), self.options.ports.audio)
        self._sequence += 1
        self.counts['audio_frames'] += len(sound)

    def _send_truth(self, targets: list[VehicleState], moment: float) -> None:
        ports = self.options.ports
        rig = self.world.rig_state(moment)
        self._send(encode_truth(to_truth(rig, RIG)), ports.rig_truth)
        number = round(moment * TRUTH_RATE)
        self._send(encode_imu(to_imu(rig, number)), ports.imu)
        gimbal = self.world.gimbal_sample(number, moment)
        if gimbal is not None:
            self._send(encode_gimbal(gimbal), ports.gimbal)
        for number, target in enumerate(targets):
            self._send(encode_truth(to_truth(target, FIRST_TARGET + number)), ports.target_truth + 2 * number)

    def _send_time_sync(self, moment: float) -> None:
        now = self._start_ms + round(moment * 1e3)
        self._send(encode_time_sync(TimeSync(RIG, self._start_ms, now, round(moment))), self.options.ports.time_sync,
                   TIME_SYNC_GROUP)

    def _request_image(self, moment: float) -> None:
        if self._lag(moment) > self.LATE:    # sound has priority over images
            self.counts['images_skipped'] += 1
            return
        for camera, renderer in self._renderers.items():
            if not renderer.request(self.world.view(round(moment * self.options.image_rate), moment, camera)):
                self.counts['images_skipped'] += 1

    def _send_images(self, camera: str, frames: list[CameraFrame]) -> None:
        port = self.options.ports.image if camera == 'camera' else self.options.ports.second_image
        for frame in frames:
            for data, receiver in ((frame.encoded, port), (frame.depth, self.options.ports.depth)):
                for datagram in encode_image(EncodedImage(frame.view.time, data)):
                    self._send(datagram, receiver)
            self._send(encode_oracle(frame.boxes), port)
            self.counts['images'] += 1
