"""Evaluation of the rig: replay, offline runs, metrics, experiments, report and monitor."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'experiments.methods': 'METHODS bearings known_methods',
    'experiments.offline_run': 'OfflineRun',
    'metrics.run_log': 'RunLog Series',
    'replay.replay': 'Replay ReplaySettings',
    'runs.cases': 'Case run_case',
    'runs.evaluation': 'evaluate_run',
})
