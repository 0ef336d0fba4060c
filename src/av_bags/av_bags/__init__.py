"""Recording, reading and replaying bags: mcap and sqlite3 files of ROS 2, without middleware."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'converters': 'AudioLayout',
    'definitions': 'BagError UnknownTypeError definition deserialiser serialiser',
    'feed': 'BagRecord Feed',
    'reader': 'Bag',
    'topics': 'KINDS find_topics parse_remappings',
    'writer': 'BagWriter',
})
