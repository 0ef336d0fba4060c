"""ros2 run av_evaluation network_hosts: rigs as hosts of their own, over DDS through a network that delays, loses and parts.

Each host is a network namespace with a simulated rig's reports and a network node.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
from collections.abc import Sequence

from av_evaluation import namespaces
from av_evaluation.hosts.pictures import Agreement, agreement, phase, run_of
from av_evaluation.hosts.trial import Trial, TrialResult, TrialSettings
from av_evaluation.network.cases import SQUARE

SETTLED, MOST_MISSED, HEALED_S, MOST_BYTES = 2 / 3, 0.5, 2.0, 5000.0  # share of the beginning not counted; what is asked for
MOST_LATE_S = 0.2  # of the processes, beyond which reports come too late to be used


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; returns 1 where something is not as good as asked, 2 where the machine permits no such network."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    settings = _settings(given)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        if not namespaces.is_inside():
            raise OSError(namespaces.enter('av_evaluation.cli.network_hosts', given))
        result = Trial(settings, lambda text: print(f'network_hosts: {text}', file=sys.stderr, flush=True)).run()
    except (OSError, subprocess.SubprocessError) as error:
        reason = str(getattr(error, 'stderr', '') or error).strip()
        print(f'network_hosts: this machine permits no network namespaces: {reason}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('network_hosts: interrupted', file=sys.stderr)
        return 130
    except RuntimeError as error:
        print(f'network_hosts: {error}', file=sys.stderr)
        return 1
    good = report(settings, result)
    if result.late > MOST_LATE_S:
        print(f'network_hosts: the machine is too slow, processes were {result.late:.2f} s late: try with fewer --rigs',
              file=sys.stderr)
    return 0 if good else 1


def report(settings: TrialSettings, result: TrialResult) -> bool:
    """Print the tables; returns whether all is as asked.

    Parameters:
        settings: of the trial.
        result: what came of it.
    """
    simulation, (begin, end) = settings.simulation, settings.parted
    runs = [run_of(each, simulation) for each in result.pictures]
    phases = {'before': (SETTLED * begin, begin), 'parted': (begin, end), 'healed': (end, simulation.duration)}
    print(f'{settings.rigs} rigs, {settings.drones} drones, {1e3 * settings.delay:.0f} ms late, '
          f'{100 * settings.loss:.0f} % lost, parted for {settings.partition:g} s, '
          f'{"with" if settings.security else "without"} keys')
    print(f'{"drones missed, false, error":<30}' + ''.join(f'{name:>24}' for name in phases))
    seen = True
    for rig, run in zip(simulation.rigs, runs, strict=True):
        found = [phase(run, *each) for each in phases.values()]
        seen &= found[0].missed < MOST_MISSED * settings.drones
        print(f'{rig.name:<30}' + ''.join(f'{each.missed:>10.2f}{each.false:>6.2f}{each.error:>6.2f} m' for each in found))
    together = agreement(runs, begin, end)
    print(f'tracks lost {together.lost}; one picture {together.first:.1f} s after healing, for good {together.healed:.1f} s '
          f'after; until the end they differ for {100.0 * together.apart:.0f} % of the time')
    _print_traffic(result, [rig.name for rig in simulation.rigs])
    return seen and _is_good(together, result)


def _print_traffic(result: TrialResult, names: Sequence[str]) -> None:
    print(f'all nodes known after {result.discovery:.1f} s')
    print(f'{"sent, with all headers":<30}{"discovery":>12}' + ''.join(f'{name:>14}' for name in result.traffic[0].rates))
    for name, each in zip(names, result.traffic, strict=True):
        rates = ''.join(f'{rate / 1e3:>9.2f} kB/s' for rate in each.rates.values())
        print(f'{name:<30}{each.discovery / 1e3:>9.1f} kB{rates}')
    if result.stranger:
        print(f'without keys: {result.stranger.get("itself", 0)} messages heard of itself, {_overheard(result)} of the rigs; '
              f'{result.stranger["listeners"]} listener, itself')


def _overheard(result: TrialResult) -> int:
    return sum(count for name, count in result.stranger.items() if name not in ('itself', 'listeners'))


def _is_good(together: Agreement, result: TrialResult) -> bool:
    small = all(rate < MOST_BYTES for each in result.traffic for rate in each.rates.values())
    unheard = not result.stranger or (_overheard(result) == 0 and result.stranger['listeners'] == 1)
    return together.lost == 0 and together.healed <= HEALED_S and small and unheard


def _settings(arguments: Sequence[str]) -> TrialSettings:
    parser = argparse.ArgumentParser(prog='network_hosts', description=__doc__)
    add = parser.add_argument
    add('--rigs', type=int, default=4, choices=range(2, len(SQUARE) + 1), help='hosts, each a rig with a node (%(default)s)')
    add('--drones', type=int, default=3, choices=range(1, 21), metavar='N', help='which all rigs measure (%(default)s)')
    add('--delay-ms', type=float, default=200.0, help='of every frame (%(default)s)')
    add('--loss', type=float, default=20.0, help='percent of the frames (%(default)s)')
    add('--before', type=float, default=15.0, help='s before the partition (%(default)s)')
    add('--after', type=float, default=15.0, help='s after it (%(default)s)')
    add('--partition', type=float, default=10.0, help='s for which the halves do not hear each other (%(default)s)')
    add('--seed', type=int, default=1, help='of the reports and of what is lost (%(default)s)')
    add('--security', action='store_true', help='with keys of their own (SROS 2), and a stranger without')
    add('--from-start', action='store_true', help='delay and loss begin before the nodes know each other')
    add('--default-dds', action='store_true', help='Cyclone DDS as it comes, instead of as in config/dds/network.xml')
    options = parser.parse_args(arguments)
    if not (0.0 <= options.delay_ms <= 10e3 and 0.0 <= options.loss < 100.0 and
            all(1.0 <= each <= 600.0 for each in (options.before, options.partition, options.after))):
        parser.error('--delay-ms is up to 10000, --loss below 100, --before, --partition and --after from 1 to 600')
    return TrialSettings(options.rigs, options.drones, 1e-3 * options.delay_ms, 0.01 * options.loss, options.before,
                         options.partition, options.after, options.seed, options.security, options.default_dds,
                         options.from_start)


if __name__ == '__main__':
    sys.exit(main())
