"""Links in Markdown to files that git does not have or headings that a page lacks are printed; exit code 1 if there are any."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

CODE = re.compile(r'^```.*?^```', re.MULTILINE | re.DOTALL)
LINK = re.compile(r'\]\(<?([^)\s>]+)')


def anchors(page: Path) -> set[str]:
    """The names by which GitHub links to the headings of a page."""
    headings = re.findall(r'^#+ +(.+?)\s*$', CODE.sub('', page.read_text()), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', re.sub(r'\]\(.*?\)', '', heading)).lower().replace(' ', '-') for heading in headings}


def broken(page: Path, known: set[Path]) -> list[str]:
    """The links of a page whose file is not among the known ones, or whose heading does not exist."""
    found = []
    for link in LINK.findall(CODE.sub('', page.read_text())):
        name, _, anchor = link.partition('#')
        target = (page.parent / name).resolve() if name else page.resolve()
        if not re.match(r'[a-z]+:', link) and (target not in known or (anchor and anchor not in anchors(target))):
            found.append(f'{page}: {link} leads nowhere')
    return found


def main() -> int:
    """Check every page that git knows; returns the exit code."""
    files = {Path(name) for name in subprocess.check_output(['git', 'ls-files'], text=True).splitlines()}
    known = {path for file in files if file.exists() for path in (file.resolve(), *file.resolve().parents)}
    problems = [line for file in sorted(files) if file.suffix == '.md' and file.exists() for line in broken(file, known)]
    print('\n'.join(problems), end='\n' if problems else '')
    return bool(problems)


if __name__ == '__main__':
    sys.exit(main())
