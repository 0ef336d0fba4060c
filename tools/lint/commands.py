"""Commands in documents can be typed: shell syntax, programs, their options, launch arguments, parameters and targets exist.

What does not is printed with its page; exit code 1 if there is any. Programs are read from each setup.py, launch arguments from
the launch files, parameters from the YAML. A program is run up to where it has parsed its command line, in a built workspace;
elsewhere command lines are left to the tests, which run this after the build.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest import mock

import yaml

PROJECT = Path(__file__).resolve().parents[2]
sys.path[:0] = map(str, PROJECT.glob('src/av_*'))
BLOCK = re.compile(r'^```(bash|yaml)\n(.*?)^```', re.MULTILINE | re.DOTALL)
INLINE = re.compile(r'(?<!`)`((?:ros2 (?:run|launch|param|topic|service)|make) [^`\n]+(?:\n[^`\n]+)*)`')
PLACEHOLDER = re.compile(r'[<>]|\.\.\.|^[A-Z_]+$')
OF_ALL_NODES = {'use_sim_time'}


class Parsed(BaseException):
    """A program has parsed its command line."""


@cache
def programs(package: str) -> dict[str, str]:
    """The module of each of a package's programs by name."""
    return dict(re.findall(r"'(\w+) = ([\w.]+):main'", (PROJECT / 'src' / package / 'setup.py').read_text()))


def complaint(module: str, arguments: list[str]) -> str:
    """What a program says of a command line that it does not take; empty where it takes it, or cannot be imported.

    Parameters:
        module: whose `main` parses it, by argparse.
        arguments: behind the program's name.
    """
    parse, said = argparse.ArgumentParser.parse_args, io.StringIO()

    def stop(self: argparse.ArgumentParser, *given: Any) -> None:
        parse(self, *given)
        raise Parsed

    with mock.patch.object(argparse.ArgumentParser, 'parse_args', stop), mock.patch.object(sys, 'argv', [module, *arguments]), \
            redirect_stderr(said):
        try:
            import_module(module).main()
        except (Parsed, ImportError, LookupError):    # messages, parameters and shared folders come with the build
            return ''
        except SystemExit:
            return said.getvalue().strip().splitlines()[-1]
    raise RuntimeError(f'{module} has parsed nothing')


@cache
def parameters(node: str) -> set[str]:
    """Parameters of a node by its YAML, empty for a node that has none here."""
    def names(content: dict, prefix: str = '') -> Iterator[str]:
        for key, value in content.items():
            if isinstance(value, dict) and 'type' in value:
                yield prefix + key
            elif isinstance(value, dict):
                yield from names(value, f'{prefix}{key}.')
    files = list(PROJECT.glob(f'src/*/*/nodes/{node}_parameters.yaml'))
    return set(names(yaml.safe_load(files[0].read_text())[node])) if files else set()


@cache
def launch_arguments(file: str) -> set[str]:
    """Arguments of a launch file: the strings in the tables from which it is made."""
    found: set[str] = set()
    for path, tables in ((PROJECT / 'launch' / file, ('ARGUMENTS', 'REPORTS')),
                         *((path, ('RIG_ARGUMENTS',)) for path in PROJECT.glob('src/av_bringup/av_bringup/*.py'))):
        for node in ast.walk(ast.parse(path.read_text())):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
            if any(isinstance(target, ast.Name) and target.id in tables for target in targets):
                found |= {one.value for one in ast.walk(node) if isinstance(one, ast.Constant) and isinstance(one.value, str)}
    return found


def commands(page: Path) -> Iterator[str]:
    """The commands of a page: lines of its shell blocks, and those in its text."""
    text = page.read_text()
    for kind, block in BLOCK.findall(text):
        if kind == 'bash':
            yield from filter(None, (line.strip() for line in block.replace('\\\n', ' ').split('\n')))
    for command in INLINE.findall(BLOCK.sub('', text)):
        yield ' '.join(command.split())


def faults_of(command: str) -> Iterator[str]:
    """What cannot be typed of a command.

    Parameters:
        command: one line.
    """
    try:
        words = shlex.split(command, comments=True)
    except ValueError as error:
        yield f'{error}'
        return
    for k, word in enumerate(words):
        rest = words[k + 1:]
        end = next((i for i, one in enumerate(rest) if one in ('|', '&&', ';', '#', '>')), len(rest))
        rest = rest[:end]
        if word == 'make' and k == 0 and rest and not any(PLACEHOLDER.search(one) for one in rest[:1]):
            targets = set(re.findall(r'^(\w+):', (PROJECT / 'Makefile').read_text(), re.MULTILINE))
            yield from (f'make has no target {one}' for one in rest if re.fullmatch(r'[a-z]+', one) and one not in targets)
        elif word == 'ros2' and len(rest) > 2 and rest[0] == 'run' and (PROJECT / 'src' / rest[1] / 'setup.py').exists():
            yield from _faults_of_program(rest[1], rest[2], rest[3:])
        elif word == 'ros2' and len(rest) > 2 and rest[0] == 'launch' and rest[1].startswith('av_'):
            yield from _faults_of_launch(rest[2], rest[3:])


def _faults_of_program(package: str, program: str, rest: list[str]) -> Iterator[str]:
    if PLACEHOLDER.search(program):
        return
    if program not in programs(package):
        yield f'{package} has no program {program}'
        return
    if '--ros-args' in rest:
        known = parameters(program)
        for one in rest[rest.index('--ros-args'):]:
            name = one.partition(':=')[0]
            told = ':=' in one and re.fullmatch(r'[a-z][\w.]*', name)
            if told and name not in known | OF_ALL_NODES:
                yield f'{program} has no parameter {name}'
        rest = rest[:rest.index('--ros-args')]
    module = programs(package)[program]
    if rest and '.nodes.' not in module and (said := complaint(module, rest)):    # its bare name is no command line
        yield said


def _faults_of_launch(file: str, rest: list[str]) -> Iterator[str]:
    if PLACEHOLDER.search(file):
        return
    if not (PROJECT / 'launch' / file).exists():
        yield f'there is no launch file {file}'
        return
    for one in rest:
        name, assigned, value = one.partition(':=')
        if assigned and re.fullmatch(r'\w+', name) and name not in launch_arguments(file):
            yield f'{file} has no argument {name}'
        elif (name == 'scenario' and re.fullmatch(r'[a-z]\w*', value)
              and not (PROJECT / 'config/scenarios' / f'{value}.yaml').exists()):
            yield f'there is no scenario {value}'


def faults_of_yaml(block: str) -> Iterator[str]:
    """Parameters in a block of YAML that no node has.

    Parameters:
        block: its text.
    """
    try:
        content = yaml.safe_load(block)
    except yaml.YAMLError as error:
        yield f'no YAML: {str(error).splitlines()[0]}'
        return
    for node, value in content.items() if isinstance(content, dict) else ():
        known = parameters(str(node).split('/')[-1])
        if isinstance(value, dict) and isinstance(value.get('ros__parameters'), dict) and known:
            for name in value['ros__parameters']:
                if name not in known and not any(one.startswith(f'{name}.') for one in known):
                    yield f'{node} has no parameter {name}'


def main() -> int:
    """Check every page that git knows; returns the exit code."""
    found = []
    for name in subprocess.check_output(['git', 'ls-files', '*.md'], text=True, cwd=PROJECT).splitlines():
        page = PROJECT / name
        if not page.exists() or name == 'CHANGELOG.md':
            continue
        for kind, block in BLOCK.findall(page.read_text()):
            if kind == 'bash' and not re.search(r'<\w+ \w+>', block):
                done = subprocess.run(['bash', '-n'], input=block, capture_output=True, text=True, check=False)
                found += [f'{name}: {done.stderr.strip()}'] if done.returncode else []
            elif kind == 'yaml':
                found += [f'{name}: {fault}' for fault in faults_of_yaml(block)]
        found += [f'{name}: {fault}: {command}' for command in commands(page) for fault in faults_of(command)]
    print(*found, sep='\n', end='\n' if found else '')
    return bool(found)


if __name__ == '__main__':
    sys.exit(main())
