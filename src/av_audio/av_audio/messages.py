"""AudioFrame and DoaArray messages: samples of a frame, frames of samples, and the message of a DOA estimate."""

from __future__ import annotations

import array
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import Header

from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray
from av_common.pose_messages import vector_message
from av_common.stamps import to_stamp
from av_interfaces.msg import AudioFrame, Doa, DoaArray, DoaOdds

UNKNOWN = (math.nan, math.nan, math.nan)  # nothing is known of a sound

if TYPE_CHECKING:    # what computes them takes a while to import
    from av_audio.localizer import DoaEstimate


def samples_of(frame: AudioFrame) -> NDArray[np.float32]:
    """Samples (n, channels) of a frame, full scale 1. Raises ValueError when their number does not fit the channels."""
    if frame.channels < 1:
        raise ValueError('audio frame without channels')
    if len(frame.samples) % frame.channels:
        raise ValueError(f'{len(frame.samples)} samples are not a multiple of {frame.channels} channels')
    return np.asarray(frame.samples, np.float32).reshape(-1, frame.channels)


def audio_frame(samples: NDArray[np.float32], first_sample: int, sample_rate: int, header: Header) -> AudioFrame:
    """The message of a block of samples.

    Parameters:
        samples (n, channels): full scale 1.
        first_sample: index of the first sample since the stream began.
        sample_rate (Hz): sample rate of the stream.
        header: capture time of the first sample, and the frame of the microphone array.
    """
    interleaved = array.array('f', np.ascontiguousarray(samples, np.float32).tobytes())
    return AudioFrame(header=header, sample_rate=sample_rate, channels=samples.shape[1], first_sample=first_sample,
                      samples=interleaved)


def doa_array(estimate: DoaEstimate, microphones: MicrophoneArray, stamp: float, frame_id: str, window_s: float,
              method: str, judgements: Sequence[tuple[float, float, float]] = ()) -> DoaArray:
    """The message of one analysis window.

    A linear array measures the angle to its axis only: the message holds the axis, and each hypothesis the cosine of the
    estimated angle, with the variance of its error. The two images of a planar array, one on each side
    of its plane, are no such cone: the axis is zero and the cosines are NaN.

    Parameters:
        estimate: directions in the array's frame.
        microphones: the array with which `estimate` was made.
        stamp (s): capture time of the window's centre.
        frame_id: the array's frame.
        window_s (s): length of the window.
        method: name of the estimator.
        judgements: what is known of the sound of each source (see `Judgement`); empty for nothing.
    """
    axis = microphones.basis[:, 0] if microphones.rank == 1 else np.zeros(3)
    message = DoaArray(header=Header(stamp=to_stamp(stamp), frame_id=frame_id), window=window_s, method=method,
                       level=float(estimate.level_dbfs), axis=vector_message(axis))
    judged = judgements or [UNKNOWN] * len(estimate.sources)
    message.hypotheses = [image for source, judgement in zip(estimate.sources, judged, strict=True)
                          for image in _images(source, judgement)]
    return message


def doa_odds(estimate: DoaEstimate, header: Header) -> DoaOdds:
    """The odds over the cosine of one analysis window, with the header of its `DoaArray`."""
    return DoaOdds(header=header, odds=estimate.odds.astype(np.float32))


def _images(source: DoaEstimate, judgement: tuple[float, float, float]) -> list[Doa]:
    """The hypotheses of one source."""
    probability, fundamental, variance = judgement
    directions = angles_to_direction(source.azimuth, source.elevation)
    return [Doa(
        direction=vector_message(direction), azimuth=float(source.azimuth[k]), elevation=float(source.elevation[k]),
        azimuth_variance=float(source.azimuth_variance[k]), elevation_variance=float(source.elevation_variance[k]),
        cosine=float(source.cosine), cosine_variance=float(source.cosine_variance),
        confidence=float(source.confidence[k]), ambiguity_group=int(source.group[k]),
        end_fire=bool(source.end_fire[k]), drone_probability=probability, fundamental=fundamental,
        fundamental_variance=variance) for k, direction in enumerate(directions)]
