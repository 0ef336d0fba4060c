"""MuJoCo model (MJCF) of a scene: static solids, and drones whose poses are set for each image."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from av_simulator.rendering.scenes import Solid
from av_simulator.rendering.view import BODY_SIZE, ROTOR_RADIUS, rotor_places

DRONE_GROUPS = 5         # of geoms, besides that of the scene, so that few drones are drawn at a time: MuJoCo has six
_GROUNDS = {             # base colour, contrast, repetitions over the ground plane
    'forest': ((0.30, 0.27, 0.17), 0.30, 60), 'grass': ((0.36, 0.42, 0.20), 0.20, 60),
    'concrete': ((0.55, 0.55, 0.54), 0.08, 20), 'asphalt': ((0.30, 0.30, 0.31), 0.10, 20),
}
_PLANE = 300.0           # m, half the side of the ground plane


def drone_body(number: int) -> str:
    """Name of a drone's body in the model."""
    return f'drone{number}'


def drone_group(number: int) -> int:
    """The group of a drone's geoms; that of the scene is 0."""
    return 1 + number % DRONE_GROUPS


def rotor_joint(number: int, rotor: int) -> str:
    """Name of the joint about which one rotor turns."""
    return f'drone{number}_rotor{rotor}'


def build(solids: Sequence[Solid], ground: str, sky: bool, drones: Sequence[tuple[float, int]], size: tuple[int, int],
          fovy_deg: float, seed: int) -> tuple[str, dict[str, bytes]]:
    """XML and assets of the model of a scene.

    Parameters:
        solids: static solids.
        ground: name of the ground's texture.
        sky: whether there is a sky; else the light is that of a hall.
        drones: size (m) and number of rotors of each drone.
        size (px): width and height of the images.
        fovy_deg (deg): vertical field of view.
        seed: seed of the textures.
    """
    root = ET.Element('mujoco')
    _settings(root, size, fovy_deg, sky)
    asset, world = _add(root, 'asset'), _add(root, 'worldbody')
    images = _surfaces(asset, sky, np.random.default_rng([seed, 12]))
    _add(world, 'light', pos='0 0 100', dir='0.35 0.2 -0.9', directional='true', castshadow='false',
         diffuse='0.6 0.6 0.58', specular='0 0 0')
    _add(world, 'geom', name='ground', type='plane', size=f'{_PLANE} {_PLANE} 1', material=ground)
    for number, solid in enumerate(solids):
        _solid(asset, world, f'solid{number}', solid)
    for number, (drone_size, rotors) in enumerate(drones):
        _drone(world, number, drone_size, rotors)
    _add(_add(world, 'body', name='camera', mocap='true'), 'camera', name='camera', fovy=str(fovy_deg))
    return ET.tostring(root, encoding='unicode'), images


def _add(parent: ET.Element, tag: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, tag, attributes)


def _text(values: ArrayLike) -> str:
    return ' '.join(f'{value:.6g}' for value in np.ravel(values))


def _settings(root: ET.Element, size: tuple[int, int], fovy_deg: float, sky: bool) -> None:
    _add(root, 'compiler', angle='radian')
    visual = _add(root, 'visual')
    _add(visual, 'global', offwidth=str(size[0]), offheight=str(size[1]), fovy=str(fovy_deg))
    _add(visual, 'quality', shadowsize='0', offsamples='0', numslices='10', numstacks='7', numquads='1')
    lamps = '0 0 0' if sky else '0.5 0.5 0.48'    # diffuse light indoors
    _add(visual, 'headlight', ambient='0.45 0.45 0.45', diffuse=lamps, specular='0 0 0')
    _add(visual, 'map', znear='0.001', zfar='50')
    _add(root, 'statistic', extent='100', center='0 0 0')


def _surfaces(asset: ET.Element, sky: bool, random: np.random.Generator) -> dict[str, bytes]:
    zenith, horizon = ('0.45 0.62 0.80', '0.82 0.85 0.88') if sky else ('0.5 0.5 0.5', '0.5 0.5 0.5')
    _add(asset, 'texture', type='skybox', builtin='gradient', rgb1=zenith, rgb2=horizon, width='64', height='384')
    images = {f'{name}.png': _grain(np.array(colour), contrast, random)
              for name, (colour, contrast, _) in _GROUNDS.items()}
    images['facade.png'] = _facade()
    repeats = {name: repeat for name, (_, _, repeat) in _GROUNDS.items()} | {'facade': 1}
    for name, repeat in repeats.items():
        _add(asset, 'texture', name=name, type='2d' if name != 'facade' else 'cube', file=f'{name}.png')
        _add(asset, 'material', name=name, texture=name, texrepeat=f'{repeat} {repeat}', specular='0')
    return {name: cv2.imencode('.png', image)[1].tobytes() for name, image in images.items()}


def _grain(colour: NDArray, contrast: float, random: np.random.Generator) -> NDArray:
    """A texture (256, 256, 3) of irregular patches that can be tiled without visible edges."""
    patches = sum(gaussian_filter(random.standard_normal((256, 256)), sigma, mode='wrap') * sigma for sigma in (1, 4, 12))
    image = colour[::-1] * (1.0 + contrast * patches / patches.std())[..., np.newaxis]
    return (image.clip(0.0, 1.0) * 255).astype(np.uint8)


def _facade() -> NDArray:
    """A texture (256, 256, 3) of dark windows in a light wall."""
    image = np.full((256, 256, 3), 235, np.uint8)
    for y in range(20, 240, 58):
        for x in range(14, 250, 48):
            image[y:y + 34, x:x + 24] = (90, 80, 70)
    return image


def _solid(asset: ET.Element, world: ET.Element, name: str, solid: Solid) -> None:
    shape = {'type': solid.shape, 'size': _text(solid.half_size)}
    if solid.shape == 'cylinder':
        shape['size'] = _text([solid.half_size[0], solid.half_size[2]])
    elif solid.shape == 'cone':   # a mesh cannot be scaled by a geom, so that each cone needs its own
        angle = np.arange(9) * 2 * np.pi / 9
        rim = np.column_stack([np.cos(angle), np.sin(angle), -np.ones(9)])
        _add(asset, 'mesh', name=name, vertex=_text(np.vstack([rim, [0.0, 0.0, 1.0]]) * solid.half_size))
        shape = {'type': 'mesh', 'mesh': name}
    surface = {'material': solid.surface} if solid.surface else {}
    _add(world, 'geom', name=name, pos=_text(solid.centre), euler=_text([0.0, 0.0, solid.yaw]),
         rgba=_text([*solid.colour, 1.0]), **shape, **surface)


def _drone(world: ET.Element, number: int, size: float, rotors: int) -> None:
    look = {'group': str(drone_group(number)), 'contype': '0', 'conaffinity': '0', 'mass': '0.1'}
    dark, grey = '0.09 0.09 0.10 1', '0.16 0.16 0.17 1'
    body = _add(world, 'body', name=drone_body(number), mocap='true')
    _add(body, 'geom', type='ellipsoid', size=_text(BODY_SIZE * size), rgba=dark, **look)
    for side in (-1, 1):
        _add(body, 'geom', type='capsule', size=_text([0.012 * size]), rgba=grey, **look,
             fromto=_text(size * np.array([-0.14, 0.1 * side, -0.12, 0.14, 0.1 * side, -0.12])))
    for rotor, hub in enumerate(rotor_places(rotors) * size):
        _add(body, 'geom', type='capsule', size=_text([0.018 * size]), rgba=dark, **look,
             fromto=_text([0.0, 0.0, 0.02 * size, *(hub - [0, 0, 0.03 * size])]))
        _add(body, 'geom', type='cylinder', size=_text([0.03 * size, 0.03 * size]), pos=_text(hub - [0, 0, 0.02 * size]),
             rgba=grey, **look)
        turning = _add(body, 'body', pos=_text(hub))
        _add(turning, 'joint', name=rotor_joint(number, rotor), type='hinge', axis='0 0 1')
        _add(turning, 'geom', type='box', size=_text(size * np.array([ROTOR_RADIUS, 0.013, 0.004])), rgba=grey, **look)
