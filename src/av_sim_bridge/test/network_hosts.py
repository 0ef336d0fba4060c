"""Two hosts in one network, as network namespaces of two threads of the test: what they open belongs to their host."""

from __future__ import annotations

import contextlib
import ctypes
import os
import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

_CLONE_NEWNET = 0x4000_0000
RIG, OTHER, STRANGER = '10.77.0.1', '10.77.0.2', '10.77.0.3'    # the stranger is a second address of the other host


class Host:
    """One host; `run` calls a function there. Sockets and programs that it opens stay there."""

    def __init__(self):
        self._threads = ThreadPoolExecutor(1)
        self.thread = self._threads.submit(threading.get_native_id).result()
        if error := self._threads.submit(_unshare).result():
            raise OSError(error, os.strerror(error))
        self.ip('link', 'set', 'lo', 'up')

    def run(self, function, *arguments):
        return self._threads.submit(function, *arguments).result(120.0)

    def ip(self, *arguments):
        self.run(lambda: subprocess.run(['ip', *arguments], check=True, capture_output=True))

    def close(self):
        self._threads.shutdown()


def _unshare() -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    return ctypes.get_errno() if libc.unshare(_CLONE_NEWNET) else 0


@contextlib.contextmanager
def two_hosts() -> Iterator[tuple[Host, Host]]:
    """The rig's host with the address RIG, and one with the addresses OTHER and STRANGER; skips where that is not allowed."""
    hosts = []
    try:
        try:
            hosts += [Host()]
            hosts += [Host()]
            rig, other = hosts
            rig.ip('link', 'add', 'near', 'type', 'veth', 'peer', 'name', 'far', 'netns', str(other.thread))
            for host, link, addresses in ((rig, 'near', [RIG]), (other, 'far', [OTHER, STRANGER])):
                for address in addresses:
                    host.ip('address', 'add', f'{address}/24', 'dev', link)
                host.ip('link', 'set', link, 'up')
                host.ip('route', 'add', 'default', 'dev', link)
        except (OSError, subprocess.CalledProcessError) as error:
            pytest.skip(f'no network namespaces for this user: {error}')
        yield rig, other
    finally:
        for host in hosts:
            host.close()
