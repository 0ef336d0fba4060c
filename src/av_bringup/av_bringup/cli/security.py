"""`ros2 run av_bringup security --keystore FOLDER`: make or renew the keys with which the rig's nodes know each other."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from av_bringup.security.keystore import make_keystore
from av_bringup.security.policy import read_policy


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code: 0, or 1 when the keystore cannot be made."""
    shipped = Path(get_package_share_directory('av_bringup')) / 'config' / 'security'
    parser = argparse.ArgumentParser(prog='security', description=__doc__)
    add = parser.add_argument
    add('--keystore', required=True, type=Path, metavar='FOLDER', help='made; one that exists keeps its authorities')
    add('--namespace', default='', help="the rig's namespace; one keystore may hold several rigs")
    add('--policy', type=Path, default=shipped / 'policy.xml', metavar='FILE', help='what each node may do (the shipped one)')
    add('--px4', action='store_true', help="leave PX4's topics, fmu/*, open to its agent, which has no keys")
    add('--governance', type=Path, metavar='FILE', help='how DDS protects topics (a shipped one)')
    add('--days', type=float, default=365.0, help='validity of certificates and permissions (%(default)g)')
    options = parser.parse_args(arguments)
    try:
        enclaves = read_policy(options.policy, options.namespace)
        governance = options.governance or shipped / ('governance_px4.xml' if options.px4 else 'governance.xml')
        make_keystore(options.keystore, enclaves, governance, options.days)
    except (ValueError, OSError) as error:
        print(f'security: {error}', file=sys.stderr)
        return 1
    print(f'{len(enclaves)} enclaves in {options.keystore}, valid for {options.days:g} days')
    rig = f'namespace:={options.namespace} ' if options.namespace else ''
    print(f'ros2 launch av_fusion rig.launch.py {rig}security:={options.keystore}')
    return 0
