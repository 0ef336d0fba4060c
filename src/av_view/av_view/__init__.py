"""The rig in a browser and in other viewers, and a check of the machine."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'access': 'Access',
    'feed': 'COLUMNS Feed row_of',
    'rig_state': 'RigState',
    'server': 'ViewServer',
})
