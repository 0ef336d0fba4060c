"""Files of users, checked before they are read: devices, pipes, folders and files of absurd size are named, not opened."""

from __future__ import annotations

import os
import reprlib
import stat
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

MEGABYTE = 1_000_000
LONGEST_LINE = 300  # characters
_SHORT = reprlib.Repr()
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = 4
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 60
_SHORT.maxlevel = 3


def ros_home() -> Path:
    """The folder in which ROS keeps what is a user's: ROS_HOME, by default ~/.ros."""
    return Path(os.environ.get('ROS_HOME') or '~/.ros').expanduser()


def check_file(path: str | Path, most_bytes: float = float('inf'), kind: str = '') -> Path:
    """The path of a regular file of at most `most_bytes`. Raises OSError in one line that names the file and what it is.

    Parameters:
        path: the file; ~ is the user's home.
        most_bytes (bytes): largest size.
        kind: what the file should be, such as 'sound file', for the message.
    """
    named = f'{kind} {path}'.strip()
    try:
        found = Path(path).expanduser()
        status = found.stat()
    except FileNotFoundError as error:
        raise FileNotFoundError(f'{named} does not exist') from error
    except (OSError, ValueError, RuntimeError) as error:
        raise OSError(f'{named} cannot be read: {one_line(getattr(error, "strerror", None) or error)}') from error
    if not stat.S_ISREG(status.st_mode):
        raise OSError(f'{named} is {_kind(status.st_mode)}, expected a file')
    if status.st_size > most_bytes:
        raise OSError(f'{named} has {status.st_size / MEGABYTE:.1f} MB, expected at most {most_bytes / MEGABYTE:g} MB')
    return found


def read_text(path: str | Path, most_bytes: int = MEGABYTE, kind: str = '') -> str:
    """The text of a file in UTF-8, or in UTF-16 with its mark. Raises OSError or ValueError in one line that names the file.

    Parameters:
        path, most_bytes, kind: as for `check_file`.
    """
    file = check_file(path, most_bytes, kind)
    with file.open('rb') as opened:
        content = opened.read(most_bytes + 1)   # files of the kernel have no size
    if len(content) > most_bytes:
        raise OSError(f'{kind} {path} has more than {most_bytes / MEGABYTE:g} MB'.strip())
    try:
        return content.decode('utf-16' if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else 'utf-8-sig')
    except UnicodeDecodeError as error:
        raise ValueError(f'{kind} {path} is no text: byte {error.start} is {content[error.start]:#04x}'.strip()) from error


def shown(value: Any) -> str:
    """A value in an error message: its `repr`, in one line and shortened, also for nested and recursive ones."""
    return one_line(_SHORT.repr(value))


def one_line(text: object) -> str:
    """A text without line breaks, cut after LONGEST_LINE: messages of libraries may hold a whole file."""
    words = ' '.join(str(text).split())
    return words if len(words) <= LONGEST_LINE else f'{words[:LONGEST_LINE]} ...'


def _kind(mode: int) -> str:
    kinds = {stat.S_ISDIR: 'a folder', stat.S_ISFIFO: 'a pipe', stat.S_ISSOCK: 'a socket'}
    return next((name for test, name in kinds.items() if test(mode)), 'a device')


def nearest(name: str, known: Iterable[str]) -> str:
    """The most similar of the known names, for a message about one that is not among them."""
    return next(iter(get_close_matches(name, sorted(known), 1, 0.0)), 'none')
