"""Every package has the version, maintainer and licence of the suite, and a release 60 lines of changes: `metadata.py src/*`.

The newest heading of CHANGELOG.md says the version. CITATION.cff and each package.xml repeat it, since those who cite, and ROS,
read it there.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

PROJECT = Path(__file__).resolve().parents[2]
MOST_LINES = 60  # of a release in CHANGELOG.md, without empty ones
MAINTAINER, ADDRESS, LICENSE = 'The av_rig maintainers', 'av_rig@users.noreply.github.com', 'Apache-2.0'


def newest() -> tuple[str, str]:
    """Version and date of the newest release in CHANGELOG.md.

    Raises ValueError when there is none.
    """
    text = (PROJECT / 'CHANGELOG.md').read_text(encoding='utf-8')
    match = re.search(r'^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d{2}-\d{2})$', text, re.M)
    if not match:
        raise ValueError('CHANGELOG.md: no heading such as "## [1.2.3] - 2026-01-31"')
    return match[1], match[2]


def manifest(file: Path) -> dict[str, str]:
    """Metadata in a package.xml, from which its setup.py takes them."""
    root = ET.parse(file).getroot()
    maintainer = root.find('maintainer')
    found = {name: root.findtext(name) or '' for name in ('version', 'license')}
    if maintainer is not None:
        found |= {'maintainer': maintainer.text or '', 'address': maintainer.get('email', '')}
    return found


def faults(packages: list[Path]) -> Iterator[str]:
    """Each place whose metadata differ."""
    version, date = newest()
    wanted = {'version': version, 'maintainer': MAINTAINER, 'address': ADDRESS, 'license': LICENSE}
    for release in re.split(r'^(?=## )', (PROJECT / 'CHANGELOG.md').read_text(encoding='utf-8'), flags=re.M)[1:]:
        title, *lines = filter(str.strip, release.splitlines())
        if len(lines) > MOST_LINES:
            yield f'CHANGELOG.md: {title} has {len(lines)} lines, expected at most {MOST_LINES}'
    citation = (PROJECT / 'CITATION.cff').read_text(encoding='utf-8')
    for line in (f'version: {version}', f'date-released: {date}'):
        if line not in citation.replace("'", '').replace('"', '').splitlines():
            yield f'CITATION.cff: expected {line}'
    for file in (package / 'package.xml' for package in packages):
        given = manifest(file)
        for key, value in wanted.items():
            if given.get(key) != value:
                yield f'{file}: {key} is {given.get(key)!r}, expected {value!r}'


def main(arguments: list[str]) -> int:
    """Print the faults. Returns the exit code: 1 if there are any, else 0."""
    found = list(faults([folder for folder in map(Path, arguments) if (folder / 'package.xml').exists()]))
    print(*found, sep='\n', end='\n' if found else '')
    return int(bool(found))


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
