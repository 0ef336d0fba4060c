"""Registration of the mode that a pilot selects, and what ends it; topics by version."""

from __future__ import annotations

import pytest

from av_px4.external_mode import API_VERSION, ExternalMode, Register
from av_px4.topics import VersionError, check_version, find_topic


def registered(time=0.0, mode_id=23):
    """A mode that PX4 took at `time`."""
    mode = ExternalMode(seed=1)
    request = mode.step(time)
    mode.on_reply(time, request.request_id, 'AV Track', API_VERSION, True, 2, mode_id)
    return mode


class TestExternalMode:
    def test_asks_until_it_is_answered(self):
        mode = ExternalMode()
        requests = [mode.step(0.1 * k) for k in range(50)]
        asked = [request for request in requests if request]
        assert len(asked) == 3 and isinstance(asked[0], Register) and len({request.request_id for request in asked}) == 3

    def test_is_active_while_px4_asks(self):
        mode = registered()
        for k in range(100):
            assert mode.on_question(0.3 * k, k, True, 1 << 2).registration_id == 2
            assert mode.step(0.3 * k) is None and mode.active_mode(0.3 * k) == 23

    def test_silence_ends_it_and_it_asks_again(self):
        mode = registered()
        mode.on_question(1.0, 0, True)
        mode.on_question(5.5, 1, True)
        assert mode.active_mode(7.0) == 23 and mode.active_mode(7.6) is None
        assert isinstance(mode.step(7.6), Register) and mode.registration is None

    def test_px4_started_anew_and_no_longer_counts_it(self):
        mode = registered()
        for k in range(40):
            answer = mode.on_question(0.3 * k, k, True, 0)
        assert answer is not None                      # it still answers, in case that it was only slow
        assert mode.active_mode(12.0) is None

    @pytest.mark.parametrize(('fields', 'problem'), [
        ({'success': False}, 'refused'), ({'api_version': 2}, 'version 2'), ({'mode_id': 5}, 'mode 5'),
        ({'mode_id': -1}, 'mode -1'), ({'mode_id': 14}, 'mode 14')])
    def test_what_is_no_mode_of_ours_is_refused(self, fields, problem):
        mode = ExternalMode()
        reply = {'request_id': mode.step(0.0).request_id, 'name': 'AV Track', 'api_version': 1, 'success': True,
                 'arming_check_id': 0, 'mode_id': 23, **fields}
        assert mode.on_reply(0.0, **reply) is None and problem in mode.problem
        assert mode.active_mode(0.0) is None

    def test_replies_to_others_are_ignored(self):
        mode = ExternalMode(seed=1)
        number = mode.step(0.0).request_id
        assert mode.on_reply(0.0, number + 1, 'AV Track', 1, True, 0, 23) is None
        assert mode.on_reply(0.0, number, 'Other', 1, True, 0, 23) is None
        assert mode.on_question(0.0, 1, True) is None

    def test_a_name_that_does_not_fit_is_refused(self):
        with pytest.raises(ValueError, match='1 to 24 bytes'):
            ExternalMode('a name that is far too long')


class TestTopics:
    NAMES = ('/fmu/out/vehicle_status_v1', '/fmu/out/vehicle_status_v1_extra', '/fmu/out/vehicle_status_flags',
             '/fmu/out/vehicle_attitude', '/fmu/out/vehicle_command_ack', '/fmu/out/vehicle_command_ack_v1')

    @pytest.mark.parametrize(('base', 'found'), [
        ('/fmu/out/vehicle_status', '/fmu/out/vehicle_status_v1'), ('/fmu/out/vehicle_attitude', '/fmu/out/vehicle_attitude'),
        ('/fmu/out/vehicle_command_ack', '/fmu/out/vehicle_command_ack_v1'), ('/fmu/out/vehicle', None)])
    def test_with_and_without_a_suffix(self, base, found):
        assert find_topic(base, self.NAMES) == found

    def test_a_version_that_would_be_misread_is_named(self):
        new, old = type('VehicleStatus', (), {'MESSAGE_VERSION': 4}), type('VehicleStatus', (), {})
        check_version('/fmu/out/vehicle_status_v4', new)
        check_version('/fmu/out/vehicle_status', old)
        with pytest.raises(VersionError, match='version 1 of VehicleStatus, the installed px4_msgs has version 4'):
            check_version('/fmu/out/vehicle_status_v1', new)
        with pytest.raises(VersionError, match='version 0'):
            check_version('/fmu/out/vehicle_status', new)
