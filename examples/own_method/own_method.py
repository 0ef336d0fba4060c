"""Three methods of one's own: an estimator of directions, a tracker and a detector, none of which knows anything of ROS."""

import cv2
import numpy as np

from av_audio import Direction
from av_fusion import PlainTracker


def loudest_delay(array, sample_rate):
    """For a pair of microphones: the delay at which their samples agree best, without weights."""
    (baseline,) = np.diff(array.positions @ array.basis[:, 0])  # m; positive if the second microphone is ahead

    def estimate(samples):
        first, second = (samples - samples.mean(axis=0)).T
        most = int(abs(baseline) / 343.0 * sample_rate) + 1
        agreement = [np.dot(first[most:-most], np.roll(second, lag)[most:-most]) for lag in range(-most, most + 1)]
        delay = (int(np.argmax(agreement)) - most) / sample_rate  # s by which the second microphone is ahead
        angle = np.arccos(np.clip(delay * 343.0 / baseline, -1.0, 1.0))
        axis = np.arctan2(array.basis[1, 0], array.basis[0, 0])
        return [Direction(axis - angle, np.radians(6.0) ** 2, confidence=0.9)]

    return estimate


class NewestBearing(PlainTracker):
    """The newest measurement, held until the next one."""

    def restart(self):
        self.newest = None

    def update(self, time, azimuth, variance, source):
        self.newest = azimuth, variance

    def predict(self, time):
        return self.newest


def dark_specks(parameters):
    """Dark objects before a bright background."""
    def detect(image):
        dark = cv2.threshold(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), 60, 255, cv2.THRESH_BINARY_INV)[1]
        found = [cv2.boundingRect(contour) for contour in cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]]
        return [(x, y, x + w, y + h) for x, y, w, h in found], [0.6] * len(found)

    return detect
