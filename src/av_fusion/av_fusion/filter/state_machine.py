"""The published state machine: sight leads while its confidence reaches tau, else hearing leads."""

from __future__ import annotations

import math
from dataclasses import dataclass

from av_common.track import State


@dataclass(frozen=True)
class MachineSettings:
    """`tau` is the gate on the detection confidence. The published machine has no hysteresis and no dwell time.

    A confidence counts for `sight_timeout` s after the picture it stems from, a sound for `sound_timeout` s.
    """

    tau: float = 0.5
    hysteresis: float = 0.0
    dwell: float = 0.0
    sight_timeout: float = 0.5
    sound_timeout: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.tau <= 1.0:
            raise ValueError(f'tau is {self.tau}, expected a confidence between 0 and 1')
        if not 0.0 <= self.hysteresis <= self.tau:
            raise ValueError(f'hysteresis is {self.hysteresis}, expected 0 to tau ({self.tau})')


class StateMachine:
    """Visual-Active, Acoustic-Active, coasting or none, with the reason and the time of the last change."""

    def __init__(self, settings: MachineSettings | None = None) -> None:
        self.settings = settings or MachineSettings()
        self.state = State.NONE
        self.reason = 'nothing heard or seen yet'
        self.changed = 0.0
        self.sight_confidence = 0.0
        self.sound_confidence = 0.0
        self._seen = self._heard = -math.inf

    def see(self, time: float, confidence: float) -> None:
        """A picture was looked at; `confidence` of the target's detection in it, 0 when it was not found."""
        if time >= self._seen:
            self._seen, self.sight_confidence = time, confidence

    def hear(self, time: float, confidence: float) -> None:
        """A direction was heard."""
        if time >= self._heard:
            self._heard, self.sound_confidence = time, confidence

    def step(self, time: float, tracking: bool, carried: bool = False) -> State:
        """Decide the state at `time`; without a track (`tracking` false) NONE, or COASTING where one is carried on."""
        settings = self.settings
        gate = settings.tau - (settings.hysteresis if self.state == State.VISUAL_ACTIVE else 0.0)
        sees = time - self._seen <= settings.sight_timeout
        if not tracking:
            wanted = State.COASTING if carried else State.NONE
        elif sees and self.sight_confidence >= gate:
            wanted = State.VISUAL_ACTIVE
        else:
            wanted = State.ACOUSTIC_ACTIVE if time - self._heard <= settings.sound_timeout else State.COASTING
        if wanted != self.state:
            urgent = not tracking or self.state in (State.NONE, State.COASTING)
            if urgent or time - self.changed >= settings.dwell:
                self.state, self.reason, self.changed = wanted, self._why(wanted, gate, sees, tracking), time
        return self.state

    def diagnostics(self) -> dict[str, str]:
        """State and reason, for people."""
        return {'state': self.state.name, 'reason': self.reason}

    def _why(self, state: State, gate: float, sees: bool, tracking: bool) -> str:
        if state == State.NONE:
            return 'no target: nothing heard or seen that could be followed'
        if not tracking:
            return 'what is heard and seen does not fit the track: carried on'
        if state == State.VISUAL_ACTIVE:
            return f'sight confidence {self.sight_confidence:.2f} >= {gate:.2f}'
        blind = f'sight confidence {self.sight_confidence:.2f} < {gate:.2f}' if sees else 'no picture'
        return blind if state == State.ACOUSTIC_ACTIVE else f'{blind} and no sound'
