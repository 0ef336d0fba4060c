"""Trackers by name: what makes one takes the parameters of fusion_node and the gimbal or None, and gives a `Tracker`."""

from __future__ import annotations

from av_common.methods import Methods

TRACKERS = Methods('av_rig.trackers', {
    'bayes': 'av_fusion.settings:own_tracker',
    'gated': 'av_fusion.gated_tracker:GatedTracker',
})
