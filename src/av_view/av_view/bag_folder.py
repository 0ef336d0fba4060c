"""The bags of one folder, by their names."""

from __future__ import annotations

from pathlib import Path

FILES = ('.mcap', '.db3')
MOST_BAGS = 500


class BagFolder:
    """A folder whose bags may be opened, and nothing else.

    Parameters:
        folder: the folder; empty for none.
    """

    def __init__(self, folder: str) -> None:
        self._folder = Path(folder).expanduser().resolve() if folder else None

    def names(self) -> list[str]:
        """Names of the bags, the newest first: files by their ending, folders by their metadata. Raises OSError."""
        if self._folder is None:
            return []
        found = [entry for entry in self._folder.iterdir() if _is_bag(entry) and entry.resolve().parent == self._folder]
        return [entry.name for entry in sorted(found, key=lambda entry: -entry.stat().st_mtime)[:MOST_BAGS]]

    def path(self, name: object) -> str:
        """The path of a bag. Raises ValueError for what is not one of `names`."""
        if self._folder is None or name not in self.names():
            raise ValueError(f'{str(name)[:80]!r} is no bag of the folder {self._folder or "(none is set: bags:=FOLDER)"}')
        return str(self._folder / str(name))


def _is_bag(entry: Path) -> bool:
    return (entry.suffix in FILES and entry.is_file()) or (entry / 'metadata.yaml').is_file()
