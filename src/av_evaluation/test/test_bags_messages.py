import bag_messages as make
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header

from av_common.stamps import to_stamp
from av_common.track import Source, State, Track
from av_evaluation.replay.messages import bearing, state
from av_fusion.nodes.fusion_node import bearing_message, state_message

TRACKS = [
    Track(1234.25),
    Track(1234.25, State.COASTING, '', 1200.5, Source.SOUND | Source.SIGHT, -3.1, 0.2, 0.01, 0.02, 1.0, -0.3, 1233.75, 0.25,
          True, -0.75, 0.5, 0.25, 0.125, 0.375, 0.625),
    Track(1234.25, State.VISUAL_ACTIVE, 'sight confidence 0.70 >= 0.50 \u00b0', -5.0, Source.SIGHT, 0.1, measured=-3.0),
]


def as_rosbags_writes(track, missing, frame):
    """Both messages, by their definitions."""
    header, known = make.header(track.time, frame), track.state != State.NONE and track.measured > 0.0
    target = make.make('av_interfaces/msg/Bearing', header, track.azimuth, track.elevation, track.azimuth_variance,
                       track.elevation_variance, track.azimuth_world, track.azimuth_world_rate, int(track.state),
                       int(track.source), track.hemisphere_probability, make.stamp(track.measured if known else 0.0))
    fusion = make.make('av_interfaces/msg/FusionState', header, int(track.state), track.reason,
                       make.stamp(max(track.changed, 0.0)), track.sound_confidence, track.sight_confidence,
                       track.sound_weight, track.sight_weight, track.visibility, track.front_probability, track.resolved,
                       track.requested_rotation, list(missing))
    return make.cdr(target), make.cdr(fusion)


@pytest.mark.parametrize('frame', ['', 'a', 'ab', 'abc', 'abcd', 'base_link'])
@pytest.mark.parametrize('missing', [[], ['doa'], ['doa', 'detections', 'odometry'], ['x', '']])
def test_tracks_are_packed_as_rosbags_writes_them(frame, missing):
    for track in TRACKS:
        for reason in (track.reason + 'x' * k for k in range(4)):
            told = track._replace(reason=reason)
            packed = bearing(told, told.time, frame), state(told, missing, told.time, frame)
            assert packed == as_rosbags_writes(told, missing, frame)


@pytest.mark.parametrize('track', TRACKS[:2])
def test_tracks_are_packed_as_the_node_says_them(track):
    header, missing = Header(stamp=to_stamp(track.time), frame_id='base_link'), ['odometry']
    for live, packed in ((bearing_message(track, header), bearing(track, track.time, 'base_link')),
                         (state_message(track, header, missing), state(track, missing, track.time, 'base_link'))):
        assert repr(deserialize_message(packed, type(live))) == repr(deserialize_message(serialize_message(live), type(live)))
