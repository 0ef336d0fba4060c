"""Reports what a rig or a network of rigs tracks: to a fusion node of SAPIENT, to TAK, to files; without parameters to none."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from sensor_msgs.msg import NavSatFix

from av_common.freshness import Instant
from av_common.node import RigNode, run
from av_common.qos import RESULT, STREAM
from av_interfaces.msg import Bearing, FusionState, TrackArray, WorldTrackArray
from av_reports.cot.connection import CotOutput
from av_reports.identifiers import node_uuid
from av_reports.link import parse_peer
from av_reports.nodes.report_node_parameters import report_node as parameters
from av_reports.nodes.rig_commands import RigCommands
from av_reports.settings import SapientSettings, check_settings, report_settings
from av_reports.stage import ReportStage
from av_reports.track_log import TrackLog

if TYPE_CHECKING:
    from av_reports.sapient.output import SapientOutput

RATE_HZ = 5.0  # at which is looked for what is due, and messages are answered


class ReportNode(RigNode):
    """Runs a `ReportStage` and the outputs that its parameters name."""

    RUNTIME_PARAMETERS: ClassVar[frozenset[str]] = frozenset({'only_drones'})

    def __init__(self) -> None:
        super().__init__('report_node', parameters)

    def configure(self) -> None:
        """Build the stage, and what it needs to ask the rig for something."""
        self._settings = self.settings
        self._stage = ReportStage(report_settings(self._settings))
        self._commands = RigCommands(self, not self._settings.positions, self.now)
        self._outputs: dict[str, SapientOutput | CotOutput | TrackLog] = {}

    def activate(self) -> None:
        """Subscribe, and open the outputs. Raises ImportError for packages that they need, OSError and ValueError for files."""
        stage = self._stage
        for kind, topic, take, quality in (
                (TrackArray, 'targets', lambda m: stage.on_targets(m, self._instant(), self._to_utc()), RESULT),
                (Bearing, 'target/bearing', stage.on_bearing, RESULT), (FusionState, 'fusion/state', stage.on_state, RESULT),
                (NavSatFix, 'fix', lambda m: stage.on_fix(m, self._instant()), STREAM),
                (WorldTrackArray, 'tracks', lambda m: stage.on_network_tracks(m, self._instant(), self._to_utc()), RESULT)):
            self.create_subscription(kind, topic, take, quality)
        try:
            self._open_outputs()
        except Exception:
            self.deactivate()
            raise
        self.create_steady_timer(1.0 / RATE_HZ, self._report)

    def deactivate(self) -> None:
        """Close the outputs."""
        while self._outputs:
            self._outputs.popitem()[1].close()

    @staticmethod
    def check_parameters(settings: Any) -> None:
        """Addresses, types and identifiers must be some."""
        check_settings(settings)

    def apply_parameters(self) -> None:
        """Which targets are reported can be changed at any time."""
        self._stage.settings = report_settings(self.settings)

    def _open_outputs(self) -> None:
        settings, name = self._settings, self.get_fully_qualified_name()
        if settings.sapient.peer:
            from av_reports.sapient.output import SapientOutput  # needs sapient-msg
            node = SapientSettings(settings.sapient.node_id.lower() or node_uuid(name), settings.positions, settings.north,
                                   settings.sapient.obey_tasks)
            self._outputs['sapient'] = SapientOutput(node, parse_peer(settings.sapient.peer), self._commands.perform)
        if settings.cot.url:
            callsign = self.get_namespace().strip('/') or 'rig'
            self._outputs['cot'] = CotOutput(node_uuid(name), callsign, settings.cot)
        if settings.log.folder:
            self._outputs['log'] = TrackLog(Path(settings.log.folder).expanduser())

    def _report(self) -> None:
        situation = self._stage.situation(self._instant(), self._to_utc())
        for name, output in self._outputs.items():
            try:
                output.report(situation)
            except Exception as error:  # noqa: BLE001  one output does not stop the others
                self.refused.refuse(name, error)
        self._commands.repeat()

    def _instant(self) -> Instant:
        return Instant(time.monotonic(), self.now())

    def _to_utc(self) -> float:
        """What is to be added to this node's time for UTC: nothing, unless its time is simulated."""
        return time.time() - self.now()

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Report peers, problems and numbers of each output."""
        status.add('outputs', ', '.join(self._outputs) or 'none: nothing leaves this machine')
        situation = self._stage.situation(self._instant(), self._to_utc())
        status.add('reported targets', str(len(situation.stamped)))
        for name, output in self._outputs.items():
            problem = output.problem()
            if problem:
                status.mergeSummary(DiagnosticStatus.WARN, problem)
            for key, value in output.values().items():
                status.add(f'{name} {key}', str(value))
        for problem in situation.problems if self._outputs else ():
            status.mergeSummary(DiagnosticStatus.WARN, problem)


def main() -> None:
    """Run the node."""
    run(ReportNode)
