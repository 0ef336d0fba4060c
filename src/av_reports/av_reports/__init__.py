"""Tracks for those who act on them: SAPIENT, Cursor on Target, GeoJSON and CSV."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'contacts': 'BearingTrack Follow LookAt Place PositionTrack Stop',
    'stage': 'ReportSettings ReportStage Situation',
    'track_log': 'TrackLog',
})
