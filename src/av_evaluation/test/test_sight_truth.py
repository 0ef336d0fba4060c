"""What the camera saw of a recorded target as the truth for the calibration of the microphones."""

import bag_messages as make
import numpy as np
import pytest

from av_audio.cli import calibrate
from av_evaluation.cli import sight_truth
from av_simulator import find_config

STEP_S = 1.0
ARRAY = str(find_config('arrays/two_microphones'))
AZIMUTHS = np.radians(np.concatenate([np.arange(-33.0, 34.0, 3.0), np.arange(30.0, -34.0, -3.0)]))
UNSEEN = (10.0, 14.0)


def extract(folder):
    """Run the program on the bag of a folder."""
    sight_truth.main([f'{folder}/bag', '--sound', f'{folder}/a.wav', '--truth', f'{folder}/a.csv', '--array', ARRAY])


@pytest.fixture
def recorded(tmp_path):
    """A bag in which the target steps through the picture, and is hidden for some seconds."""
    sound = np.concatenate([make.sound_of(azimuth, STEP_S, seed=k) for k, azimuth in enumerate(AZIMUTHS)])
    with make.bag(tmp_path / 'bag') as write:
        write('/tf_static', make.EPOCH, make.static_frames(make.EPOCH))
        write('/camera/camera_info', make.EPOCH, make.camera_info(make.EPOCH))
        for frame in make.audio_frames(make.EPOCH, sound):
            write('/audio/frames', frame.header.stamp.sec + 1e-9 * frame.header.stamp.nanosec + 0.06, frame)
        for time in np.arange(0.0, STEP_S * len(AZIMUTHS), 0.1):
            hidden = UNSEEN[0] <= time < UNSEEN[1]
            azimuth = None if hidden else AZIMUTHS[int(time / STEP_S + 1e-9)]
            write('/detections', make.EPOCH + time + 0.1, make.detections(make.EPOCH + time, azimuth))
    return tmp_path


def test_azimuths_are_those_that_were_seen(recorded):
    extract(recorded)
    times, azimuths = calibrate.read_truth(recorded / 'a.csv')
    seen = np.isfinite(azimuths)
    assert np.count_nonzero(seen) == 10 * (len(AZIMUTHS) - 4)
    np.testing.assert_allclose(azimuths[seen], AZIMUTHS[(times[seen] / STEP_S + 1e-6).astype(int)], atol=2e-4)
    gap, = times[~seen]
    assert UNSEEN[0] < gap < UNSEEN[1]


@pytest.mark.parametrize('turned_deg', [-40.0, 25.0])
def test_azimuths_are_those_at_microphones_that_are_turned_on_the_body(turned_deg, tmp_path):
    """As the bag tells of their mount: the program is given no description of the rig."""
    frames = make.static_frames(make.EPOCH)
    turn = np.radians(turned_deg)
    turned = frames.transforms[0].transform.rotation
    turned.z, turned.w = np.sin(0.5 * turn), np.cos(0.5 * turn)
    with make.bag(tmp_path / 'bag') as write:
        write('/tf_static', make.EPOCH, frames)
        write('/camera/camera_info', make.EPOCH, make.camera_info(make.EPOCH))
        for frame in make.audio_frames(make.EPOCH, make.sound_of(0.0, STEP_S)):
            write('/audio/frames', make.EPOCH + 2.0, frame)
        for k, azimuth in enumerate(AZIMUTHS[:20]):
            write('/detections', make.EPOCH + 0.1 * k + 0.1, make.detections(make.EPOCH + 0.1 * k, azimuth))
    extract(tmp_path)
    _, azimuths = calibrate.read_truth(tmp_path / 'a.csv')
    np.testing.assert_allclose(azimuths, AZIMUTHS[:20] - turn, atol=2e-4)


def test_the_microphones_are_calibrated_by_sight(recorded, capsys):
    extract(recorded)
    with pytest.raises(SystemExit) as ended:
        calibrate.main([str(recorded / 'a.wav'), '--truth', str(recorded / 'a.csv'), '--array', ARRAY, '--window', '0.25',
                        '--output', str(recorded / 'new.yaml')])
    assert ended.value.code == 4    # the array is as described already: no curve does better at places that were left out
    words = capsys.readouterr().out
    baseline = float(words.split('baseline')[1].split()[0])
    assert baseline == pytest.approx(200.0, rel=0.1) and 'without calibration' in words and not (recorded / 'new.yaml').exists()


def test_a_bag_without_sound_or_target_is_refused(tmp_path):
    with make.bag(tmp_path / 'bag') as write:
        write('/detections', make.EPOCH, make.detections(make.EPOCH, None))
    with pytest.raises(SystemExit, match='no target is seen'):
        extract(tmp_path)


def test_a_sound_that_begins_anew_is_refused(tmp_path):
    """What the microphones heard after a restart would lie over what they had heard before."""
    with make.bag(tmp_path / 'bag') as write:
        write('/detections', make.EPOCH, make.detections(make.EPOCH, 0.1))
        for begin in (make.EPOCH, make.EPOCH + 2.0):
            for k, frame in enumerate(make.audio_frames(begin, make.sound_of(0.1, 1.0))):
                write('/audio/frames', begin + 0.05 * (k + 1), frame)
    with pytest.raises(SystemExit, match='the sound begins anew'):
        extract(tmp_path)
