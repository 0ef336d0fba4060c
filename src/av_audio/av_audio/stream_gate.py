"""Which audio frames belong to the stream that is heard, where another source sends frames, too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

MOST_GAP_S = 1.0  # of lost samples, which a stream may continue behind
STAMP_S = 0.05  # by which stamps may deviate from the count of samples
TAKEN_AFTER_S = 0.3  # of another stream without a frame of the present one
MOST_CANDIDATES = 32  # streams that may take over; each frame that continues none of them begins one


class Frame(Protocol):
    """The fields of an `AudioFrame` by which streams are told apart."""

    sample_rate: int
    channels: int
    first_sample: int


@dataclass
class _Stream:
    """A sequence of frames.

    Parameters:
        sample_rate (Hz), channels: of its frames.
        next_sample: index of the first sample that is expected.
        next_stamp (s): its capture time.
        length (s): of sound behind its first frame.
    """

    sample_rate: int
    channels: int
    next_sample: int
    next_stamp: float
    length: float

    @classmethod
    def of(cls, frame: Frame, samples: int, stamp: float) -> _Stream:
        """The stream that a frame begins."""
        seconds = samples / max(frame.sample_rate, 1)
        return cls(frame.sample_rate, frame.channels, frame.first_sample + samples, stamp + seconds, 0.0)

    def is_continued_by(self, frame: Frame, stamp: float) -> bool:
        """Whether a frame follows, perhaps behind a gap: index and stamp agree."""
        if (frame.sample_rate, frame.channels) != (self.sample_rate, self.channels) or not self.sample_rate:
            return False
        gap = (frame.first_sample - self.next_sample) / self.sample_rate
        return 0.0 <= gap <= MOST_GAP_S and abs(stamp - self.next_stamp - gap) <= STAMP_S

    def extend(self, frame: Frame, samples: int, stamp: float) -> None:
        """Append a frame of `samples` per channel, captured at `stamp` (s)."""
        seconds = samples / self.sample_rate
        self.next_sample, self.next_stamp = frame.first_sample + samples, stamp + seconds
        self.length += seconds


class StreamGate:
    """Admits the frames of one stream.

    A frame continues a stream by the index of its first sample and by its stamp. Others are of another source, or of one that
    has started again: it takes over with TAKEN_AFTER_S more of sound, if no frame has continued the stream meanwhile.

    Attributes:
        refused: number of frames that were not admitted.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._stream: _Stream | None = None
        self._candidates: list[_Stream] = []

    def forget(self) -> None:
        """Admit any next frame."""
        self._stream, self._candidates = None, []

    def admit(self, frame: Frame, samples: int, stamp: float) -> bool:
        """Whether a frame belongs to the stream that is heard.

        Parameters:
            frame: the frame.
            samples: number of its samples per channel.
            stamp (s): capture time of the first of them.
        """
        if self._stream is None:
            self._stream = _Stream.of(frame, samples, stamp)
        elif self._stream.is_continued_by(frame, stamp):
            self._stream.extend(frame, samples, stamp)
        elif (candidate := self._candidate(frame, samples, stamp)).length >= TAKEN_AFTER_S:
            self._stream = candidate
        else:
            self.refused += 1
            return False
        self._candidates = []
        return True

    def _candidate(self, frame: Frame, samples: int, stamp: float) -> _Stream:
        """The other stream to which a frame belongs, including it."""
        for candidate in self._candidates:
            if candidate.is_continued_by(frame, stamp):
                candidate.extend(frame, samples, stamp)
                return candidate
        begun = _Stream.of(frame, samples, stamp)
        self._candidates = [*self._candidates[1 - MOST_CANDIDATES:], begun]
        return begun
