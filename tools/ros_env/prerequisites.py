"""System packages for the environment and the tests: installed by apt-get where that is permitted, else listed.

Called by assemble.py, and as a program before the tests, since a kept environment may be used on a new machine.
"""

from __future__ import annotations

import ctypes.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

# Pairs of a Debian or Ubuntu package, and the program or library (as the linker calls it) by which it is found.
BUILD_TOOLS = [('gcc', 'cc'), ('g++', 'c++'), ('cmake', 'cmake'), ('make', 'make')]
TEST_TOOLS = [('pulseaudio', 'pulseaudio'), ('pulseaudio-utils', 'pactl'),  # microphones without hardware
              ('openssl', 'openssl'),  # keys of secured rigs
              ('chromium', 'chromium')]  # the page of the rig
LIBRARIES = [
    ('libportaudio2', 'portaudio'),  # sounddevice
    ('libusb-1.0-0', 'usb-1.0'),  # pyrealsense2
    ('libegl1', 'EGL'), ('libosmesa6', 'OSMesa'),  # mujoco
]
PLUGINS = [('libasound2-plugins', '/usr/lib/*-linux-gnu/alsa-lib/libasound_module_pcm_pulse.so')]
# A machine without network must not wait long, one that installs something else at the moment may.
APT_OPTIONS = ['Acquire::Retries=0', 'Acquire::http::Timeout=20', 'Acquire::https::Timeout=20', 'DPkg::Lock::Timeout=120']
PYTHON = ['python3.12', 'python3.12-venv', 'python3.12-dev']


class MissingError(Exception):
    """Something is missing that only the user can provide; the message says what and how."""


def say(message: str) -> None:
    """Print a message to stderr, with the name of this tool."""
    print(f'ros_env: {message}', file=sys.stderr, flush=True)


def install_system_packages() -> None:
    """Install missing packages, or list them; only the build tools are indispensable.

    :raises MissingError: a build tool is missing and cannot be installed.
    """
    if missing() and may_install():
        apt_install(missing())
    if missing():
        hint = f'sudo apt-get install {" ".join(missing())}'
        if missing_programs(BUILD_TOOLS):
            raise MissingError(f'missing: {" ".join(missing_programs(BUILD_TOOLS))}. On Debian or Ubuntu: {hint}')
        say(f'sound, cameras, rendering or some tests will not work without: {hint}')


def missing() -> list[str]:
    """Packages that are not found."""
    libraries = [package for package, library in LIBRARIES if not ctypes.util.find_library(library)]
    plugins = [package for package, pattern in PLUGINS if not any(Path('/').glob(pattern.lstrip('/')))]
    return missing_programs(BUILD_TOOLS + TEST_TOOLS) + libraries + plugins


def missing_programs(wanted: list[tuple[str, str]]) -> list[str]:
    """Packages whose program is not on the path."""
    return [package for package, program in wanted if not shutil.which(program)]


def may_install() -> bool:
    """Whether packages can be installed without asking for a password."""
    return os.geteuid() == 0 and shutil.which('apt-get') is not None


def apt_install(packages: list[str]) -> None:
    """Install packages one by one, so that a package missing in the distribution does not block the others."""
    say('updating the list of system packages')
    apt_get('update')
    for package in packages:
        say(f'installing the system package {package}')
        apt_get('install', '-y', '--no-install-recommends', package)


def apt_get(*arguments: str) -> None:
    """Run apt-get without questions and output; whether it worked shows in what is installed."""
    environment = {**os.environ, 'DEBIAN_FRONTEND': 'noninteractive'}
    command = ['apt-get', *(f'-o{option}' for option in APT_OPTIONS), *arguments]
    subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)


def find_python() -> str:
    """Path of a Python 3.12 that can make virtual environments and compile extensions.

    It may be installed without being first on the path, and a program python3.12 may exist (of pyenv) and fail.

    :raises MissingError: there is none and none can be installed.
    """
    pyenv = Path(os.environ.get('PYENV_ROOT', Path.home() / '.pyenv'))
    installed = sorted(map(str, pyenv.glob('versions/3.12*/bin/python3.12')), reverse=True)
    candidates = ['python3.12', *installed, 'python3']
    python = next(filter(None, map(suitable_python, candidates)), None)
    if python is None and may_install():
        apt_install(PYTHON)
        python = suitable_python('/usr/bin/python3.12')
    if python is None:
        raise MissingError(f'missing: Python 3.12 with headers and venv. On Ubuntu 24.04: sudo apt-get install '
                           f'{" ".join(PYTHON)}; elsewhere, for instance: pyenv install 3.12')
    return python


def suitable_python(program: str) -> str | None:
    """Path of a Python if it is 3.12 with venv and headers; of a virtual environment, the Python below it."""
    question = ('import ensurepip, os, sys, sysconfig, venv; '
                'headers = os.path.join(sysconfig.get_path("include"), "Python.h"); '
                'print(os.path.realpath(sys.executable)); '
                'sys.exit(sys.version_info[:2] != (3, 12) or not os.path.exists(headers))')
    if not shutil.which(program):
        return None
    answer = subprocess.run([program, '-c', question], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    return answer.stdout.strip() if answer.returncode == 0 else None


if __name__ == '__main__':
    try:
        install_system_packages()
    except MissingError as missing_tools:  # the tests that need them fail with their own messages
        say(str(missing_tools))
