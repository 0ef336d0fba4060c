"""Prints what pages in Markdown name and does not exist: files and headings of links, modules; exit code 1 if there is any.

A module is named by its file, such as `wire/audio.py`, or imported by an example. Capitals stand for any name.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

CODE = re.compile(r'^```.*?^```', re.MULTILINE | re.DOTALL)
LINK = re.compile(r'\]\(<?([^)\s>]+)')
MODULE = re.compile(r'(?<![\w./])(?:\.\./)*((?:[\w-]+/)*\w+\.py)\b')
IMPORT = re.compile(r'^(?:from|import) (av_[\w.]+)', re.MULTILINE)


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


def missing(page: Path, files: set[Path]) -> list[str]:
    """The modules that a page names and that are not among the files of the repository."""
    text = page.read_text()
    imported = [name.replace('.', '/') for name in IMPORT.findall(text)]
    named = [name for name in MODULE.findall(text) if not re.search('[A-Z]{3}', name)]
    paths = [f'/{file}' for file in files]
    found = [name for name in named if not any(path.endswith(f'/{name}') for path in paths)]
    found += [name for name in imported if not any(path.endswith((f'/{name}.py', f'/{name}/__init__.py')) for path in paths)]
    return [f'{page}: there is no {name}' for name in dict.fromkeys(found)]


def main() -> int:
    """Check every page that git knows; returns the exit code."""
    files = {Path(name) for name in subprocess.check_output(['git', 'ls-files'], text=True).splitlines()}
    files = {file for file in files if file.exists()}
    known = {path for file in files for path in (file.resolve(), *file.resolve().parents)}
    pages = [file for file in sorted(files) if file.suffix == '.md']
    problems = [line for page in pages for line in (*broken(page, known), *missing(page, files))]
    print('\n'.join(problems), end='\n' if problems else '')
    return bool(problems)


if __name__ == '__main__':
    sys.exit(main())
