"""Tracks as messages and back."""

import pytest
from rclpy.serialization import deserialize_message, serialize_message

from av_common.stamps import to_seconds
from av_common.track import Source, State, Track
from av_common.track_messages import bearing_message, state_message, track_of_bearing

TRACK = Track(1234.25, State.COASTING, 'no image', 1200.5, Source.SOUND | Source.SIGHT, -3.125, 0.25, 0.0078125, 0.015625,
              azimuth_world=1.0, azimuth_world_rate=-0.25, elevation_world=0.375, elevation_world_rate=0.0625,
              covariance_world=(0.25, 0.125, 0.125, 0.5), attitude_known=True, range=12.5, range_variance=4.0, measured=1233.75,
              front_probability=0.25, resolved=True, requested_rotation=-0.75, look=(0.5, -0.25), sound_confidence=0.5,
              sight_confidence=0.25, sound_weight=0.125, sight_weight=0.375, visibility=0.625)
OTHER = TRACK._replace(resolved=False, requested_rotation=0.5, look=None, state=State.VISUAL_ACTIVE)


def through_middleware(message):
    return deserialize_message(serialize_message(message), type(message))


@pytest.mark.parametrize('track', [TRACK, OTHER])
def test_a_bearing_carries_all_that_pointing_needs(track):
    message = through_middleware(bearing_message(track, 'base_link'))
    back = track_of_bearing(message)
    assert message.header.frame_id == 'base_link'
    for name in ('time', 'state', 'source', 'azimuth', 'elevation', 'azimuth_variance', 'elevation_variance', 'azimuth_world',
                 'azimuth_world_rate', 'elevation_world', 'elevation_world_rate', 'covariance_world', 'attitude_known', 'range',
                 'range_variance', 'measured', 'resolved', 'requested_rotation', 'look'):
        assert getattr(back, name) == getattr(track, name), name
    assert message.hemisphere_probability == 0.75


def test_a_track_without_target_has_no_time_of_measurement():
    message = bearing_message(TRACK._replace(state=State.NONE), 'base_link')
    assert to_seconds(message.measured) == 0.0
    assert to_seconds(bearing_message(TRACK._replace(measured=-3.0), 'base_link').measured) == 0.0


def test_values_that_a_newer_sender_may_add_are_understood():
    message = bearing_message(TRACK, 'base_link')
    message.state, message.source = 200, 255
    back = track_of_bearing(message)
    assert back.state == State.COASTING and back.source == Source.SOUND | Source.SIGHT


def test_the_state_names_missing_inputs():
    message = through_middleware(state_message(TRACK._replace(changed=-5.0), ('doa', 'odometry'), 'base_link'))
    assert list(message.missing) == ['doa', 'odometry'] and message.reason == 'no image'
    assert to_seconds(message.changed) == 0.0 and message.front_probability == 0.25
