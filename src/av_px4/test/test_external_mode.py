"""Registration of the mode that a pilot selects, and what ends it."""

from __future__ import annotations

import pytest

from av_px4.external_mode import API_VERSION, SETTLE_S, ExternalMode, Register, Registration


def registered(time=0.0, mode_id=23):
    """A mode that PX4 took at `time`."""
    mode = ExternalMode(seed=1)
    mode.start(time - SETTLE_S)
    request = mode.step(time, True)
    mode.on_reply(time, request.request_id, 'AV Track', API_VERSION, True, 2, mode_id)
    return mode


class TestExternalMode:
    def test_asks_until_it_is_answered(self):
        mode = ExternalMode()
        mode.start(-SETTLE_S)
        requests = [mode.step(0.1 * k, True) for k in range(50)]
        asked = [request for request in requests if request]
        assert len(asked) == 3 and isinstance(asked[0], Register) and len({request.request_id for request in asked}) == 3

    def test_asks_only_while_px4_is_heard_and_for_a_second_before(self):
        """What is sent into a stall would arrive in a crowd, and each of it be granted."""
        mode = ExternalMode()
        mode.start(0.0)
        assert not any(mode.step(0.1 * k, False) for k in range(100))
        asked = [0.1 * k for k in range(100, 120) if mode.step(0.1 * k, True)]
        assert asked == pytest.approx([9.9 + SETTLE_S])

    def test_is_active_while_px4_asks(self):
        mode = registered()
        for k in range(100):
            assert mode.on_question(0.3 * k, k, True, 1 << 2).registration_id == 2
            assert mode.step(0.3 * k, True) is None and mode.active_mode(0.3 * k) == 23

    def test_silence_ends_it_and_it_asks_again_once_the_old_one_is_ended(self):
        mode = registered()
        mode.on_question(1.0, 0, True)
        mode.on_question(5.5, 1, True)
        assert mode.active_mode(7.0) == 23 and mode.active_mode(7.6) is None
        assert mode.step(7.6, False) is None and mode.registration is None
        steps = {round(0.1 * k, 1): step for k in range(76, 120) if (step := mode.step(0.1 * k, True))}
        assert list(steps) == [8.6, 9.6, 11.6] and steps[8.6] == Registration('AV Track', 2, 23)
        assert isinstance(steps[9.6], Register)

    def test_what_a_former_process_registered_is_ended_first(self):
        mode, former = ExternalMode(), Registration('AV Track', 0, 24)
        mode.start(0.0, former)
        steps = [step for k in range(35) if (step := mode.step(0.1 * k, True))]
        assert steps[0] == former and [type(step) for step in steps[1:]] == [Register]

    def test_what_is_granted_twice_is_ended_once(self):
        """The reply to the first request was late, and PX4 has granted both."""
        mode = ExternalMode(seed=1)
        mode.start(-SETTLE_S)
        first, second = mode.step(0.0, True), mode.step(2.0, True)
        assert mode.on_reply(2.1, first.request_id, 'AV Track', API_VERSION, True, 0, 23)
        assert mode.on_reply(2.2, second.request_id, 'AV Track', API_VERSION, True, 1, 24) is None
        assert [step for k in range(30) if (step := mode.step(2.3 + 0.1 * k, True))] == [Registration('AV Track', 1, 24)]
        assert mode.registration == Registration('AV Track', 0, 23)

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
        mode.start(-SETTLE_S)
        reply = {'request_id': mode.step(0.0, True).request_id, 'name': 'AV Track', 'api_version': 1, 'success': True,
                 'arming_check_id': 0, 'mode_id': 23, **fields}
        assert mode.on_reply(0.0, **reply) is None and problem in mode.problem
        assert mode.active_mode(0.0) is None

    def test_replies_to_others_are_ignored(self):
        mode = ExternalMode(seed=1)
        mode.start(-SETTLE_S)
        number = mode.step(0.0, True).request_id
        assert mode.on_reply(0.0, number + 1, 'AV Track', 1, True, 0, 23) is None
        assert mode.on_reply(0.0, number, 'Other', 1, True, 0, 23) is None
        assert mode.on_question(0.0, 1, True) is None

    def test_a_name_that_does_not_fit_is_refused(self):
        with pytest.raises(ValueError, match='1 to 24 bytes'):
            ExternalMode('a name that is far too long')
