"""`ros2 launch PACKAGE FILE [NAME:=VALUE ...]` or `ros2 launch PATH [NAME:=VALUE ...]`."""

from __future__ import annotations

import argparse
import signal
from pathlib import Path

import psutil
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource
from launch.launch_introspector import LaunchIntrospector
from ros2cli.command import CommandExtension

GRACE = 10.0  # s, time for processes to end after a signal


class LaunchCommand(CommandExtension):
    """Run a launch file."""

    def add_arguments(self, parser: argparse.ArgumentParser, cli_name: str) -> None:
        """Declare the arguments of the command line."""
        del cli_name
        parser.add_argument('-n', '--noninteractive', action='store_true', help='the processes have no terminal')
        parser.add_argument('-d', '--debug', action='store_true', help='log the actions of the launch system')
        parser.add_argument('-p', '--print', '--print-description', dest='describe', action='store_true',
                            help='print the launch description instead of running it')
        parser.add_argument('-s', '--show-args', '--show-arguments', dest='show_arguments', action='store_true',
                            help='print the arguments of the launch file instead of running it')
        parser.add_argument('package_name', help='name of the package that has the launch file, or the path of one')
        parser.add_argument('launch_file_name', nargs='?', help='name of the launch file')
        parser.add_argument('launch_arguments', nargs='*', help="arguments of the launch file, as '<name>:=<value>'")

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> int | str:
        """Run the launch file and return its exit code, or an error of the command line."""
        del parser
        try:
            path, words = find_launch_file(args.package_name, args.launch_file_name, args.launch_arguments)
            arguments = parse_arguments(words)
        except ValueError as error:
            return str(error)
        source = AnyLaunchDescriptionSource(str(path))
        if args.show_arguments:
            print(describe_arguments(source.try_get_launch_description_without_context()))
            return 0
        if args.describe:
            description = source.try_get_launch_description_without_context()
            print(LaunchIntrospector().format_launch_description(description))
            return 0
        service = LaunchService(argv=words, noninteractive=args.noninteractive, debug=args.debug)
        include = IncludeLaunchDescription(source, launch_arguments=arguments)
        service.include_launch_description(LaunchDescription([include]))
        return run(service)


def run(service: LaunchService) -> int:
    """Run a launch service until it and all its processes have ended; returns its exit code."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT):
        # The service reads signals from a pipe. Python's default handlers would interrupt it anywhere, or end it at once.
        signal.signal(number, lambda *_: None)
    code = service.run()
    left = psutil.Process().children(recursive=True)
    for process in left:
        process.send_signal(signal.SIGINT)
    for process in psutil.wait_procs(left, timeout=GRACE)[1]:
        process.kill()
    return code


def find_launch_file(package: str, name: str | None, words: list[str]) -> tuple[Path, list[str]]:
    """Return the path of the launch file, and the words of the command line that are its arguments.

    :raises ValueError: no such package or file, or several files of that name.
    """
    if Path(package).is_file():
        return Path(package), ([name] if name else []) + words
    if name is None:
        raise ValueError(f"'{package}' is not a file: give the name of a package and of its launch file")
    try:
        share = Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError) as error:
        raise ValueError(f"Package '{package}' not found: {error}") from error
    found = sorted(path for path in share.rglob(name) if path.is_file())
    if len(found) != 1:
        raise ValueError(f"expected one file '{name}' in {share}, found {[str(path) for path in found] or 'none'}")
    return found[0], words


def parse_arguments(words: list[str]) -> list[tuple[str, str]]:
    """Split '<name>:=<value>'; the last value of a name counts.

    :raises ValueError: a word of another form.
    """
    pairs = {}
    for word in words:
        name, separator, value = word.partition(':=')
        if not name or not separator:
            raise ValueError(f"malformed launch argument '{word}', expected '<name>:=<value>'")
        pairs[name] = value
    return list(pairs.items())


def describe_arguments(description: LaunchDescription) -> str:
    """List the arguments that a launch file declares, with what they mean and their default values."""
    lines = ["Arguments (pass arguments as '<name>:=<value>'):"]
    for argument in description.get_launch_arguments():
        lines += ['', f"    '{argument.name}':", f'        {argument.description}']
        if argument.choices:
            lines.append(f'        one of: {", ".join(map(repr, argument.choices))}')
        if argument.default_value is not None:
            lines.append(f'        (default: {" + ".join(part.describe() for part in argument.default_value)})')
    return '\n'.join(lines if len(lines) > 1 else [*lines, '', '    no arguments'])
