"""Read a bag: its topics, and the bearing against time. No ROS is needed to read what ROS recorded.

python3 examples/read_bag.py FOLDER BAG      a bag of record:=results/flight.mcap, for instance
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from av_bags import Bag, find_topics

if len(sys.argv) != 3:
    sys.exit(__doc__)
folder, path = Path(sys.argv[1]), Path(sys.argv[2])
folder.mkdir(parents=True, exist_ok=True)
with Bag(path) as bag:
    for name, topic in sorted(bag.topics.items()):
        print(f'{topic.count:7d} messages  {topic.kind:36s} {name}')
    found = find_topics(bag, ['target/bearing'])
    if 'target/bearing' not in found:
        sys.exit(found.missing['target/bearing'])
    name, rows = found.topics['target/bearing'], []
    for topic, time_ns, data in bag.messages([name]):
        bearing = bag.decode(topic, data)
        if bearing.state:
            rows.append((1e-9 * (time_ns - bag.start_ns), np.degrees(bearing.azimuth),
                         np.degrees(np.sqrt(bearing.azimuth_variance)), bearing.state))

time, azimuth, sigma, state = np.array(rows).reshape(-1, 4).T
print(f'a bearing for {100.0 * np.mean(state != 3) if len(state) else 0.0:.0f} % of {len(rows)} messages by a sensor')
figure, axes = plt.subplots(figsize=(6.4, 3.0), layout='constrained')
axes.fill_between(time, azimuth - sigma, azimuth + sigma, alpha=0.3)
for value, name, colour in ((1, 'by sight', 'tab:green'), (2, 'by sound', 'tab:orange'), (3, 'predicted', 'tab:gray')):
    axes.plot(time[state == value], azimuth[state == value], '.', color=colour, label=name)
axes.set(xlabel='time (s)', ylabel='azimuth (deg)')
axes.legend(frameon=False)
figure.savefig(folder / 'read_bag.png', dpi=75)
