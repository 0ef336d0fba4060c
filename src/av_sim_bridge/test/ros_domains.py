"""ROS domains, or whatever else needs UDP ports, which no other program of this machine has or gets."""

from __future__ import annotations

import random
import socket
from collections import deque
from collections.abc import Iterable

# Other test runs do not take what was chosen here before its ports are bound; by the eighth choice they are.
_reserved: deque[socket.socket] = deque(maxlen=8)
# Of docs/tutorials/two_rigs.md: its test takes it as it stands, and a process keeps a domain's first settings of discovery.
TUTORIAL_DOMAIN = 42


def free_domain() -> int:
    """A ROS domain in which no participant of this machine is. Raises OSError when there is none."""
    # Ports of discovery of the first four participants (RTPS 2.3, 9.6.1.1); above 100 the kernel lends them to others.
    ports = {domain: [7410 + 250 * domain + 2 * index for index in range(4)]
             for domain in range(1, 101) if domain != TUTORIAL_DOMAIN}
    return free_choice('domain', ports)


def free_choice(kind: str, ports: dict[int, Iterable[int]]) -> int:
    """A key at random whose UDP ports are free. Raises OSError when there is none.

    Parameters:
        kind: what is chosen, the same word in all test runs
        ports: UDP ports that each choice needs
    """
    for choice in random.SystemRandom().sample(list(ports), len(ports)):
        if _reserve(f'{kind} {choice}') and all(map(_is_free, ports[choice])):
            return choice
    raise OSError(f'no {kind} in {min(ports)}..{max(ports)} whose UDP ports are free')


def _reserve(name: str) -> bool:
    """Bind an abstract Unix address: like ports, it belongs to the network namespace and ends with its process."""
    reservation = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        reservation.bind(f'\0av_test {name}')
    except OSError:
        reservation.close()
        return False
    _reserved.append(reservation)
    return True


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', port))
        except OSError:
            return False
    return True
