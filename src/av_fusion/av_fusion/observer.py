"""What recorders and tests learn from a fusion stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from vision_msgs.msg import Detection2DArray

from av_common.track import Track
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement


class FusionObserver(Protocol):
    """Receives all measurements and tracks of a `FusionStage`."""

    def on_doa(self, measurements: Sequence[DoaMeasurement], arrival: float) -> None:
        """The measurements of one `DoaArray`, most confident first, whether or not they are used.

        Parameters:
            measurements: measurements in the body frame.
            arrival (s): time of arrival of the message.
        """

    def on_camera(self, measurement: CameraMeasurement, message: Detection2DArray, arrival: float) -> None:
        """The measurement of one `Detection2DArray`.

        Parameters:
            measurement: measurement in the body frame.
            message: the message.
            arrival (s): time of its arrival.
        """

    def on_track(self, track: Track, time: float) -> None:
        """The track at `time`, from which an output is made.

        Parameters:
            track: the estimate.
            time (s): time of the output.
        """
