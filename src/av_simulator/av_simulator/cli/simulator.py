"""`ros2 run av_simulator simulator SCENARIO`: simulate a scenario in real time and send RFlySim's datagrams."""

from __future__ import annotations

import argparse
import logging
import signal
import sys

from av_common.arguments import not_negative, positive
from av_common.launched import report_started
from av_sim_bridge.wire.ports import Ports
from av_simulator.cli.arguments import finite, parser_of, port_offset, world_of
from av_simulator.simulator import Simulator, WireOptions


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = parser_of('simulator', __doc__)
    parser.add_argument('--host', default='127.0.0.1', help='receiver of the datagrams (default: %(default)s)')
    parser.add_argument('--bind-address', default='', metavar='ADDRESS',
                        help='address of this machine from which is sent (default: that by which the receiver is reached)')
    parser.add_argument('--allowed-senders', nargs='+', default=(), metavar='SENDER',
                        help='addresses or networks, with or without a port, whose commands turn the rig (default: the bridge '
                             'at the receiver, which sends them from the port of the true state)')
    parser.add_argument('--port-offset', type=port_offset, default=0, help='added to every port, for a second rig')
    parser.add_argument('--duration', type=positive, help="duration in seconds (default: the scenario's; inf: until stopped)")
    parser.add_argument('--audio-header', action='store_true',
                        help='send audio datagrams with number and time; RFlySim does not')
    parser.add_argument('--depth', action='store_true', help='also send depth images, as the next image sensor')
    parser.add_argument('--renderer', choices=['auto', 'scene', 'flat'], default='auto',
                        help='scene: 3D scene; flat: flat shapes, cheaper; auto: scene if OpenGL is available')
    parser.add_argument('--begin', type=not_negative, help='Unix time of the start, so that several rigs share one world; one '
                        'in the past is joined at the present')
    parser.add_argument('--at', type=finite, nargs=4, metavar=('X', 'Y', 'Z', 'YAW_DEG'),
                        help="position (m) and yaw of this rig, instead of the scenario's")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Run until the end of the duration or a signal. Returns the exit code: 0, 1 without images, 2 for a bad scenario."""
    logging.basicConfig(level=logging.INFO, format='[%(name)s] %(message)s', stream=sys.stderr)
    log = logging.getLogger('simulator')
    options = parse(arguments)
    try:
        world = world_of(options, options.at)
        simulator = Simulator(world, WireOptions(
            host=options.host, bind_address=options.bind_address, allowed_senders=tuple(options.allowed_senders),
            ports=Ports().shifted(options.port_offset), audio_header=options.audio_header, image_rate=options.image_rate,
            renderer=options.renderer, depth=options.depth))
    except (ValueError, OSError) as error:
        log.error('%s', error)
        return 2
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: simulator.stop())
    report_started()
    log.info('%s: %s', world.scenario.name, world.scenario.description)
    try:
        simulator.run(world.scenario.duration if options.duration is None else options.duration, options.begin)
    except ValueError as error:
        log.error('%s', error)
        return 2
    except (RuntimeError, TimeoutError) as error:    # from the renderer
        log.error('%s', error)
        return 1
    finally:
        simulator.close()
    counts = [f'{count} {name.replace("_", " ")}' for name, count in simulator.counts.items() if count]
    log.info('%.1f s simulated; %.1f images a second; %s', world.time, simulator.counts['images'] / max(world.time, 1e-9),
             ', '.join(counts))
    return 0


if __name__ == '__main__':
    sys.exit(main())
