"""Tracks as messages and back."""

import pytest
from rclpy.serialization import deserialize_message, serialize_message

from av_common.stamps import to_seconds
from av_common.track import Source, State, Track
from av_common.track_messages import bearing_message, state_message, track_of_bearing

TRACK = Track(1234.25, State.COASTING, 'no image', 1200.5, Source.SOUND | Source.SIGHT, -3.125, 0.25, 0.0078125, 0.015625,
              1.0, -0.25, 1233.75, 0.25, True, -0.75, 0.5, 0.25, 0.125, 0.375, 0.625)


def through_middleware(message):
    return deserialize_message(serialize_message(message), type(message))


@pytest.mark.parametrize('track', [TRACK, TRACK._replace(resolved=False, requested_rotation=0.5, state=State.VISUAL_ACTIVE)])
def test_a_bearing_carries_all_that_pointing_needs(track):
    message = through_middleware(bearing_message(track, 'base_link'))
    back = track_of_bearing(message)
    assert message.header.frame_id == 'base_link'
    for name in ('time', 'state', 'source', 'azimuth', 'elevation', 'azimuth_variance', 'elevation_variance', 'azimuth_world',
                 'azimuth_world_rate', 'measured', 'resolved', 'requested_rotation'):
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
