"""The rig's own noise, learned in flight: another propeller, one louder rotor or cold air is in no recording of before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from av_audio.ego_noise import NoiseRecording

# Thirty independent windows of 0.3 s: four snapshots of each of eight microphones keep the loss of a covariance that is
# averaged below 1.5 dB (Reed, Mallett and Brennan, 1974: 2 M keep it below 3 dB).
LEARNED_S = 10.0


class EgoLearning:
    """What is known of the rig's noise: its recording, or the sound of seconds in which someone said that it is alone.

    Sound does not tell when that is. A target that stays has a place in the covariance, as a rotor has, and would be whitened
    away; and where the recording no longer fits, own noise is a direction with confidence (`docs/decisions.md`).

    Parameters:
        recording: what is known at the beginning; None where nothing is.
    """

    def __init__(self, recording: NoiseRecording | None) -> None:
        self._recording = recording
        self._pieces: list[NDArray[np.float32]] | None = None  # (n, m) each; None while nothing is learned
        self.known = recording
        self.refusal = ''  # why the newest attempt failed

    @property
    def is_learning(self) -> bool:
        """Whether it listens."""
        return self._pieces is not None

    def begin(self) -> None:
        """Listen from now on; what was heard in an unfinished attempt is discarded."""
        self._pieces, self.refusal = [], ''

    def interrupt(self) -> None:
        """Listen anew, in an attempt: what follows does not continue what was heard."""
        if self._pieces is not None:
            self._pieces = []

    def begin_stream(self, sample_rate: int) -> None:
        """Listen anew, and forget what was learned at another sample rate than that (Hz) of the stream that begins."""
        self.interrupt()
        if self.known is not None and self.known.sample_rate != sample_rate:
            self.known = self._recording

    def forget(self) -> None:
        """Know the recording alone."""
        self._pieces, self.known, self.refusal = None, self._recording, ''

    def add(self, samples: NDArray[np.float32], sample_rate: int) -> bool:
        """Take the next samples of the stream; returns whether another noise is known from now on.

        Parameters:
            samples (n, m): of all channels, full scale 1.
            sample_rate (Hz): of the stream.
        """
        if self._pieces is None:
            return False
        self._pieces.append(samples)
        if sum(map(len, self._pieces)) < LEARNED_S * sample_rate:
            return False
        heard = NoiseRecording(np.concatenate(self._pieces), sample_rate, 'noise learned in flight')
        self._pieces = None
        try:
            heard.check(samples.shape[1], sample_rate)
        except ValueError as error:
            self.refusal = str(error)
            return False
        self.known = heard
        return True
