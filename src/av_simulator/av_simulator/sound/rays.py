"""Surroundings of sources and microphones, and the paths of sound in them: direct, and reflected by ground, faces and walls.

A reflected ray is a straight line to a mirror image of the receiver, mirror @ receiver + shift. Its `factor` (F,) is the
response of the amplitude at the frequencies for which the rays were made. Edges: Kurze and Anderson, Sound attenuation by
barriers, 1971, after Maekawa 1968.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import bounded
from av_simulator.sound.ground import Ground
from av_simulator.sound.obstacles import OBSTACLES, Absorption, Box, Obstacle, detours, reflection_factor
from av_simulator.sound.reverberation import NARROWEST, ReverbZone

_MARGIN_M = 1.5  # m, distance from the path beyond which an edge has an effect below 100 Hz only
_MOST_LOSS_DB = 25.0  # maximum loss, limited by scattering (ISO 9613-2:1996, 7.4)
_COHERENT_M = 0.5  # m, difference of path lengths over which turbulence destroys the coherence of two waves
_CLEAR_NUMBER = -0.2  # Fresnel number below which an edge has no effect


@dataclass(frozen=True)
class Room:
    """A box-shaped room whose walls reflect the sound of sources in it to microphones in it. Raises ValueError.

    It is the method of image sources (Allen and Berkley 1979). What is outside is heard as without the room.

    Parameters:
        minimum, maximum (m, ENU): corners.
        absorption: absorption coefficients of the walls, one value or one for each octave.
        order: maximum number of reflections of a ray.
    """

    minimum: Sequence[float] = bounded(low=-1e3, high=1e3, longest=3)
    maximum: Sequence[float] = bounded(low=-1e3, high=1e3, longest=3)
    absorption: Absorption = (0.2,)
    order: int = bounded(2, low=0, high=8)

    def __post_init__(self) -> None:
        if not len(self.minimum) == len(self.maximum) == 3 or np.subtract(self.maximum, self.minimum).min() < NARROWEST:
            raise ValueError(f'room minimum is {list(self.minimum)} and maximum {list(self.maximum)}, '
                             f'expected x, y, z, minimum < maximum by at least {NARROWEST} m')
        reflection_factor(self.absorption, np.zeros(1))   # raises ValueError for impossible ones


@dataclass(frozen=True)
class Surroundings:
    """Surroundings of sources and microphones. Raises ValueError for a ground in addition to a room.

    Parameters:
        ground: a plane that reflects sound.
        obstacles: obstacles that shade and reflect sound.
        room: walls, floor and ceiling.
        zones: zones with late reverberation.
    """

    ground: Ground | None = None
    obstacles: Sequence[Annotated[Obstacle, OBSTACLES]] = ()
    room: Room | None = None
    zones: Sequence[ReverbZone] = ()

    def __post_init__(self) -> None:
        if self.ground is not None and self.room is not None:
            raise ValueError('ground and room are both given, expected one: the floor of the room is its ground')


def edge_loss_db(detour_m: NDArray, frequency_hz: NDArray, speed_of_sound: float) -> NDArray:
    """Loss (dB, (paths, F)) of diffraction at edges.

    Parameters:
        detour_m (m, (paths,)): extra length of the path over each edge; negative for a free line of sight.
        frequency_hz (Hz, (F,)): frequencies.
        speed_of_sound (m/s): speed of sound.
    """
    fresnel = 2.0 * detour_m[:, None] * frequency_hz / speed_of_sound
    root = np.sqrt(2.0 * np.pi * np.abs(fresnel)) + 1e-9
    bend = np.where(fresnel < 0.0, np.tan(np.minimum(root, 1.5)), np.tanh(root))
    loss = 5.0 + 20.0 * np.log10(root / bend)
    return np.where(fresnel < _CLEAR_NUMBER, 0.0, np.maximum(loss, 0.0))


def occlusion(obstacles: Iterable[Obstacle], source: NDArray, receiver: NDArray, frequency_hz: NDArray,
              speed_of_sound: float) -> NDArray:
    """Amplitude factor (F,) of all obstacles between source and receiver.

    Paths of similar length around one obstacle are added coherently, so that a trunk thinner than the wavelength casts no
    shadow; others are added by energy. The losses (dB) of several obstacles are added.

    Parameters:
        obstacles: obstacles to consider.
        source, receiver (m, (3,)): positions in ENU.
        frequency_hz (Hz, (F,)): frequencies.
        speed_of_sound (m/s): speed of sound.
    """
    factor = np.ones(len(frequency_hz))
    for obstacle in obstacles:
        ways = detours(obstacle, source, receiver)
        if ways is not None:
            loss = edge_loss_db(ways, frequency_hz, speed_of_sound)
            apart = np.subtract.outer(*[np.maximum(ways, 0.0)] * 2)[..., None]
            together = np.exp(-(apart / _COHERENT_M) ** 2) * np.cos(2 * np.pi * apart * frequency_hz / speed_of_sound)
            amplitude = 10.0 ** (-loss / 20.0)
            energy = np.einsum('if,ijf,jf->f', amplitude, together, amplitude)
            energy[(loss == 0.0).any(axis=0)] = 1.0
            factor *= np.sqrt(np.clip(energy, 10.0 ** (-_MOST_LOSS_DB / 10.0), 1.0))
    return factor


class Ray(NamedTuple):
    """One path from a source to the receivers.

    Parameters:
        mirror ((3, 3)), shift (m, (3,)): mirror image of a receiver.
        factor: response (F,), real or complex, for source and receiver (m, (3,)) in ENU; None if the path does not exist.
    """

    mirror: NDArray
    shift: NDArray
    factor: Callable[[NDArray, NDArray], NDArray | None]


def rays_of(surroundings: Surroundings, frequency_hz: NDArray, speed_of_sound: float) -> list[Ray]:
    """All rays, of which the first one is the direct ray.

    Parameters:
        surroundings: ground, obstacles and room.
        frequency_hz (Hz, (F,)): frequencies of the responses.
        speed_of_sound (m/s): speed of sound.
    """
    shade = Shade(surroundings.obstacles, frequency_hz, speed_of_sound)
    rays = [Ray(np.eye(3), np.zeros(3), shade.factor)]
    ground = surroundings.ground
    if ground is not None:
        rays.append(_reflected(shade, ground))
    for obstacle in surroundings.obstacles:
        if isinstance(obstacle, Box) and obstacle.reflects:
            kept = reflection_factor(obstacle.absorption, frequency_hz)
            for plane in obstacle.faces():
                rays.append(_reflected(shade, None, obstacle, plane, kept))
                if ground is not None and plane[0][2] == 0.0:    # upright
                    rays.append(_reflected(shade, ground, obstacle, plane, kept))
    if surroundings.room is not None:
        rays.extend(_room_rays(surroundings.room, frequency_hz))
    return rays


class Shade:
    """Attenuation of straight paths by obstacles. Obstacles far from a path are skipped.

    Parameters:
        obstacles: all obstacles.
        frequency_hz (Hz, (F,)): frequencies of the responses.
        speed_of_sound (m/s): speed of sound.
    """

    def __init__(self, obstacles: Sequence[Obstacle], frequency_hz: NDArray, speed_of_sound: float):
        # An edge has no loss at 0 Hz; this step would distort the impulse response, and nothing is received at 0 Hz.
        self.frequency_hz, self.speed_of_sound = np.maximum(frequency_hz, frequency_hz[1]), speed_of_sound
        self._obstacles = list(obstacles)
        corners = [obstacle.footprint for obstacle in obstacles]
        self._center = np.array([footprint.mean(axis=0) for footprint in corners]).reshape(-1, 2)
        self._reach = np.array([np.hypot(*(f - f.mean(axis=0)).T).max() for f in corners]) + _MARGIN_M

    def factor(self, start: NDArray, end: NDArray, but: Obstacle | None = None) -> NDArray:
        """Response (F,) of a straight path.

        Parameters:
            start, end (m, (3,)): ends of the path in ENU.
            but: obstacle that is ignored, None for none.
        """
        along = end[:2] - start[:2]
        share = np.clip((self._center - start[:2]) @ along / max(along @ along, 1e-12), 0.0, 1.0)
        apart = self._center - start[:2] - share[:, None] * along
        near = np.flatnonzero(np.hypot(*apart.T) < self._reach)
        close = [self._obstacles[index] for index in near if self._obstacles[index] is not but]
        return occlusion(close, start, end, self.frequency_hz, self.speed_of_sound)


def _reflected(shade: Shade, ground: Ground | None, box: Box | None = None,
               plane: tuple[NDArray, float] = (np.array([0.0, 0.0, 1.0]), 0.0), kept: NDArray | float = 1.0) -> Ray:
    """The ray reflected by a face of a box, by the ground, or by both.

    Parameters:
        shade: attenuation by obstacles.
        ground: None for a ray that it does not reflect.
        box: None for a ray that only the ground reflects.
        plane: normal ((3,)) and offset (m) of the face, or of the ground.
        kept ((F,)): reflection factor of the face.
    """
    normal, offset = plane
    mirror, shift = np.eye(3) - 2.0 * np.outer(normal, normal), 2.0 * offset * normal
    if box is not None and ground is not None:
        mirror = mirror @ np.diag([1.0, 1.0, -1.0])

    def factor(source: NDArray, receiver: NDArray) -> NDArray | None:
        before, behind = (normal @ point - offset for point in (source, receiver))
        if min(before, behind) < 0.0:
            return None
        path = mirror @ receiver + shift - source
        touched = source + path * (before / max(before + behind, 1e-9))
        if box is not None and ground is not None:
            touched[2] = abs(touched[2])
        if box is not None and not box.holds(touched):
            return None
        reflected = kept * shade.factor(source, touched, box) * shade.factor(touched, receiver, box)
        if ground is None:
            return reflected
        length = np.asarray(np.linalg.norm(path))
        return reflected * ground.reflection(np.abs(path[2]) / length, length, shade.frequency_hz, shade.speed_of_sound)

    return Ray(mirror, shift, factor)


def _room_rays(room: Room, frequency_hz: NDArray) -> Iterator[Ray]:
    """All rays with 1 to `order` reflections (Allen and Berkley 1979, with mirrored receiver instead of source)."""
    low, size = np.asarray(room.minimum, float), np.subtract(room.maximum, room.minimum)
    kept, high = reflection_factor(room.absorption, frequency_hz), np.asarray(room.maximum, float)
    reach = range(-room.order, room.order + 1)
    for turns in product(reach, reach, reach):
        # Along one axis, `turn` reflections give the image 2 * size * ceil(turn / 2) +- x; the sign is - for an odd number.
        hits = sum(map(abs, turns))
        if not 0 < hits <= room.order:
            continue
        sign = np.array([1.0 if turn % 2 == 0 else -1.0 for turn in turns])
        cells = np.array([(turn + 1) // 2 for turn in turns])
        yield Ray(np.diag(sign), low - sign * low + 2.0 * cells * size, partial(_within, low, high, kept**hits))


def _within(low: NDArray, high: NDArray, factor: NDArray, source: NDArray, receiver: NDArray) -> NDArray | None:
    """A response (F,) of a room from corner to corner (m, (3,)), whose walls reflect what is inside."""
    inside = all(np.all((low <= place) & (place <= high)) for place in (source, receiver))
    return factor if inside else None
