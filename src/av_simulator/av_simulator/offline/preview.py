"""Overview figure of a scenario, for a check before a long run: images, trajectories, visibility and spectrogram."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from av_simulator.run import open_world, steps
from av_simulator.scenario import Scenario
from av_simulator.world import World

FRAMES = 8


def preview(world: World, duration: float, file: Path) -> None:
    """Write a figure: images, top view, azimuth and transmission, and the spectrogram of one microphone.

    Parameters:
        world: the world at its beginning; it is advanced by `duration`.
        duration (s): simulated time.
        file: path of the figure.
    """
    every = duration / FRAMES
    sound, frames, truth, shown = [], [], [], 0
    for step in steps(world, duration, image_rate=1.0 / every, truth_rate=10.0):
        sound.append(step.sound[:, 0])
        truth += step.truth
        frames += step.images
        shown += len(step.images)
    figure = Figure(figsize=(16, 11), layout='constrained')
    rows = figure.subfigures(2, 1, height_ratios=[1, 1])
    for axes, (view, image) in zip(rows[0].subplots(2, FRAMES // 2).flat, frames, strict=False):
        axes.imshow(image.bgr[..., ::-1])
        for box in image.boxes:
            axes.add_patch(mpl.patches.Rectangle((box.min_x - 4, box.min_y - 4), box.max_x - box.min_x + 8,
                                                 box.max_y - box.min_y + 8, fill=False, edgecolor='red'))
        axes.set_title(f'{view.time:.0f} s', fontsize=9)
        axes.axis('off')
    top, line, spectrum = rows[1].subplots(1, 3)
    _top_view(top, world, truth)
    _sight(line, world.scenario, truth)
    _spectrogram(spectrum, np.concatenate(sound), world.sample_rate)
    rows[0].suptitle(f'{world.scenario.name}: {world.scenario.description}')
    figure.savefig(file, dpi=90)


def _top_view(axes: Axes, world: World, truth: list) -> None:
    rig = np.array([sample.rig.position for sample in truth])
    axes.plot(rig[:, 0], rig[:, 1], 'k.-', markersize=2, label='rig')
    forward = truth[0].rig.rotation[:2, 0]
    axes.arrow(*rig[0, :2], *(2.0 * forward), width=0.15, color='k')
    for number, target in enumerate(world.scenario.targets):
        path = np.array([sample.targets[number].position for sample in truth])
        points = axes.scatter(path[:, 0], path[:, 1], c=[sample.time for sample in truth], s=6, cmap='viridis')
        axes.annotate(target.name, (float(path[0, 0]), float(path[0, 1])))
    for obstacle in world.scenario.obstacles:
        axes.fill(*np.array(obstacle.footprint).T, color='0.6')
    axes.figure.colorbar(points, ax=axes, label='s')
    axes.set(title='from above', xlabel='east (m)', ylabel='north (m)')
    axes.set_aspect('equal', adjustable='datalim')
    axes.grid(alpha=0.3)


def _sight(axes: Axes, scenario: Scenario, truth: list) -> None:
    time = np.array([sample.time for sample in truth])
    for number, target in enumerate(scenario.targets):
        azimuth = np.rad2deg(np.unwrap([sample.bearings[number].azimuth for sample in truth]))
        axes.plot(time, azimuth, label=f'azimuth of {target.name}')
    axes.set(title='azimuth from the rig, and transmission of the air', xlabel='s', ylabel='deg')
    axes.legend(loc='upper left', fontsize=8)
    share = axes.twinx()
    for number in range(len(scenario.targets)):
        clear = [scenario.weather.atmosphere(sample.time).transmission(sample.rig.position, sample.targets[number].position)
                 for sample in truth]
        share.fill_between(time, clear, alpha=0.15)
    share.set(ylim=(0, 1), ylabel='transmission')


def _spectrogram(axes: Axes, sound: np.ndarray, rate: int) -> None:
    axes.specgram(sound + 1e-9, NFFT=4096, noverlap=2048, Fs=rate, cmap='magma')
    axes.set(title='first microphone', xlabel='s', ylabel='Hz', ylim=(0, 8000))


def preview_scenario(scenario: str | Scenario, file: Path, seed: int | None = None) -> None:
    """Write a figure of a whole scenario.

    Parameters:
        scenario: name of a shipped scenario, path of a file, or a Scenario.
        file: path of the figure.
        seed: seed, None for the scenario's.
    """
    world = open_world(scenario, seed=seed)
    preview(world, world.scenario.duration, file)
