"""The published machine: the camera leads from tau on, else the microphones."""

from __future__ import annotations

from av_common.track import State
from av_fusion.state_machine import StateMachine


def test_switches_at_tau_as_published():
    """c >= tau: Visual-Active; below: Acoustic-Active; each change carries its reason."""
    machine = StateMachine(0.5)
    for time, confidence, expected in ((1.0, 0.5, State.VISUAL_ACTIVE), (1.1, 0.49, State.ACOUSTIC_ACTIVE),
                                       (1.2, 0.9, State.VISUAL_ACTIVE)):
        machine.on_doa(time, 0.9)
        machine.on_image(time, confidence)
        assert machine.step(time, True) == expected
        assert f'{confidence:.2f}' in machine.reason and machine.changed == time


def test_old_senses_do_not_count():
    """A frozen camera hands over to sound, silence to coasting, no track to none."""
    machine = StateMachine()
    machine.on_image(1.0, 0.9)
    machine.on_doa(1.0, 0.9)
    assert machine.step(1.4, True) == State.VISUAL_ACTIVE
    assert machine.step(1.6, True) == State.ACOUSTIC_ACTIVE
    assert machine.step(2.1, True) == State.COASTING
    assert machine.step(2.2, False) == State.NONE


def test_what_is_too_old_has_no_confidence():
    """Of a camera that has stopped beside another one that has not, too; and when both, and sound, have."""
    machine = StateMachine()
    machine.on_image(1.0, 0.9, 'camera')
    machine.on_image(1.4, 0.2, 'second_camera')
    machine.on_doa(1.0, 0.8)
    for time, sight, sound, expected in ((1.4, 0.9, 0.8, State.VISUAL_ACTIVE), (1.8, 0.2, 0.8, State.ACOUSTIC_ACTIVE),
                                         (2.2, 0.0, 0.0, State.COASTING)):
        assert machine.step(time, True) == expected
        assert (machine.sight_confidence, machine.sound_confidence) == (sight, sound)


def test_a_threshold_of_zero_needs_a_detection_all_the_same():
    """An image that shows nothing has a score of 0: the camera does not lead by it."""
    machine = StateMachine(0.0)
    machine.on_image(1.0, 0.0)
    machine.on_doa(1.0, 0.9)
    assert machine.step(1.1, True) == State.ACOUSTIC_ACTIVE
    machine.on_image(1.2, 0.05)
    assert machine.step(1.2, True) == State.VISUAL_ACTIVE


def test_the_time_of_the_last_change_stays_when_measurements_are_forgotten():
    """After a silence nothing has changed, and no change is later than a clock that was set back."""
    machine = StateMachine()
    machine.on_doa(1.0, 0.9)
    machine.step(1.0, True)
    machine.step(9.0, False)
    machine.restart()
    assert machine.step(20.0, False) == State.NONE and machine.changed == 9.0
    machine.restart()
    assert machine.step(5.0, False) == State.NONE and machine.changed == 5.0
