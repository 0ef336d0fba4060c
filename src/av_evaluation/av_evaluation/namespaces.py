"""A network of its own for a program, and other hosts in it (Linux)."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

INSIDE = 'AV_NETWORK_NAMESPACE'
INTERFACE = 'eth0'  # of another host
LOOPBACK = (('ip', 'link', 'set', 'lo', 'up', 'multicast', 'on'), ('ip', 'route', 'add', '224.0.0.0/4', 'dev', 'lo'))


def is_inside() -> bool:
    """Whether this process runs in a network namespace that `enter` made."""
    return os.environ.get(INSIDE) == '1'


def enter(module: str, arguments: Sequence[str]) -> str:
    """Start this program again in a network namespace; returns only where that is not possible, with the reason.

    Parameters:
        module: the program, as for `python -m`.
        arguments: of the program.
    """
    reason = 'not permitted'
    script = ' && '.join(' '.join(command) for command in LOOPBACK)
    for unshare in (['unshare', '--net'], ['unshare', '--net', '--map-root-user']):
        try:
            made = subprocess.run([*unshare, 'sh', '-c', script], capture_output=True, text=True, timeout=20.0, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            return str(error)
        if made.returncode == 0:
            os.environ[INSIDE] = '1'
            os.execvp(unshare[0], [*unshare, sys.executable, '-m', module, *arguments])
        reason = made.stderr.strip().rpartition('\n')[2] or reason
    return reason


def prepare_loopback() -> None:
    """Let the loopback interface carry unicast and multicast. Raises CalledProcessError."""
    for command in LOOPBACK:
        subprocess.run(command, check=True, timeout=20.0)


class Host:
    """A network namespace at the other end of a cable: packets from it come from another host.

    Attributes:
        prefix: words of a command that runs a program there.

    Parameters:
        link: name of this end of the cable.
        address: of the host, with the length of its network's prefix.
        here: address of this end; empty for none.

    Raises OSError or subprocess.SubprocessError where that is not permitted.
    """

    def __init__(self, link: str, address: str, here: str = '') -> None:
        self._holder = subprocess.Popen(['unshare', '--net', 'sleep', 'infinity'])
        holder = str(self._holder.pid)
        self.prefix = ['nsenter', '--target', holder, '--net']
        there = [*self.prefix, 'ip']
        commands = [['ip', 'link', 'add', link, 'type', 'veth', 'peer', 'name', INTERFACE, 'netns', holder],
                    *([['ip', 'addr', 'add', here, 'dev', link]] if here else []),
                    ['ip', 'link', 'set', link, 'addrgenmode', 'none', 'up'],    # no traffic of IPv6
                    [*there, 'link', 'set', 'lo', 'up'], [*there, 'addr', 'add', address, 'dev', INTERFACE],
                    [*there, 'link', 'set', INTERFACE, 'addrgenmode', 'none', 'up'],
                    [*there, 'route', 'add', '224.0.0.0/4', 'dev', INTERFACE]]
        try:
            _wait_until_apart(self._holder.pid)
            for command in commands:
                subprocess.run(command, check=True, timeout=20.0, capture_output=True, text=True)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Remove it."""
        self._holder.kill()
        self._holder.wait(10.0)


def _wait_until_apart(process_id: int) -> None:
    """Wait until a process has left the network namespace of this one. Raises TimeoutError."""
    for _ in range(500):
        if Path(f'/proc/{process_id}/ns/net').readlink() != Path('/proc/self/ns/net').readlink():
            return
        time.sleep(0.01)
    raise TimeoutError('unshare made no network namespace')
