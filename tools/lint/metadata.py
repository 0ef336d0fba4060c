"""Every package has the version, maintainer and licence of the suite, and a release 60 lines of changes: `metadata.py src/*`.

The newest heading of CHANGELOG.md says the version. CITATION.cff and each package.xml repeat it, since those who cite, and ROS,
read it there; so does a setup.py that does not read it from its package.xml, and that one's description.
"""

from __future__ import annotations

import ast
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
    """Metadata in a package.xml, by the names of setup.py's arguments."""
    root = ET.parse(file).getroot()
    maintainer = root.find('maintainer')
    found = {name: root.findtext(name) or '' for name in ('version', 'description', 'license')}
    if maintainer is not None:
        found |= {'maintainer': maintainer.text or '', 'maintainer_email': maintainer.get('email', '')}
    return found


def setup(file: Path) -> dict[str, str]:
    """Arguments of `setup` in a setup.py that are string constants."""
    calls = [node for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))) if isinstance(node, ast.Call)]
    arguments = [argument for call in calls if getattr(call.func, 'id', '') == 'setup' for argument in call.keywords]
    return {argument.arg: argument.value.value for argument in arguments
            if argument.arg and isinstance(argument.value, ast.Constant) and isinstance(argument.value.value, str)}


def faults(packages: list[Path]) -> Iterator[str]:
    """Each place whose metadata differ."""
    version, date = newest()
    wanted = {'version': version, 'maintainer': MAINTAINER, 'maintainer_email': ADDRESS, 'license': LICENSE}
    for release in re.split(r'^(?=## )', (PROJECT / 'CHANGELOG.md').read_text(encoding='utf-8'), flags=re.M)[1:]:
        title, *lines = filter(str.strip, release.splitlines())
        if len(lines) > MOST_LINES:
            yield f'CHANGELOG.md: {title} has {len(lines)} lines, expected at most {MOST_LINES}'
    citation = (PROJECT / 'CITATION.cff').read_text(encoding='utf-8')
    for line in (f'version: {version}', f'date-released: {date}'):
        if line not in citation.replace("'", '').replace('"', '').splitlines():
            yield f'CITATION.cff: expected {line}'
    for package in packages:
        said = manifest(package / 'package.xml')
        yield from differences(package / 'package.xml', said, wanted)
        file = package / 'setup.py'
        if file.exists() and 'set_up(' not in file.read_text(encoding='utf-8'):
            yield from differences(file, setup(file), wanted | {'description': said['description']})


def differences(file: Path, given: dict[str, str], wanted: dict[str, str]) -> Iterator[str]:
    """Each expected value that a file lacks.

    Parameters:
        file: the file.
        given: its metadata.
        wanted: expected metadata.
    """
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
