"""The files of a bag: which belong to it by its metadata.yaml, and what is inside those that are compressed as a whole."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path, PureWindowsPath
from typing import Any

from rosbags.rosbag2 import Reader

from av_bags.decompression import expand
from av_bags.definitions import BagError
from av_common.files import check_file, one_line
from av_common.yaml_reader import load_yaml

MAGICS = {'mcap': b'\x89MCAP0\r\n', 'sqlite3': b'SQLite format 3\x00', 'ros1': b'#ROSBAG V'}
SUFFIXES = {'.mcap': 'mcap', '.db3': 'sqlite3'}
COMPRESSED = '.zstd'
LOGS = ('-wal', '-journal')    # of sqlite3, beside a database whose writer did not close it


class Parts:
    """The files of a bag.

    Parameters:
        path: an mcap or sqlite3 file, or a folder of rosbag2.
        folder: makes a new folder for the copy of a file that is compressed, or was not closed.
        opened: opens a file, or its copy.

    Attributes:
        readers: of those that can be read, in the order of recording where metadata tell.
        described: whether metadata tell which files belong to the bag.
        by_message: whether each message is compressed.
        lost: what is missing.
        notes: what was left out with reason.

    Raises BagError when there is no bag, else the error of the last file where none can be read.
    """

    def __init__(self, path: Path, folder: Callable[[], Path], opened: Callable[[Path], Reader]) -> None:
        self.described = self.by_message = False
        self.lost: list[str] = []
        self.notes: list[str] = []
        self._path = path
        if not path.exists():
            raise BagError(f'{path}: no such bag')
        self.readers: list[Reader] = []
        files = self._of_folder() if path.is_dir() else [path]
        for file in files:
            try:
                self.readers.append(opened(self._checked(file, folder)))
            except Exception as error:    # libraries raise any type, for one that was empty when the disk was full, too
                if file == files[-1] and not self.readers:
                    raise
                named = isinstance(error, BagError)    # with its file
                self.lost.append(str(error) if named else f'{file} cannot be read: {one_line(error)}')

    def _checked(self, file: Path, folder: Callable[[], Path]) -> Path:
        """A file, or the copy of one that is compressed. Raises ValueError or OSError where it cannot be read."""
        check_file(file)
        if file.suffix != COMPRESSED:
            _check_kind(file, file)
            return _closed(file, folder)
        copy = folder() / file.stem
        problem = expand(file, copy)
        _check_kind(copy, file)
        self.lost += [problem] if problem else []
        return copy

    def _of_folder(self) -> list[Path]:
        """The files of a folder. Hidden ones are none: macOS writes a `._NAME` beside each file on disks of other systems."""
        there = sorted(file for file in self._path.iterdir() if not file.name.startswith('.') and (
            file.suffix.lower() in SUFFIXES or (file.suffix == COMPRESSED and Path(file.stem).suffix in SUFFIXES)))
        listed = self._listed()
        if listed is None:
            if not there:
                raise BagError(f'{self._path} is no bag: a folder without metadata.yaml, .mcap or .db3')
            return there
        by_name = {file.name: file for file in there}
        found = [by_name[name] for name in listed if name in by_name]
        missing = [name for name in listed if name not in by_name]
        if not found and there:
            self.notes.append(f'no file of metadata.yaml is there ({", ".join(missing)}): those of the folder are read')
            return there
        if not found:
            raise BagError(f'{self._path}: what metadata.yaml lists is not there: {", ".join(missing) or "it lists no file"}')
        self.described = True
        self.lost += [f'{name} is missing, which metadata.yaml lists' for name in missing]
        self.notes += [f'{file.name} is left out: metadata.yaml does not list it' for file in there if file not in found]
        return found

    def _listed(self) -> list[str] | None:
        """Names of the files in metadata.yaml; None without one that can be read."""
        metadata = self._path / 'metadata.yaml'
        if not metadata.is_file():
            return None
        try:
            content: Any = load_yaml(metadata)['rosbag2_bagfile_information']
            self.by_message = str(content.get('compression_mode') or '').lower() == 'message'
            # of Windows, too
            return list(dict.fromkeys(PureWindowsPath(str(name)).name for name in content['relative_file_paths']))
        except (ValueError, OSError, KeyError, TypeError, AttributeError) as error:
            self.by_message = False
            self.notes.append(f'metadata.yaml cannot be read ({one_line(error)}): all files of the folder are read')
            return None


def _closed(file: Path, folder: Callable[[], Path]) -> Path:
    """A copy of a database with what is in its log only, which rosbags does not read; any other file as it is."""
    logs = [log for log in (file.with_name(f'{file.name}{ending}') for ending in LOGS) if log.is_file() and log.stat().st_size]
    if file.suffix.lower() != '.db3' or not logs:
        return file
    copy = folder() / file.name
    for each in (file, *logs):
        shutil.copy(each, copy.with_name(each.name))
    with suppress(sqlite3.Error), closing(sqlite3.connect(copy)) as database:    # of a damaged one what the file itself holds
        database.execute('PRAGMA journal_mode = DELETE')
    return copy


def _check_kind(path: Path, named: Path) -> None:
    """Raise BagError, which names the file `named`, when a file is not a bag of ROS 2."""
    with path.open('rb') as file:
        head = file.read(16)
    kind = next((kind for kind, magic in MAGICS.items() if head.startswith(magic)), None)
    if not head:
        raise BagError(f'{named} is empty: 0 bytes')
    if kind == 'ros1':
        raise BagError(f'{named} is a bag of ROS 1; convert it with: rosbags-convert --src {named} --dst FOLDER')
    if kind is None or kind != SUFFIXES.get(path.suffix.lower()):
        content = kind or 'neither mcap nor sqlite3'
        raise BagError(f'{named} is no bag: its content is {content}, expected a .mcap or .db3 file or a folder of them')
