"""How targets move, as seen from the rig."""

from __future__ import annotations

from typing import NamedTuple

CLIMB_S = 1.0  # time constant of changes of the vertical rate of targets close to the horizon


class MotionModel(NamedTuple):
    """Motion of targets as seen from the rig.

    Parameters:
        acceleration_density (rad^2/s^3): spectral density of the angular acceleration.
        elevation_density (rad^2/s): diffusion of the elevation of targets close to the horizon.
        usual_elevation (rad), usual_elevation_variance (rad^2): its stationary distribution.
        usual_inverse_range (1/m): mean and standard deviation of the inverse range.
    """

    acceleration_density: float
    elevation_density: float
    usual_elevation: float
    usual_elevation_variance: float
    usual_inverse_range: float = 0.03

    @property
    def climb_variance(self) -> float:
        """Variance (rad^2/s^2) of the vertical rate of targets close to the horizon: half of their diffusion."""
        return 0.25 * self.elevation_density / CLIMB_S
