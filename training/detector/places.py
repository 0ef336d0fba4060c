"""Other people's pictures of drones, birds, aircraft and balloons: where they come from, under which licence, and reading them.

They are fetched by name with git into the cache, each at the commit given here, and never committed. Those that are judged on
(`JUDGED`) serve no training, no threshold and no calibration; upstream rights of single pictures are unproven in all of them.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from clips import CLASSES
from numpy.typing import NDArray

DRONE, BIRD, AIRPLANE = (CLASSES.index(name) for name in ('drone', 'bird', 'airplane'))
NOTHING = -1  # a labelled thing that has no class here: a picture with it alone shows no drone


@dataclass(frozen=True)
class Place:
    """A data set: a repository at a commit, the folders taken from it, the classes of its labels and who may use it.

    Labels are YOLO's (class, centre and size as shares) in the folder `labels` beside `images`, or corners in pixels.
    `whole` says that every picture is labelled: one without a label shows nothing; otherwise it is left out. `without` is
    a pattern of files left out: of `flying` the frames of Svanstrom's clips and the pictures that are `phantom`'s, too.
    """

    name: str
    repository: str
    commit: str
    licence: str
    folders: tuple[str, ...]
    classes: tuple[int, ...]
    labels: str = '/labels/'
    without: str = '(?!)'
    whole: bool = True
    corners: bool = False


SOURCES = (
    Place('flying', 'mahesh-bora/Flying-Object-Detection', '984c88639385818cf3879c771c3dcabf578df277', 'CC BY 4.0',
          ('Dataset/train', 'Dataset/test', 'Dataset/valid'), (AIRPLANE, BIRD, DRONE, NOTHING),
          without=r'/V_AIRPLANE_|/\d+_JPEG_'),
    Place('woods', 'SowOuma/European-Defense-Tech-Hackathon-FPV-Drone-detection-and-tracking',
          'b312d739356dbd01be7bc988c0892ebe47e18684', 'public domain', ('FPV_Drone_data',), (DRONE,)),
    Place('perched', 'KishoreK47/Aerial-Drone-vs-Bird-Classification-and-Detection',
          '3948fe30db5c8369156be5913d343bf2a2cb642a', 'CC BY 4.0', ('Data/object_detection_Dataset',), (BIRD, DRONE)),
    Place('hackathon', 'klintan/natsec-hackathon', '679be0b2a74e5e055e8fa76b1f9541b82bf94465', 'CC BY 4.0',
          ('drone-yolov7-dataset',), (DRONE, BIRD), whole=False),
)
JUDGED = (
    Place('drone-net', 'chuanenlin/drone-net', '29729dae40e7a4cd43d04db407a73b75f4cfa774', 'stated for the labels only',
          ('images', 'normalized-labels'), (DRONE,), labels='/normalized-labels/'),
    Place('curated', 'SamuelTre07/Drone_Detection_Dataset', 'e03dc7d49495b27709267a67297a03c72f8f0e5e', 'research only',
          ('train', 'val'), (DRONE,)),
    Place('phantom', 'creiser/drone-detection', '8159a947088cfc0d6b62a7d0af3c89882d1c7798', 'none stated',
          ('DataSets/Drones',), (DRONE,), corners=True),
)


@dataclass(frozen=True)
class Picture:
    """A picture: its file, what it was made from (versions and frames of one source share it) and its boxes (k, 5).

    A box is class, x1, y1, x2, y2, tight around the object, as shares of the picture or in `pixels`; `nameless` says that
    the picture also shows something that has no class here, a balloon.
    """

    path: Path
    source: str
    boxes: NDArray[np.float32]
    pixels: bool
    nameless: bool = False

    def load(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """The picture, BGR, and its boxes (k, 5) in pixels; ValueError when the file is no picture."""
        image = cv2.imread(str(self.path), cv2.IMREAD_COLOR)
        if image is None:
            raise ValueError(f'{self.path} is no picture')
        height, width = image.shape[:2]
        scale = np.array([1.0] * 5 if self.pixels else [1.0, width, height, width, height], np.float32)
        return np.asarray(image, np.uint8), self.boxes * scale


def fetch(place: Place, cache: Path) -> Path:
    """The folder in the cache with a place's pictures, fetched when it is not there."""
    folder = cache / 'places' / place.name
    if (folder / 'whole').exists():
        return folder
    print(f'fetching {place.repository} ({place.licence}) into {folder}', flush=True)
    git = ['git', '-C', str(folder)]
    folder.mkdir(parents=True, exist_ok=True)
    for command in (['init', '--quiet'],
                    ['fetch', '--quiet', '--depth', '1', f'https://github.com/{place.repository}.git', place.commit],
                    ['checkout', '--quiet', 'FETCH_HEAD', '--', *place.folders]):
        subprocess.run([*git, *command], check=True)
    (folder / 'whole').touch()
    return folder


def pictures(place: Place, cache: Path) -> Iterator[Picture]:
    """The pictures of a place in a fixed order: one version of each source picture, none that is left out."""
    folder = fetch(place, cache)
    seen: set[str] = set()
    for path in sorted(folder.rglob('*')):
        name = f'/{path.relative_to(folder)}'
        if path.suffix.lower() not in ('.jpg', '.jpeg', '.png') or re.search(place.without, name):
            continue
        stem = path.name.split('.rf.')[0]
        if stem in seen:
            continue
        seen.add(stem)
        label = folder / name.replace('/images/', place.labels)[1:]
        boxes = read_corners(label, place) if place.corners else read_shares(label.with_suffix('.txt'), place)
        if len(boxes) or place.whole:
            named = boxes[:, 0] != NOTHING
            yield Picture(path, source_of(stem), boxes[named], place.corners, not named.all())


def source_of(stem: str) -> str:
    """What a picture was made from: the film of a frame such as video18_1165, otherwise the picture itself."""
    film, number, *_ = (*stem.split('_'), '')
    return film if film.startswith('video') and number.isdigit() else stem


def read_shares(label: Path, place: Place) -> NDArray[np.float32]:
    """Boxes (k, 5) of a YOLO label: class and centre and size, or the corners of an outline, as shares of the picture."""
    boxes = []
    for line in label.read_text().splitlines() if label.exists() else ():
        row = np.array(line.split(), float)
        if len(row) >= 5:
            points = row[1:].reshape(-1, 2) if len(row) > 5 else row[1:3] + np.array([[-0.5], [0.5]]) * row[3:]
            boxes.append([place.classes[int(row[0])], *points.min(0), *points.max(0)])
    return np.array(boxes, np.float32).reshape(-1, 5)


def read_corners(picture: Path, place: Place) -> NDArray[np.float32]:
    """Boxes (k, 5) of a label in pixels beside a picture: x1, y1, x2, y2 in each row."""
    label = picture.with_suffix('.bboxes.tsv')
    rows = np.loadtxt(label, ndmin=2) if label.exists() else np.empty((0, 4))
    return np.pad(rows.reshape(-1, 4), ((0, 0), (1, 0)), constant_values=place.classes[0]).astype(np.float32)
