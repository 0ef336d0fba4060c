"""The published state machine: the camera leads while its score reaches tau, else the microphones lead."""

from __future__ import annotations

import math

from av_common.track import State

SIGHT_TIMEOUT_S, SOUND_TIMEOUT_S = 0.5, 1.0  # age up to which an image, or a direction of arrival, is used


class StateMachine:
    """Decides which sensor leads.

    Attributes:
        tau: score of a detection from which the camera leads.
        state: the current state.
        reason: reason of the last change.
        changed (s): time of the last change.
        sight_confidence: score of the target's detection in the newest image, 0 without one; of several cameras the best.
        sound_confidence: confidence of the newest direction of arrival. Both as of the newest step: 0 for what is too old.

    Parameters:
        tau: see the attribute.
    """

    def __init__(self, tau: float = 0.5) -> None:
        self.tau = tau
        self.state, self.reason, self.changed = State.NONE, 'no measurement yet', 0.0
        self.restart()

    def restart(self) -> None:
        """Forget all measurements; the state stays until the next step."""
        self.sight_confidence = self.sound_confidence = 0.0
        self._sights: dict[str, tuple[float, float]] = {}  # time and score, by camera
        self._heard = -math.inf, 0.0  # time and confidence

    def on_image(self, time: float, score: float, camera: str = '') -> None:
        """Use the score of the target's detection in an image, 0 if it was not detected.

        Parameters:
            time (s): capture time of the image.
            score: score 0..1.
            camera: name of the camera.
        """
        if time >= self._sights.get(camera, (-math.inf, 0.0))[0]:
            self._sights[camera] = time, score

    def on_doa(self, time: float, confidence: float) -> None:
        """Use the confidence of a direction of arrival.

        Parameters:
            time (s): centre of the window.
            confidence: confidence 0..1.
        """
        if time >= self._heard[0]:
            self._heard = time, confidence

    def step(self, time: float, tracked: bool, why: str = '', heard: float | None = None) -> State:
        """The state at `time`.

        Parameters:
            time (s): time of the decision.
            tracked: whether a target is followed; without one the state is NONE.
            why: why none is followed; empty where nothing is tracked.
            heard (s): capture time of the newest direction of arrival that supports the target; None: of any.
        """
        recent = [score for at, score in self._sights.values() if time - at <= SIGHT_TIMEOUT_S]
        newest_doa, confidence = self._heard
        self.sight_confidence = max(recent, default=0.0)
        self.sound_confidence = confidence if time - newest_doa <= SOUND_TIMEOUT_S else 0.0
        weak_sight = f'sight confidence {self.sight_confidence:.2f} < {self.tau:.2f}' if recent else 'no recent image'
        if not tracked:
            wanted, reason = State.NONE, f'no target: {why or "nothing is heard or seen"}'
        elif self.sight_confidence > 0.0 and self.sight_confidence >= self.tau:  # tau may be 0
            wanted, reason = State.VISUAL_ACTIVE, f'sight confidence {self.sight_confidence:.2f} >= {self.tau:.2f}'
        elif time - (newest_doa if heard is None else heard) <= SOUND_TIMEOUT_S:
            wanted, reason = State.ACOUSTIC_ACTIVE, weak_sight
        else:
            wanted = State.COASTING
            reason = f'{weak_sight} and no recent direction of arrival that fits the track: it is predicted'
        if wanted != self.state or time < self.changed:  # a clock may be set back
            self.changed = time
        if wanted != self.state or not tracked:
            self.state, self.reason = wanted, reason
        return self.state

    def diagnostics(self) -> dict[str, str]:
        """State and reason, as texts for diagnostics."""
        return {'state': self.state.name, 'reason': self.reason}
