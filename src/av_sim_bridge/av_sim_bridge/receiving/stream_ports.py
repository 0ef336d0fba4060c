"""The UDP ports of the bridge's streams."""

from __future__ import annotations

from typing import Any

from av_sim_bridge.receiving.allowed_senders import ipv4

LARGEST_PORT = 65_535


def stream_ports(parameters: Any) -> dict[str, int]:
    """Port of each stream that the bridge receives, by its name.

    Parameters:
        parameters: the generated struct of bridge_node.

    Raises ValueError where two streams, or a stream and the simulator that obeys commands, would share a port of this
    machine, where a port does not exist, and where rig and targets share a number.
    """
    p = parameters
    targets = range(p.target_id, p.target_id + p.targets)
    if p.rig_id in targets:
        raise ValueError(f'rig_id is {p.rig_id}, which is one of the {p.targets} targets from target_id {p.target_id} on')
    ports = {name: getattr(p, f'{name}_port')
             for name in ('audio', 'image', 'depth', 'second_image', 'rig_truth', 'target_truth', 'imu', 'gimbal', 'time_sync')}
    ports |= {f'target_{number}_truth': p.target_truth_port + 2 * index for index, number in enumerate(targets) if index}
    ports = {name: port for name, port in ports.items() if port}
    own = p.control_host == 'localhost' or (p.control_host[:1].isdigit() and ipv4('control_host', p.control_host).is_loopback)
    used: dict[int, str] = {p.control_port: 'control_port'} if own else {}
    for name, port in ports.items():
        parameter = f'{name}_port' if hasattr(p, f'{name}_port') else f'target_truth_port of {name}'
        if port > LARGEST_PORT:
            raise ValueError(f'{parameter} is {port}, expected at most {LARGEST_PORT}')
        if port in used:
            raise ValueError(f'{parameter} is {port}, as is {used[port]}, expected another port for each stream')
        used[port] = parameter
    return ports
