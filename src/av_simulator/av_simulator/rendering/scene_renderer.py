"""Offscreen rendering of a 3D scene by MuJoCo: images through the air, depth, segmentation and temperature."""

from __future__ import annotations

import ctypes.util
import os
from collections.abc import Sequence
from functools import cached_property, partial
from types import ModuleType
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from transforms3d.quaternions import mat2quat

from av_common.camera import PinholeCamera
from av_sim_bridge.wire.ports import FIRST_TARGET
from av_simulator.rendering.camera_effects import (
    AIRLIGHT,
    ARM_WARMER_K,
    BLADE_WARMER_K,
    BODY_WARMER_K,
    GROUND_WARMER_K,
    MOTOR_WARMER_K,
    SKY_DISTANCE,
    TEXTURE_K,
    CameraEffects,
    ThermalCamera,
    apparent_temperature,
)
from av_simulator.rendering.mjcf import build, drone_body, drone_group, rotor_joint
from av_simulator.rendering.oracle import Oracle, Visible
from av_simulator.rendering.scenes import Scene, Solid
from av_simulator.rendering.view import Appearance, Drone, RenderedImage, View, appearance

# MuJoCo looks along -z with y up, the optical frame along z with y down.
_OPTICAL_TO_MUJOCO = np.diag([1.0, -1.0, -1.0])
HORIZON = 1000.0                # m, depth beyond which a pixel belongs to the sky
Window = tuple[slice, slice]    # rows and columns of an image
_ALL = (slice(None), slice(None))
SAMPLES = 4    # per pixel along rows and along columns, of the temperatures of drones


class SceneRenderer:
    """Renderer for one camera and one scene. OpenGL requires that only the thread that created it uses it.

    Raises RuntimeError if offscreen rendering is not available.

    Parameters:
        camera: pinhole model with distortion.
        scene: solids, ground and sky.
        drones: size (m) and number of rotors of each drone.
        seed: seed of all random properties of the scene.
        obstacles: solids in addition to those of the scene.
        air_c (deg C): temperature of the air, for thermal images.
        everything: whether segmentation and temperatures are rendered for every view.
        palette: of a thermal camera, see `ThermalCamera`; empty for a visible one.
    """

    def __init__(self, camera: PinholeCamera, scene: Scene, drones: Sequence[tuple[float, int]], seed: int,
                 obstacles: Sequence[Solid] = (), air_c: float = 15.0, everything: bool = False, palette: str = ''):
        self._mujoco = _import_mujoco()
        self._camera, self._everything, self._air_c = camera, everything, air_c
        self._thermal_camera = ThermalCamera(camera.width, camera.height, palette, seed) if palette else None
        self._effects = CameraEffects(camera.width, camera.height, seed)
        self._lens, self._oracle = _Lens(camera), Oracle(camera, (), bool(palette))
        solids = [*scene.solids(np.random.default_rng([seed, 11])), *obstacles]
        xml, assets = build(solids, scene.ground, scene.sky, drones, self._lens.size, self._lens.fovy_deg, seed)
        mujoco = self._mujoco
        self._model = mujoco.MjModel.from_xml_string(xml, assets)
        self._data = mujoco.MjData(self._model)
        self._drones = len(drones)
        self._warmth = self._warmth_of(solids)
        try:
            self._open()
        except (ImportError, mujoco.FatalError) as error:    # a library without a driver
            raise RuntimeError(f'no OpenGL without a screen: {error}') from error

    def _open(self) -> None:
        mujoco = self._mujoco
        self._context = mujoco.GLContext(*self._lens.size)
        self._context.make_current()
        self._target = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._target)
        self._scene = mujoco.MjvScene(self._model, self._model.ngeom + 100)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = False
        self._eye = mujoco.MjvCamera()
        self._eye.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._eye.fixedcamid = 0
        self._options = mujoco.MjvOption()
        self._all_groups = np.array([1] * 6)

    def close(self) -> None:
        """Release the OpenGL context."""
        self._target.free()
        self._context.free()

    def render(self, view: View) -> RenderedImage:
        """The image of one view, with depth, the oracle's boxes and the true boxes."""
        self._place(view)
        zbuffer = np.empty((self._lens.whole.height, self._lens.whole.width), np.float32)
        rgb = self._draw(self._lens.whole, zbuffer)
        depth = self._lens.bend(self._to_metres(zbuffer[::-1]), nearest=True)
        bgr = self._lens.bend(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
        optical_depth = self._optical_depth(view, depth)
        identities = self._identities(_ALL) if self._everything or self._thermal_camera else None
        thermal = None if identities is None else self._temperatures(view, bgr, identities, depth)
        if self._thermal_camera and thermal is not None:
            self._refine(thermal, view, bgr)
            image = self._thermal_camera.picture(thermal, view)
        else:
            image = self._effects.apply(_veiled(bgr, optical_depth), view)
        truth = [self._oracle.look(view, drone, partial(self._visible, view, number, drone, depth))
                 for number, drone in enumerate(view.drones)]
        segmentation = None if identities is None else self._owner[identities]
        return RenderedImage(image, truth, depth, segmentation, thermal)

    def _place(self, view: View) -> None:
        data, model = self._data, self._model
        for number, drone in enumerate(view.drones):
            mocap = model.body(drone_body(number)).mocapid[0]
            data.mocap_pos[mocap], data.mocap_quat[mocap] = drone.position, mat2quat(drone.rotation)
            for rotor, angle in enumerate(drone.turned[:drone.rotors]):
                data.qpos[model.joint(rotor_joint(number, rotor)).qposadr[0]] = angle
        eye = model.body('camera').mocapid[0]
        data.mocap_pos[eye], data.mocap_quat[eye] = view.position, mat2quat(view.rotation @ _OPTICAL_TO_MUJOCO)
        self._mujoco.mj_kinematics(model, data)
        self._mujoco.mj_camlight(model, data)

    def _draw(self, crop: Crop, zbuffer: NDArray | None = None, groups: NDArray | None = None,
              identities: bool = False, times: int = 1) -> NDArray:
        """A part of the rendered image, top row first.

        Parameters:
            crop: part of the image.
            zbuffer ((height, width), float32): array for the depth buffer, bottom row first; None for none.
            groups ((6,)): which groups of geoms are drawn; None for all.
            identities: whether the colours are the numbers of the geoms.
            times: samples per pixel along rows and along columns.
        """
        mujoco = self._mujoco
        self._options.geomgroup[:] = self._all_groups if groups is None else groups
        for flag in (mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR):
            self._scene.flags[flag] = identities
        mujoco.mjv_updateScene(self._model, self._data, self._options, None, self._eye, mujoco.mjtCatBit.mjCAT_ALL,
                               self._scene)
        for eye in self._scene.camera:
            self._narrow(eye, crop)
        viewport = mujoco.MjrRect(0, 0, times * crop.width, times * crop.height)
        mujoco.mjr_render(viewport, self._scene, self._target)
        rgb = np.empty((viewport.height, viewport.width, 3), np.uint8)
        mujoco.mjr_readPixels(rgb, zbuffer, viewport, self._target)
        return rgb[::-1]

    def _narrow(self, eye: Any, crop: Crop) -> None:
        """Set a camera's frustum to a part of the image at the same resolution."""
        width, height = self._lens.size
        pixel = (eye.frustum_top - eye.frustum_bottom) / height
        eye.frustum_center += pixel * (crop.left + crop.width / 2 - width / 2)
        eye.frustum_bottom += pixel * (height - crop.top - crop.height)
        eye.frustum_top -= pixel * crop.top

    def _identities(self, window: Window, groups: NDArray | None = None) -> NDArray:
        """Number of the geom at each pixel of a window of the image, -1 for the sky."""
        places, crop = self._lens.places(window)
        return self._geoms(self._draw(crop, groups=groups, identities=True)[places[..., 1], places[..., 0]])

    def _geoms(self, rgb: NDArray) -> NDArray:
        """Numbers (...) of the geoms that colours (..., 3) stand for, -1 for the sky."""
        red, green, blue = np.moveaxis(rgb.astype(np.int32), -1, 0)
        value = red + (green << 8) + (blue << 16)
        order = np.full(self._scene.ngeom + 1, -1, np.int32)
        for geom in self._scene.geoms[:self._scene.ngeom]:
            if geom.segid >= 0:
                order[geom.segid + 1] = geom.objid
        return order[value]

    def _visible(self, view: View, number: int, drone: Drone, depth: NDArray, where: Appearance) -> Visible:
        """Box and share of the pixels of a drone that nothing hides; None without any."""
        window = where.window(margin=2)
        covered = self._owner[self._identities(window, np.arange(6) == drone_group(number))] == drone.target_id
        visible = covered
        nearest = view.to_optical(drone.position[np.newaxis])[0, 2] - 0.6 * drone.size
        if depth[window].min() < nearest:    # possibly occluded
            visible = self._owner[self._identities(window)] == drone.target_id
        if not visible.any():
            return None
        rows, columns = np.flatnonzero(visible.any(axis=1)), np.flatnonzero(visible.any(axis=0))
        box = (float(columns[0] + window[1].start), float(rows[0] + window[0].start),
               float(columns[-1] + window[1].start), float(rows[-1] + window[0].start))
        return box, float(visible.sum() / max(covered.sum(), visible.sum()))

    @cached_property
    def _owner(self) -> NDArray:
        """Target id of each geom, 0 for other objects; the last element is for the sky."""
        bodies = self._model.body_rootid[self._model.geom_bodyid].tolist()
        drones = {self._model.body(drone_body(number)).id: FIRST_TARGET + number for number in range(self._drones)}
        return np.array([*(drones.get(body, 0) for body in bodies), 0], np.int32)

    def _warmth_of(self, solids: list[Solid]) -> NDArray:
        kinds = self._mujoco.mjtGeom
        parts = {kinds.mjGEOM_ELLIPSOID: BODY_WARMER_K, kinds.mjGEOM_CYLINDER: MOTOR_WARMER_K,
                 kinds.mjGEOM_CAPSULE: ARM_WARMER_K, kinds.mjGEOM_BOX: BLADE_WARMER_K}
        warmth = np.full(self._model.ngeom, GROUND_WARMER_K)
        for kind, warmer_k in parts.items():
            warmth[(self._owner[:-1] > 0) & (self._model.geom_type == kind)] = warmer_k
        for number, solid in enumerate(solids):
            warmth[self._model.geom(f'solid{number}').id] = solid.warmer_k
        return np.append(warmth, 0.0)

    def _to_metres(self, zbuffer: NDArray) -> NDArray:
        """Depth (m) along the optical axis, inf for the sky."""
        near = self._model.vis.map.znear * self._model.stat.extent
        far = self._model.vis.map.zfar * self._model.stat.extent
        depth = near / (1.0 - zbuffer * np.float32(1.0 - near / far))
        depth[depth > HORIZON] = np.inf    # MuJoCo renders the sky as a distant box
        return depth

    def _optical_depth(self, view: View, depth: NDArray, window: Window = _ALL) -> NDArray:
        """Optical depth of the air between the camera and the object at each pixel of a window, or at samples (h, w, k)."""
        stretch, rays = self._lens.stretch[window], self._lens.rays_of(window)
        if depth.ndim > 2:
            stretch, rays = stretch[..., np.newaxis], np.repeat(rays, depth.shape[2], axis=1)
        distance = np.where(np.isfinite(depth), depth * stretch, np.float32(SKY_DISTANCE))
        if not view.atmosphere.clouds:
            return distance * np.float32(view.atmosphere.fog + view.atmosphere.rain_extinction)
        rays = rays.reshape(-1, 3) @ view.rotation.astype(np.float32).T
        return view.atmosphere.optical_depth(view.position.astype(np.float32), rays, distance.ravel()).reshape(depth.shape)

    def _temperatures(self, view: View, bgr: NDArray, identities: NDArray, depth: NDArray, window: Window = _ALL) -> NDArray:
        """Apparent temperatures (deg C) of a window of the image, or of samples (h, w, k) of its pixels."""
        optical_depth = self._optical_depth(view, depth, window)
        samples = (..., *(np.newaxis,) * (depth.ndim - 2))
        upward = (self._lens.rays_of(window) @ view.rotation[2].astype(np.float32))[samples]
        texture = TEXTURE_K * (cv2.cvtColor(bgr[window], cv2.COLOR_BGR2GRAY) / 255.0 - 0.5)[samples]
        return apparent_temperature(self._warmth[identities] + texture, ~np.isfinite(depth), upward, optical_depth, self._air_c)

    def _refine(self, thermal: NDArray, view: View, bgr: NDArray) -> None:
        """Average temperatures over the pixels of the drones, whose arms and motors are smaller than a pixel, in place."""
        for drone in view.drones:
            where = appearance(self._camera, view, drone)
            if where is None:
                continue
            window = where.window(margin=2)
            places, crop = self._lens.places(window)
            times = min(SAMPLES, self._lens.size[0] // crop.width, self._lens.size[1] // crop.height)
            if times < 2:
                continue
            zbuffer = np.empty((times * crop.height, times * crop.width), np.float32)
            rgb = self._draw(crop, zbuffer, identities=True, times=times)
            chosen = (places[..., 1], slice(None), places[..., 0])
            shape = (crop.height, times, crop.width, times)
            identities = self._geoms(rgb).reshape(shape)[chosen].reshape(*places.shape[:2], -1)
            depth = self._to_metres(zbuffer[::-1]).reshape(shape)[chosen].reshape(*places.shape[:2], -1)
            thermal[window] = self._temperatures(view, bgr, identities, depth, window).mean(axis=-1)


class Crop(NamedTuple):
    """A part of the rendered image: left and top edge, width and height (px)."""

    left: int
    top: int
    width: int
    height: int


class _Lens:
    """Mapping from the rendered image of an ideal pinhole camera to the image of the distorted camera."""

    def __init__(self, camera: PinholeCamera):
        columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        rays = camera.rays(np.column_stack([columns.ravel(), rows.ravel()]))
        self.rays = rays.astype(np.float32)
        shape = (camera.height, camera.width)
        self.stretch = (1.0 / rays[:, 2]).reshape(shape).astype(np.float32)   # distance over depth
        plane = rays[:, :2] / rays[:, 2:]
        half_x, half_y = np.abs(plane).max(axis=0)
        focal = max(camera.fx, camera.fy)
        self.size = (2 * int(np.ceil(half_x * focal) + 1), 2 * int(np.ceil(half_y * focal) + 1))
        self.whole = Crop(0, 0, *self.size)
        self.fovy_deg = float(np.rad2deg(2 * np.arctan(self.size[1] / 2 / focal)))
        centre = (np.array(self.size) - 1) / 2
        places = (plane * focal + centre).astype(np.float32)
        self._map = cv2.convertMaps(places[:, 0].reshape(shape), places[:, 1].reshape(shape), cv2.CV_16SC2)
        self._nearest = (np.rint(places).astype(np.int16).reshape(*shape, 2), None)

    def rays_of(self, window: Window) -> NDArray:
        """Unit vectors (h, w, 3) in the optical frame of the pixels of a window."""
        return self.rays.reshape(*self.stretch.shape, 3)[window]

    def places(self, window: Window) -> tuple[NDArray, Crop]:
        """Columns and rows (h, w, 2) of the pixels of a window within a part of the rendered image, and that part."""
        places = self._nearest[0][window]
        low, high = places.min(axis=(0, 1)), places.max(axis=(0, 1))
        width, height = (high - low + 1).tolist()
        return places - low, Crop(int(low[0]), int(low[1]), width, height)

    def bend(self, image: NDArray, nearest: bool = False) -> NDArray:
        """The distorted camera's image of a rendered image; `nearest` disables interpolation."""
        interpolation = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        maps: Any = self._nearest if nearest else self._map    # OpenCV's type stubs do not allow None as the second map
        return cv2.remap(np.ascontiguousarray(image), maps[0], maps[1], interpolation)


def _veiled(bgr: NDArray, optical_depth: NDArray) -> NDArray:
    """The image through air: I = J t + A (1 - t) with t = exp(-optical depth) (Koschmieder)."""
    if not optical_depth.any():
        return bgr
    clear = cv2.exp(-np.minimum(optical_depth, np.float32(50.0)))
    return cv2.blendLinear(bgr, np.full_like(bgr, AIRLIGHT), clear, 1.0 - clear)


def _import_mujoco() -> ModuleType:
    """MuJoCo with offscreen rendering by EGL, else OSMesa. Raises RuntimeError with the packages to install."""
    if 'MUJOCO_GL' not in os.environ:
        for backend, library in (('egl', 'EGL'), ('osmesa', 'OSMesa')):
            if ctypes.util.find_library(library):
                os.environ['MUJOCO_GL'] = backend
                break
        else:
            raise RuntimeError('no OpenGL without a screen: install libegl1 with libgl1-mesa-dri, or libosmesa6')
    try:
        import mujoco
        import mujoco.rendering
    except ImportError as error:
        raise RuntimeError(f'mujoco cannot be imported: {error}') from error
    return mujoco
