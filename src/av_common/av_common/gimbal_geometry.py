"""Angles of a gimbal, directions, and the gimbal's orientation on the rig's body.

The gimbal turns about its mount's z axis by pan, counter-clockwise, and then up by tilt. The mount of a stabilized gimbal is
fixed to `base_stabilized`, which has the body's heading but no roll and pitch; that of another gimbal to the body.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from transforms3d.axangles import axangle2mat
from transforms3d.quaternions import quat2mat

from av_common.angles import angles_to_direction, wrap
from av_common.frames import yaw_of
from av_common.rig import GimbalMount

BASE_STABILIZED = 'base_stabilized'
LEVEL = (1.0, 0.0, 0.0, 0.0)  # attitude (w, x, y, z) of a rig that is level, facing east


def stabilized_to_body(attitude_wxyz: Sequence[float]) -> NDArray:
    """Rotation matrix (3, 3) from `base_stabilized` to the body, which has the attitude (w, x, y, z) in the world (ENU)."""
    heading: NDArray = axangle2mat((0.0, 0.0, 1.0), yaw_of(attitude_wxyz))
    return quat2mat(attitude_wxyz).T @ heading


def gimbal_to_mount(pan: float, tilt: float, roll: float = 0.0) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) from the gimbal's frame to its mount's.

    Parameters:
        pan (rad): counter-clockwise.
        tilt (rad): up.
        roll (rad): of the axis between those of pan and tilt, about x.
    """
    pan_turn, tilt_turn = axangle2mat((0.0, 0.0, 1.0), pan), axangle2mat((0.0, 1.0, 0.0), -tilt)
    return pan_turn @ (axangle2mat((1.0, 0.0, 0.0), roll) @ tilt_turn if roll else tilt_turn)


def gimbal_to_body(gimbal: GimbalMount, pan: float, tilt: float, attitude_wxyz: Sequence[float] = LEVEL
                   ) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) from the gimbal's frame to the body.

    Parameters:
        gimbal: how it is mounted.
        pan, tilt (rad): angles about the mount's axes, counter-clockwise and up.
        attitude_wxyz: attitude (w, x, y, z) of the body in the world (ENU), against which a stabilized gimbal stays level.
    """
    turned = gimbal.mount.rotation @ gimbal_to_mount(pan, tilt)
    return stabilized_to_body(attitude_wxyz) @ turned if gimbal.stabilized else turned


def pan_and_tilt(gimbal: GimbalMount, gimbal_in_body: NDArray[np.float64], attitude_wxyz: Sequence[float] = LEVEL
                 ) -> tuple[float, float]:
    """Pan and tilt (rad) of an orientation: the inverse of `gimbal_to_body`, which needs no roll.

    Parameters:
        gimbal: how it is mounted.
        gimbal_in_body (3, 3): rotation matrix from the gimbal's frame to the body.
        attitude_wxyz: as in `gimbal_to_body`.
    """
    sight = gimbal_in_body[:, 0]
    if gimbal.stabilized:
        sight = stabilized_to_body(attitude_wxyz).T @ sight
    return _angles(gimbal.mount.rotation.T @ sight)


def angles_of_command(gimbal: GimbalMount, pan: float, tilt: float, stabilized: bool, attitude_wxyz: Sequence[float] = LEVEL
                      ) -> tuple[float, float]:
    """Pan and tilt (rad) about the mount's axes of a commanded direction; pan keeps its number of whole turns.

    Parameters:
        gimbal: how it is mounted.
        pan, tilt (rad): direction of the command.
        stabilized: whether the command is in `base_stabilized`, else in the body's frame.
        attitude_wxyz: as in `gimbal_to_body`.
    """
    sight = angles_to_direction(pan, tilt)
    if stabilized != gimbal.stabilized:
        level = stabilized_to_body(attitude_wxyz)
        sight = level @ sight if stabilized else level.T @ sight
    turned, raised = _angles(gimbal.mount.rotation.T @ sight)
    ahead, sense = _pan_of_mount(gimbal)
    wanted = sense * (pan - ahead)
    return wanted + wrap(turned - wanted), raised


def command_of_angles(gimbal: GimbalMount, pan: float, tilt: float) -> tuple[float, float]:
    """Direction (rad) of angles, in `base_stabilized` for a stabilized gimbal, else in the body's frame; pan keeps its turns.

    Parameters:
        gimbal: how it is mounted.
        pan, tilt (rad): angles about the mount's axes.
    """
    azimuth, elevation = _angles(gimbal.mount.rotation @ angles_to_direction(pan, tilt))
    ahead, sense = _pan_of_mount(gimbal)
    wanted = ahead + sense * pan
    return wanted + wrap(azimuth - wanted), elevation


def sense_of(gimbal: GimbalMount) -> float:
    """-1 for a gimbal that is mounted upside down, whose pan and tilt are about reversed axes, else 1."""
    return math.copysign(1.0, gimbal.mount.rotation[2, 2])


def _pan_of_mount(gimbal: GimbalMount) -> tuple[float, float]:
    """Azimuth (rad) of the mount's x axis, and the sense of its pan."""
    x, y, _ = gimbal.mount.rotation[:, 0].tolist()
    return math.atan2(y, x), sense_of(gimbal)


def _angles(sight: NDArray[np.float64]) -> tuple[float, float]:
    x, y, z = sight.tolist()
    return math.atan2(y, x), math.atan2(z, math.hypot(x, y))
