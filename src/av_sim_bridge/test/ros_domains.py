"""ROS domains, or whatever else needs UDP ports, which no other program of this machine has or gets."""

from __future__ import annotations

import random
import socket
from collections import deque
from collections.abc import Iterable, Mapping

# Other test runs do not take what was chosen here before its ports are bound; by the eighth choice they are.
_reserved: deque[list[socket.socket]] = deque(maxlen=8)
# Of docs/tutorials/two_rigs.md: its test takes it as it stands, and a process keeps a domain's first settings of discovery.
TUTORIAL_DOMAIN = 42


def free_domain() -> int:
    """A ROS domain in which no participant of this machine is. Raises OSError when there is none."""
    # Above 100 the kernel lends the ports to others.
    return free_choice('domain', {domain: discovery_ports(domain) for domain in range(1, 101) if domain != TUTORIAL_DOMAIN})


def discovery_ports(domain: int) -> list[int]:
    """Of the first four participants of a domain (RTPS 2.3, 9.6.1.1)."""
    return [7410 + 250 * domain + 2 * index for index in range(4)]


def asked_from(port: int) -> int | None:
    """The domain whose participants look for others at a port, at up to 120 (config/dds/local.xml); None for none."""
    domain, place = divmod(port - 7410, 250)
    return domain if domain >= 0 and place < 240 and place % 2 == 0 else None


def free_choice(kind: str, ports: Mapping[int, Iterable[int]], domains: Mapping[int, set[int]] | None = None) -> int:
    """A key at random whose UDP ports are free. Raises OSError when there is none.

    Parameters:
        kind: what is chosen, the same word in all test runs.
        ports: UDP ports that each choice needs.
        domains: in which there may be no participants beside each choice.
    """
    for choice in random.SystemRandom().sample(list(ports), len(ports)):
        beside = domains[choice] if domains else set()
        needed = [*ports[choice], *(port for domain in beside for port in discovery_ports(domain))]
        if (TUTORIAL_DOMAIN not in beside and _reserve([f'{kind} {choice}', *(f'domain {domain}' for domain in beside)])
                and all(map(_is_free, needed))):
            return choice
    raise OSError(f'no {kind} in {min(ports)}..{max(ports)} whose UDP ports are free')


def _reserve(names: list[str]) -> bool:
    """Bind abstract Unix addresses: like ports, they belong to the network namespace and end with their process."""
    reservations = [socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in names]
    try:
        for reservation, name in zip(reservations, names, strict=True):
            reservation.bind(f'\0av_test {name}')
    except OSError:
        for reservation in reservations:
            reservation.close()
        return False
    _reserved.append(reservations)
    return True


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', port))
        except OSError:
            return False
    return True
