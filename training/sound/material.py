"""Recordings that are trained and judged on: where they come from, under which licence, what they are, and their folds.

Nothing of it is committed. Debian's packages are fetched by `apt-get download` and unpacked; Svanstrom's clips lie in
`../shared/data`; one repository is fetched with git at the commit given here. Of a group of recordings (parts of one take,
numbered names) all are in one fold.
"""

from __future__ import annotations

import io
import re
import subprocess
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray
from scipy.signal import resample_poly

RATE = 16_000  # Hz, of everything that is trained on
LONGEST_S = 20.0  # taken of each recording

# Package, pattern of the files' names (lower case), kind. Licences are those of the packages' `copyright` files: GPL-2+,
# LGPL-2, CC BY-SA 3.0, CC0, public domain. First match counts; what matches nothing is left out.
DEBIAN = (
    ('torcs-data', r'crash|gear|lock|boom|skid|road|axle|clkd', ''),
    ('torcs-data', r'.', 'engine'),
    ('scorched3d-data', r'misc/(birds|birdchirp|gull)', 'birds'),
    ('scorched3d-data', r'misc/(bats|wolf|frogs)', 'animals'),
    ('scorched3d-data', r'misc/(rain|ocean|thunder|splash|lava)', 'weather'),
    ('scorched3d-data', r'(f16|f18|t38|jet|cessna)', 'aeroplane'),
    ('scorched3d-data', r'apache', 'helicopter'),
    ('scorched3d-data', r'(tankmove|rocket)', 'engine'),
    ('scorched3d-data', r'(carhorn)', 'alarm'),
    ('scorched3d-data', r'(citysounds|cheering)', 'background'),
    ('scorched3d-data', r'(cow|dog|bees)', 'animals'),
    ('boswars-data', r'(ready|select|action|underattack|completed)', 'speech'),
    ('btanks-data', r'(klaxon|mine-tick)', 'alarm'),
    ('btanks-data', r'helicopter', 'helicopter'),
    ('btanks-data', r'(engine-|tank-move|vehicle-sound|train|submarine)', 'engine'),
    ('btanks-data', r'(forest|country|swamp)', 'birds'),
    ('btanks-data', r'(city)', 'background'),
    ('btanks-data', r'(boss|gameboy|utrennik|karbofos|glory|batterie|nostalgy)', 'music'),
    ('lincity-ng-data', r'(trafic|dirttrack)', 'engine'),
    ('lincity-ng-data', r'railtrain|parklandplane|industry|power|blacksmith|mine|mill|raze|build|recycle|construct', 'machine'),
    ('lincity-ng-data', r'(green|parklandlake|farm)', 'birds'),
    ('lincity-ng-data', r'(water|harbor|fire\d)', 'weather'),
    ('lincity-ng-data', r'firestation', 'alarm'),
    ('lincity-ng-data', r'(school|market|commune|sportscroud|residential|shanty|university|health)', 'background'),
    ('singularity-music', r'.', 'music'),
    ('asterisk-core-sounds-en-wav', r'.', 'speech'),
    ('klettres-data', r'.', 'speech'),
    ('tuxpaint-stamps-default', r'_desc|_[a-z]{2}(_[a-z]+)?\.ogg', ''),
    ('tuxpaint-stamps-default', r'animals/birds', 'birds'),
    ('tuxpaint-stamps-default', r'animals/', 'animals'),
    ('tuxpaint-stamps-default', r'(vehicles/emergency|town/.*siren)', 'alarm'),
    ('tuxpaint-stamps-default', r'(vehicles/)', 'engine'),
    ('tuxpaint-stamps-default', r'(vacuum|washing|tools/|kettle)', 'machine'),
    ('tuxpaint-stamps-default', r'(hobbies/music)', 'music'),
    ('sound-icons', r'.', 'music'),
)
PACKAGES = tuple(dict.fromkeys(name for name, _, _ in DEBIAN))
MOST_OF_A_RULE = 60  # recordings

# Svanstrom's clips (CC0 1.0). Of each kind three numbers in a row, which may be of one place, are in a fold that is judged on,
# the next three are not.
CLIPS = {'DRONE': 'drone', 'HELICOPTER': 'helicopter', 'BACKGROUND': 'background'}

# Seconds of ESC-50's clips at 16 kHz, and two drones in a room. ESC-10, a part of ESC-50, is CC BY 3.0 (K. J. Piczak, "ESC:
# Dataset for Environmental Sound Classification", 2015) and is trained on; the rest is CC BY-NC, and the drones (S. Al-Emadi
# et al., 2019) come without a licence: these are judged on only.
REPOSITORY, COMMIT = 'saraalemadi/DroneAudioDataset', '1f1ffb214c63215c95176dcb70dda246f8ad96c1'
ESC_10 = {0: 'animals', 1: 'birds', 10: 'weather', 11: 'weather', 12: 'weather', 20: 'speech', 21: 'speech', 38: 'machine',
          40: 'helicopter', 41: 'engine'}
ESC_REST = {5: 'animals', 7: 'animals', 9: 'birds', 13: 'animals', 14: 'birds', 16: 'weather', 17: 'weather', 18: 'weather',
            19: 'weather', 22: 'background', 26: 'speech', 35: 'machine', 36: 'machine', 37: 'alarm', 42: 'alarm', 43: 'alarm',
            44: 'engine', 45: 'engine', 46: 'alarm', 47: 'aeroplane', 49: 'machine'}
CLIPS_OF_A_CLASS = 24
FOLDS = 5  # of the recordings that are judged on
KNOWN, ELSEWHERE = 0, -1  # in place of a fold: recordings that every model knows, and those that none ever knows


@dataclass(frozen=True)
class Recording:
    """One recording: mono samples (n,) at RATE, its kind, a name, its group, and its fold, 1 to FOLDS, KNOWN or ELSEWHERE."""

    kind: str
    name: str
    group: str
    fold: int
    samples: NDArray[np.float32]


def recordings(clips: Path, packages: Path, repository: Path | None = None) -> Iterator[Recording]:
    """All recordings.

    Parameters:
        clips: folder of Svanstrom's clips, all of them or a part (`../shared/data/drone_detection/audio`).
        packages: folder into which Debian's packages are fetched and unpacked, once.
        repository: git directory of REPOSITORY; None leaves it out.
    """
    for path in sorted(path for path in clips.iterdir() if path.suffix in ('.flac', '.wav')):
        kind, number = path.stem.split('_')
        block = int(number) // 3
        group = f'{kind}_b{block}'
        spread = block // 2 if kind == 'DRONE' else _number_of(group)  # some drones in each fold
        yield Recording(CLIPS[kind], path.name, group, KNOWN if block % 2 else 1 + spread % FOLDS, read(path))
    for name in PACKAGES:
        yield from _of_package(name, unpacked(name, packages))
    if repository is not None:
        yield from _of_repository(repository)


def unpacked(name: str, folder: Path) -> Path:
    """Folder with the sounds of a Debian package, fetched where it is absent."""
    target = folder / name
    if not target.is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(['apt-get', 'download', '-q', name], cwd=folder, check=True)
        target.mkdir()
        subprocess.run(['dpkg-deb', '-x', str(next(folder.glob(f'{name}_*.deb'))), str(target)], check=True)
    return target


def read(path: Path) -> NDArray[np.float32]:
    """Mono samples at RATE of the first LONGEST_S of a file, none for an unreadable one."""
    try:
        samples, rate = soundfile.read(path, always_2d=True, dtype='float32')
    except soundfile.LibsndfileError:
        return np.zeros(0, np.float32)
    mono = samples[:int(LONGEST_S * rate)].mean(axis=1)
    return resample_poly(mono, RATE, rate).astype(np.float32)


def fold_of(group: str) -> int:
    """One of the folds for a third of the groups, else KNOWN."""
    return 1 + _number_of(group) % FOLDS if _number_of(group) % 3 == 0 else KNOWN


def _number_of(group: str) -> int:
    return zlib.crc32(group.encode())


def _of_package(name: str, folder: Path) -> Iterator[Recording]:
    files = sorted(path for path in folder.rglob('*') if path.suffix in ('.wav', '.ogg'))
    files.sort(key=lambda path: zlib.crc32(str(path.relative_to(folder)).encode()))
    taken: dict[str, int] = {}
    for path in files:
        relative = str(path.relative_to(folder)).lower()
        pattern, kind = next(((pattern, kind) for package, pattern, kind in DEBIAN
                              if package == name and re.search(pattern, relative.removeprefix('usr/share/'))), ('', ''))
        taken[pattern] = taken.get(pattern, 0) + 1
        samples = read(path) if kind and taken[pattern] <= MOST_OF_A_RULE else np.zeros(0, np.float32)
        if len(samples) > RATE // 4:
            group = f'{name}/{re.sub(r"[-_.]?[0-9]+$", "", path.stem.lower())}'
            yield Recording(kind, f'{name}/{path.name}', group, fold_of(group), samples)


def _of_repository(repository: Path) -> Iterator[Recording]:
    names = _git(repository, 'ls-tree', '-r', '--name-only', COMMIT).decode().split('\n')
    clips: dict[tuple[str, str], list[str]] = {}
    for name in names:
        if match := re.match(r'Binary_Drone_Audio/unknown/(\d-\d+-[A-Z])-(\d+)(\d)\.wav', name):
            clips.setdefault((match[1], match[2]), []).append(name)
        elif match := re.match(r'Binary_Drone_Audio/yes_drone/(.*)_\d+_\.wav', name):
            clips.setdefault((match[1], 'drone'), []).append(name)
    taken: dict[str, int] = {}
    for (clip, label), parts in sorted(clips.items(), key=lambda item: zlib.crc32(item[0][0].encode())):
        taken[label] = taken.get(label, 0) + 1
        number = int(label) if label.isdigit() else -1
        kind = 'drone' if number < 0 else ESC_10.get(number, ESC_REST.get(number, ''))
        if not kind or taken[label] > CLIPS_OF_A_CLASS:
            continue
        group = f'esc/{clip.split("-")[1]}' if number >= 0 else f'room/{clip}'
        fold = fold_of(group) if number in ESC_10 else ELSEWHERE
        seconds = [_decoded(_git(repository, 'show', f'{COMMIT}:{part}')) for part in sorted(parts)]
        yield Recording(kind, f'{label}/{clip}', group, fold, np.concatenate(seconds))


def _git(repository: Path, *arguments: str) -> bytes:
    return subprocess.run(['git', '--git-dir', str(repository), *arguments], check=True, capture_output=True).stdout


def _decoded(blob: bytes) -> NDArray[np.float32]:

    samples, rate = soundfile.read(io.BytesIO(blob), always_2d=True, dtype='float32')
    return resample_poly(samples.mean(axis=1), RATE, rate).astype(np.float32)
