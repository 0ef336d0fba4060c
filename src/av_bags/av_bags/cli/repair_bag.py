"""`ros2 run av_bags repair_bag BAG --out OUT.mcap`: copy all readable messages of a bag to a new one."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from av_bags.reader import Bag
from av_bags.topics import FRAMES
from av_bags.writer import DEFAULT_QOS, LATCHED, BagWriter


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code: 0, or 1 when nothing can be read or written."""
    parser = argparse.ArgumentParser(prog='repair_bag', description=f'{__doc__} Converts sqlite3 to mcap, too.')
    parser.add_argument('bag', help='mcap or sqlite3 (.db3), a file or a folder, damaged or not')
    parser.add_argument('--out', required=True, metavar='PATH', help='a .mcap file, or a folder; must not exist')
    options = parser.parse_args(arguments)
    try:
        problems = []
        with Bag(options.bag) as bag, BagWriter(options.out) as out:
            for topic in bag.topics.values():
                try:
                    usual = LATCHED if topic.name.endswith(f'/{FRAMES}') else DEFAULT_QOS
                    out.add_topic(topic.name, topic.kind, next(iter(topic.qos), usual), bag.definition(topic.name))
                except ValueError as error:    # of a type that is defined neither in the bag nor here
                    problems.append(f'{topic.name} is left out: {error}')
            for row in bag.messages(out.counts):
                out.write(*row)
            problems += [*bag.notes, *bag.problems]
    except (ValueError, OSError) as error:
        print(f'repair_bag: {error}', file=sys.stderr)
        return 1
    for problem in problems:
        print(f'  ! {problem}', file=sys.stderr)
    name = options.out.encode(errors='replace').decode()    # that of a file need not be UTF-8
    print(f'{sum(out.counts.values())} messages to {name}')
    return 0
