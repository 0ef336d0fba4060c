"""What launch files are made of: arguments, processes that are started again, keys of SROS 2; installs the configuration."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'launching': 'Arguments describe rig_node',
    'supervision': 'Supervision',
})
