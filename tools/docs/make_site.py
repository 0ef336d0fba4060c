"""The documents as a site: `make docs` writes build/docs/html/index.html.

The pages are those of the tree. Generated are the public names of each package (from their docstrings), the messages (from
av_interfaces), the parameters of each node (from the YAML), and a page of each program and file that a page links to, examples
with their pictures. Sphinx is installed in build/docs/tools.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml

PROJECT = Path(__file__).resolve().parents[2]
BUILD = PROJECT / 'build/docs'
SOURCE, TOOLS = BUILD / 'source', BUILD / 'tools'
COPIED = ('.md', '.png', '.jpg', '.svg')
SECTIONS = {'Tutorials': 'docs/tutorials/*.md', 'Guides': 'docs/guides/*.md', 'Reference': 'docs/reference/*.md',
            'Interface': 'docs/interface/*.md', 'Packages': 'src/*/README.md'}
SINGLE = ('docs/architecture.md', 'docs/results.md', 'docs/decisions.md', 'examples/README.md', 'src/av_audio/models/README.md',
          'src/av_vision/models/README.md', 'training/detector/README.md', 'training/detector/HISTORY.md',
          'training/sound/README.md', 'CONTRIBUTING.md', 'CHANGELOG.md')
LINK = re.compile(r'(?<=\]\()[^)\s>#:]+')
LANGUAGES = {'.py': 'python', '.yaml': 'yaml', '.cff': 'yaml', '.xml': 'xml'}
# Pages in the place of folders without a README, and of the first page.
ELSEWHERE = {'src': 'docs/architecture.md', 'src/av_interfaces/msg': 'docs/interface/messages.md', 'README.md': 'index.md'}


def packages() -> list[str]:
    """Names of the Python packages of the suite."""
    return sorted(file.parent.name for file in PROJECT.glob('src/*/setup.py'))


def parameters_page() -> str:
    """The parameters of all nodes as tables."""
    lines = ['# Parameters', '', 'Made from `src/*/*/nodes/*_parameters.yaml`. Live: `ros2 param describe /fusion_node tau`.']
    for file in sorted(PROJECT.glob('src/*/*/nodes/*_parameters.yaml')):
        for node, content in yaml.safe_load(file.read_text()).items():
            lines += ['', f'## {node}', '', '| parameter | default | type, bounds | what it is |', '|---|---|---|---|']
            lines += [f'| `{name}` | {cell(one.get("default_value"))} | {one["type"]}{bounds(one)} | {text(one)} |'
                      for name, one in flat(content)]
    return '\n'.join(lines) + '\n'


def flat(content: dict[str, Any], prefix: str = '') -> Iterator[tuple[str, dict[str, Any]]]:
    """Each parameter of a node with its full name.

    Parameters:
        content: of the YAML.
        prefix: of the names.
    """
    for name, one in content.items():
        if isinstance(one, dict) and 'type' in one:
            yield f'{prefix}{name}', one
        elif isinstance(one, dict):
            yield from flat(one, f'{prefix}{name}.')


def cell(value: object) -> str:
    """A value as code in a cell."""
    return '' if value in (None, '') else '`' + str(value).replace('|', '\\|') + '`'


def bounds(parameter: dict[str, Any]) -> str:
    """The rules of a parameter's value as text."""
    rules = [f'{name.removesuffix("<>")} {" to ".join(map(str, value)) if name.startswith("bounds") else value}'
             for name, value in (parameter.get('validation') or {}).items()]
    return ''.join(f'; {rule}' for rule in rules).replace('|', '\\|')


def text(parameter: dict[str, Any]) -> str:
    """The description of a parameter, and whether it can change while the node runs."""
    fixed = ' Fixed once the node is configured.' if parameter.get('read_only') else ''
    return str(parameter.get('description', '')).replace('|', '\\|').replace('\n', ' ').rstrip('.') + '.' + fixed


def messages_page() -> str:
    """The messages and services of av_interfaces with their comments."""
    lines = ['# Messages', '', 'Made from `src/av_interfaces`.']
    for kind in ('msg', 'srv'):
        for file in sorted(PROJECT.glob(f'src/av_interfaces/{kind}/*.{kind}')):
            lines += ['', f'## {file.stem}', '', f'```\n{file.read_text().strip()}\n```']
    return '\n'.join(lines) + '\n'


def package_page(package: str) -> str:
    """The public names of a package, which Sphinx fills with their docstrings.

    Parameters:
        package: its name.
    """
    module = import_module(package)
    lines = [f'# {package}', '', (module.__doc__ or '').strip(), '']
    for name in module.__all__:
        found = getattr(module, name)
        kind = 'autoclass' if isinstance(found, type) else 'autofunction' if callable(found) else 'autodata'
        members = '\n   :members:' if kind == 'autoclass' else ''
        place = f'{getattr(found, "__module__", package)}.{name}' if kind != 'autodata' else f'{package}.{name}'
        lines += [f'## {name}', '', f'`from {package} import {name}`', '',
                  f'```{{eval-rst}}\n.. {kind}:: {place}{members}\n```', '']
    return '\n'.join(lines)


def page(name: str) -> str:
    """A page of the tree, with links that hold in the site.

    Parameters:
        name: its path in the project.
    """
    def link(found: re.Match[str]) -> str:
        target = os.path.normpath(Path(name).parent / found[0])
        if target in ELSEWHERE:
            return os.path.relpath(ELSEWHERE[target], Path(name).parent)
        if (PROJECT / target / 'README.md').exists():
            return f'{found[0]}/README.md'
        if target.endswith(COPIED) or not (PROJECT / target).is_file():
            return found[0]
        write_listing(target)
        return f'{found[0]}.md'
    return LINK.sub(link, re.sub(r'<!--.*?-->\n?', '', (PROJECT / name).read_text()))


def write_listing(name: str) -> None:
    """The page of a program or another file.

    Parameters:
        name: its path in the project.
    """
    file = PROJECT / name
    picture = PROJECT / f'docs/images/examples/{file.stem}.png'
    shown = f'![what it draws]({os.path.relpath(picture, file.parent)})\n\n' if picture.exists() else ''
    (SOURCE / name).parent.mkdir(parents=True, exist_ok=True)
    (SOURCE / f'{name}.md').write_text(f'---\norphan: true\n---\n\n# {name}\n\n{shown}'
                                       f'```{LANGUAGES.get(file.suffix, "text")}\n{file.read_text()}```\n')


def write_source() -> None:
    """The pages and pictures of the tree, the generated pages, and an index of all."""
    shutil.rmtree(SOURCE, ignore_errors=True)
    files = subprocess.check_output(['git', 'ls-files', '-co', '--exclude-standard'], text=True, cwd=PROJECT).splitlines()
    for name in (name for name in files if name.endswith(COPIED) and not name.startswith(('.', 'README'))):
        (SOURCE / name).parent.mkdir(parents=True, exist_ok=True)
        if name.endswith('.md'):
            (SOURCE / name).write_text(page(name))
        else:
            shutil.copy(PROJECT / name, SOURCE / name)
    interface = SOURCE / 'docs/interface'
    interface.mkdir(parents=True)
    (interface / 'parameters.md').write_text(parameters_page())
    (interface / 'messages.md').write_text(messages_page())
    for package in packages():
        (interface / f'{package}.md').write_text(package_page(package))
    tables = [('Start', ['docs/README.md']), *((title, sorted(str(file.relative_to(SOURCE)) for file in SOURCE.glob(pattern)))
                                               for title, pattern in SECTIONS.items()), ('More', list(SINGLE))]
    trees = '\n'.join(f'```{{toctree}}\n:caption: {title}\n:hidden:\n\n' + '\n'.join(pages) + '\n```\n'
                      for title, pages in tables)
    (SOURCE / 'index.md').write_text(f'{page("README.md")}\n{trees}')
    shutil.copy(PROJECT / 'tools/docs/conf.py', SOURCE / 'conf.py')


def main() -> int:
    """Build the site; returns the exit code of Sphinx."""
    write_source()
    requirements = PROJECT / 'tools/docs/requirements.txt'
    stamp = TOOLS / 'requirements.txt'
    if not stamp.exists() or stamp.read_text() != requirements.read_text():
        subprocess.run([sys.executable, '-m', 'pip', 'install', '-q', '--no-warn-conflicts', '--upgrade',
                        '--target', str(TOOLS), '-r', str(requirements)], check=True)
        stamp.write_text(requirements.read_text())
    environment = {**os.environ, 'PYTHONPATH': f'{TOOLS}{os.pathsep}{os.environ.get("PYTHONPATH", "")}'}
    command = [sys.executable, '-m', 'sphinx', '-q', '-W', '--keep-going', '-j', 'auto', '-b', 'html']  # dead links are errors
    code = subprocess.run([*command, str(SOURCE), str(BUILD / 'html')], env=environment, check=False).returncode
    if not code:
        print(f'see {BUILD / "html" / "index.html"}')
    return code


if __name__ == '__main__':
    sys.exit(main())
