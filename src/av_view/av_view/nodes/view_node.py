"""Serves the page that shows the rig, and subscribes to a rig while somebody looks at it, or at its markers."""

from __future__ import annotations

import errno
import json
import os
import time
from functools import partial
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_updater import DiagnosticStatusWrapper
from rclpy.qos import QoSProfile
from visualization_msgs.msg import MarkerArray

from av_common.guarded_node import decode
from av_common.launched import restarts, run_folder
from av_common.node import RigNode, run
from av_common.qos import RESULT
from av_common.refused_inputs import BAD_INPUT
from av_view.access import Access, PrivateAddress
from av_view.feed import Feed
from av_view.health import MOST_NODES, Health
from av_view.nodes.rig_control import BagFolder, RigControl
from av_view.nodes.view_node_parameters import view_node as parameters
from av_view.server import ViewServer

if TYPE_CHECKING:
    from av_view.nodes.rig_watch import RigWatch

HEALTH_PERIOD_S = 1.0  # as nodes report to /diagnostics
LINGER_S = 20.0  # until nothing is subscribed any more without a viewer, and between looks at /diagnostics then
RATE_HZ = 10.0  # most pictures and updates a second, which cost 7 % of a core for one viewer
NICENESS = 10  # of this process below those of the rig
DIAGNOSTICS = QoSProfile(depth=MOST_NODES, reliability=RESULT.reliability)
BEARING = '/target/bearing'  # by which a rig is found


class ViewNode(RigNode):
    """Runs a `ViewServer`, and a `RigWatch` for each rig that is looked at."""

    def __init__(self) -> None:
        super().__init__('view_node', parameters)

    def configure(self) -> None:
        """Start with no rig and no viewer."""
        self._settings = settings = self.settings
        kept = PrivateAddress(settings.port).token() if restarts() and settings.port else ''
        self._access = Access(settings.view_control, settings.allowed_hosts, kept)
        self._health = Health()
        self._watches: dict[str, RigWatch] = {}
        self._looked = self._heard = 0.0
        self._marked = False
        self._markers = self.create_publisher(MarkerArray, 'view/markers', RESULT)
        self._own = self.get_namespace().rstrip('/')

    def activate(self) -> None:
        """Serve the page. Raises OSError where the address cannot be bound, or the one with the token not be written."""
        settings = self._settings
        self._control = RigControl(self, BagFolder(settings.bags))
        self.server = ViewServer(settings.bind_address, settings.port, self._access, self._control.act)
        try:
            self.server.start()
        except OSError as error:
            if error.errno == errno.EADDRINUSE and run_folder() is None:
                self.finish()  # started by hand: nobody is served by waiting
            raise OSError(f'{settings.bind_address}, port {settings.port}: {error.strerror}. One page shows all rigs; for a '
                          f'second one: --ros-args -p port:={settings.port + 1}, or port of view_node in params:=') from error
        try:
            self._announce()
        except OSError:
            self.server.stop()    # the next attempt needs its port
            raise
        self._diagnostics = self.create_reader(DiagnosticArray, '/diagnostics', DIAGNOSTICS)
        self.create_steady_timer(1.0 / RATE_HZ, self._update)

    def deactivate(self) -> None:
        """Close all connections."""
        for rig in list(self._watches):
            self._unwatch(rig)
        self.server.stop()
        if self._access.token:
            PrivateAddress(self.server.port).remove()

    def _announce(self) -> None:
        """Say where the page is; with control the address with the token is in a private file. Raises OSError."""
        host = self._settings.bind_address.replace('0.0.0.0', '127.0.0.1')
        address, how = f'http://{f"[{host}]" if ":" in host else host}:{self.server.port}/', 'read-only'
        if self._access.token:
            private = PrivateAddress(self.server.port)
            private.write(f'{address}#{self._access.token}')
            how = f'read-only; the address with control is in {private.file}'
        self.get_logger().info(f'the rig in your browser: {address} ({how})')

    def _update(self) -> None:
        now, watched = time.monotonic(), self.server.watched()
        self._control.work()
        due = now - self._looked >= HEALTH_PERIOD_S
        if watched and (due or None in watched):
            self.server.set_rigs(self._rigs())
        wanted = {rig for rig in watched if rig is not None}
        if due:
            self._looked = now
            self._marked = self._markers.get_subscription_count() > 0
        if self._marked:
            wanted.add(self._own)
        self._watch_wanted(wanted, watched, now)
        own = self._watches.get(self._own)
        if own is not None and self._marked:
            self._markers.publish(own.markers())
        if due and (self._watches or now - self._heard >= LINGER_S):
            self._look(now)

    def _watch_wanted(self, wanted: set[str], watched: set[str | None], now: float) -> None:
        """Update the rigs that somebody looks at, and end those at which nobody has looked for a while.

        Parameters:
            wanted: namespaces of rigs whose state somebody wants.
            watched: namespaces of rigs on the page, which wants pictures, too.
            now (s): the present.
        """
        new = wanted - self._watches.keys()    # by what viewers say, who may say anything
        for rig in new & {self._own, *self._rigs()} if new else ():
            from av_view.nodes.rig_watch import RigWatch  # the page is up before all that this imports

            self._watches[rig] = RigWatch(self, rig, partial(self.server.put, rig=rig))
            self._looked = 0.0
        for rig, watch in list(self._watches.items()):
            watch.seen = now if rig in wanted else watch.seen
            if now - watch.seen > LINGER_S:
                self._unwatch(rig)
            else:
                watch.update(rig in watched)

    def _look(self, now: float) -> None:
        """What is done once a second: find true poses, and report health."""
        self._heard = now
        for data, _ in self._diagnostics.take():
            try:
                self._health.on_diagnostics(decode(DiagnosticArray, data), now)
            except BAD_INPUT as error:
                self.refused.refuse('/diagnostics', error)
        if not self._watches:
            return
        for rig, watch in self._watches.items():
            watch.find_topics()
            offers = self._control.offers(rig)
            if self._settings.view_control:
                self._control.prepare(rig, offers)
            report = {'type': 'health', 'nodes': self._health.report(now, rig), 'offers': offers}
            self.server.put(partial(Feed.put_health, health=json.dumps(report, separators=(',', ':'))), rig)

    def _rigs(self) -> tuple[str, ...]:
        """Namespaces in which a bearing is published or read by others than this node, its own first."""
        rigs = [topic.removesuffix(BEARING) for topic, _ in self.get_topic_names_and_types() if topic.endswith(BEARING)]
        found = [rig for rig in rigs if self.count_publishers(rig + BEARING) + self.count_subscribers(rig + BEARING)
                 > (rig in self._watches)]
        return tuple(sorted(found, key=lambda rig: (rig != self._own, rig)))

    def _unwatch(self, rig: str) -> None:
        self._watches.pop(rig).close()
        self.server.drop(rig)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Report viewers and refused requests."""
        status.add('viewers', str(self.server.viewers))
        status.add('rigs that are looked at', ', '.join(rig or '/' for rig in self._watches))
        status.add('requests refused', str(self.server.refused))


def main() -> None:
    """Run the node, whose threads inherit the priority."""
    os.nice(NICENESS)
    run(ViewNode)
