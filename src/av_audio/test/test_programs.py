"""The programs as a user calls them, against sound with known delays and a spherical head's formula."""

import csv
import io
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import soundfile
from known_sound import RATE, SQUARE, add_noise, flat, rotors

from av_audio import calibrate as fit
from av_audio.cli import calibrate, localize
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray

ARRAY = 'microphones: [[0, 0.1, 0], [0, -0.1, 0]]\n'
C = speed_of_sound(20.0)


def head_delay(azimuth, radius=0.0875):
    """Woodworth's delay in s of a rigid sphere with ears at its sides, ahead on the left for positive azimuths."""
    angle = np.arcsin(np.sin(azimuth))
    return radius / C * (angle + np.sin(angle))


@pytest.fixture
def array_file(tmp_path):
    path = tmp_path / 'array.yaml'
    path.write_text(ARRAY)
    return path


@pytest.fixture
def from_30_degrees(tmp_path):
    path = tmp_path / 'from_30_degrees.flac'
    sound = flat(np.random.default_rng(1), 2.0, np.array([0.0, 0.1 / C]))
    soundfile.write(path, 0.3 * sound / np.abs(sound).max(), RATE)
    return path


def test_localize_prints_json(from_30_degrees, array_file, capsys):
    localize.main([str(from_30_degrees), '--array', str(array_file), '--hop', '0.5', '--json'])
    records = json.loads(capsys.readouterr().out)
    assert [record['time'] for record in records] == [0.25, 0.75, 1.25, 1.75]
    for record in records:
        assert set(record) == {'time', 'azimuth_deg', 'elevation_deg', 'sigma_deg', 'confidence'}
        assert record['azimuth_deg'] == pytest.approx([30.0, 150.0], abs=0.1)
        assert record['elevation_deg'] == [0.0, 0.0]
        assert 0.0 < record['sigma_deg'] < 0.5
        assert record['confidence'] > 0.99


def test_localize_prints_columns_and_a_table(from_30_degrees, array_file, capsys):
    localize.main([str(from_30_degrees), '--array', str(array_file), '--hop', '0.5', '--csv'])
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert float(rows[2]['azimuth_deg_1']) == pytest.approx(150.0, abs=0.1)
    localize.main([str(from_30_degrees), '--array', str(array_file), '--hop', '0.5'])
    assert '30.0 or 150.0' in capsys.readouterr().out


def test_localize_names_what_does_not_fit(from_30_degrees, array_file, tmp_path):
    with pytest.raises(SystemExit, match='does not exist'):
        localize.main(['missing.wav', '--array', str(array_file)])
    with pytest.raises(SystemExit, match='choose with --channels'):
        localize.main([str(from_30_degrees), '--array', str(array_file), '--channels', '0'])
    with pytest.raises(SystemExit, match='needs a separate channel'):
        localize.main([str(from_30_degrees), '--array', str(array_file), '--channels', '0', '0'])
    with pytest.raises(SystemExit, match=r'lasts 2\.000 s, less than one window of 3 s'):
        localize.main([str(from_30_degrees), '--array', str(array_file), '--window', '3'])
    soundfile.write(tmp_path / 'slow.wav', np.zeros((8000, 2)), 4000)
    with pytest.raises(SystemExit, match='half of the sample rate'):
        localize.main([str(tmp_path / 'slow.wav'), '--array', str(array_file)])
    (tmp_path / 'text.wav').write_text('no sound')
    with pytest.raises(SystemExit, match=r'text\.wav'):
        localize.main([str(tmp_path / 'text.wav'), '--array', str(array_file)])
    soundfile.write(tmp_path / 'nan.wav', np.full((RATE, 2), np.nan), RATE, subtype='FLOAT')
    with pytest.raises(SystemExit, match=r'nan\.wav has no window of 0\.5 s whose samples are all finite'):
        localize.main([str(tmp_path / 'nan.wav'), '--array', str(array_file)])


@pytest.mark.filterwarnings('error')
def test_localize_continues_after_samples_that_are_not_finite(from_30_degrees, array_file, tmp_path, capsys):
    samples, _ = soundfile.read(from_30_degrees)
    samples[30_000:30_010] = np.nan
    soundfile.write(tmp_path / 'broken.wav', samples, RATE, subtype='FLOAT')
    localize.main([str(tmp_path / 'broken.wav'), '--array', str(array_file), '--hop', '0.25', '--json'])
    printed = capsys.readouterr()
    records = json.loads(printed.out)
    assert 'restarted 1 times' in printed.err
    assert all(abs(record['time'] - 30_005 / RATE) > 0.25 for record in records)
    assert records[-1]['time'] > 1.5
    for record in records:
        assert record['azimuth_deg'] == pytest.approx([30.0, 150.0], abs=0.1)


def test_localize_reports_faults_of_the_channels(array_file, tmp_path, capsys):
    mono = np.random.default_rng(3).normal(size=(RATE, 1)) * [0.1, 0.1]
    soundfile.write(tmp_path / 'mono.wav', mono, RATE)
    localize.main([str(tmp_path / 'mono.wav'), '--array', str(array_file), '--json'])
    assert 'channels 0, 1 are identical' in capsys.readouterr().err


@pytest.mark.parametrize('microphones', [[[0.06, 0, 0], [-0.03, 0.05, 0], [-0.03, -0.05, 0]],
                                         [[0.1, 0.1, 0.1], [0.1, -0.1, -0.1], [-0.1, 0.1, -0.1], [-0.1, -0.1, 0.1]]],
                         ids=['triangle', 'tetrahedron'])
def test_localize_leaves_a_dead_channel_out(microphones, tmp_path, capsys):
    """With it no direction is measured. Two microphones hear the angle to their axis: 1.4 deg less at this elevation."""
    array = MicrophoneArray(np.array(microphones, dtype=float))
    array.save(tmp_path / 'array.yaml')
    sound = flat(np.random.default_rng(5), 1.5, -array.positions @ angles_to_direction(0.5, 0.3) / C)
    sound *= 0.3 / np.abs(sound).max()
    sound[:, 0] = 0.0
    soundfile.write(tmp_path / 'sound.wav', sound, RATE)
    localize.main([str(tmp_path / 'sound.wav'), '--array', str(tmp_path / 'array.yaml'), '--json'])
    told = capsys.readouterr()
    assert 'channel 0 is dead' in told.err
    records = json.loads(told.out)
    sure = [record for record in records if record['confidence'] > 0.0]
    assert records[0] not in sure and records[-1] in sure
    for record in sure:
        assert min(abs(azimuth - math.degrees(0.5)) for azimuth in record['azimuth_deg']) < 2.0


def test_what_localize_hears_of_a_channel_that_is_inverted_has_no_confidence(tmp_path, capsys):
    (tmp_path / 'array.yaml').write_text(ARRAY)
    sound = flat(np.random.default_rng(6), 5.0, np.array([0.0, 0.1 / C])) * [1.0, -1.0]
    soundfile.write(tmp_path / 'sound.wav', 0.3 * sound / np.abs(sound).max(), RATE)
    localize.main([str(tmp_path / 'sound.wav'), '--array', str(tmp_path / 'array.yaml'), '--json'])
    told = capsys.readouterr()
    assert 'is inverted' in told.err
    assert [record['confidence'] for record in json.loads(told.out)][-5:] == [0.0] * 5


def test_localize_gives_a_plane_of_microphones_one_direction(tmp_path, capsys):
    array_path = tmp_path / 'square.yaml'
    SQUARE.save(array_path)
    direction = angles_to_direction(np.radians(120.0), np.radians(20.0))
    sound = flat(np.random.default_rng(4), 1.0, -SQUARE.positions @ direction / C)
    soundfile.write(tmp_path / 'square.wav', 0.3 * sound / np.abs(sound).max(), RATE)
    localize.main([str(tmp_path / 'square.wav'), '--array', str(array_path), '--json'])
    for record in json.loads(capsys.readouterr().out):
        assert record['azimuth_deg'] == pytest.approx([120.0], abs=0.1)
        assert record['elevation_deg'] == pytest.approx([20.0], abs=0.3)


def test_calibrate_learns_a_head(tmp_path, array_file, capsys):
    rng = np.random.default_rng(2)
    offset = np.radians(3.0)  # the ears' axis is turned
    azimuths = np.arange(-180.0, 180.0, 10.0)
    pieces, rows = [], []
    for k, azimuth in enumerate(azimuths):
        piece = flat(rng, 1.0, np.array([0.0, head_delay(np.radians(azimuth) - offset)]))
        pieces.append(piece / np.abs(piece).max())
        rows += [(k, azimuth), (k + 0.999, azimuth)]
    soundfile.write(tmp_path / 'head.wav', 0.5 * np.concatenate(pieces), RATE)
    truth = tmp_path / 'truth.csv'
    truth.write_text('time,azimuth_deg\n' + ''.join(f'{time},{azimuth}\n' for time, azimuth in rows))
    calibrate.main([str(tmp_path / 'head.wav'), '--array', str(array_file), '--truth', str(truth), '--window', '0.5',
                    '--hop', '1', '--output', str(tmp_path / 'head.yaml')])
    assert 'axis offset   +3.' in capsys.readouterr().out
    array = MicrophoneArray.load(tmp_path / 'head.yaml')
    for azimuth in (-65.0, -15.0, 25.0, 75.0):
        true_delay = head_delay(np.radians(azimuth) - offset)
        direction = np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), 0.0])
        assert array.delays(direction, C)[0, 0] == pytest.approx(true_delay, abs=6e-6)


def test_calibration_refuses_too_little():
    pair = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])
    azimuths = np.radians(np.linspace(-20.0, 20.0, 50))
    with pytest.raises(ValueError, match=r'span 0\.7 of the 2\.0'):
        fit(pair, azimuths, 0.2 * np.sin(azimuths))


@pytest.mark.parametrize('rate', [8000, 8500, 11_025])
def test_the_default_band_suits_a_telephone_rate(array_file, tmp_path, capsys, rate):
    """Its upper edge is half of 8 kHz: what converters pass below it is used."""
    rng, count = np.random.default_rng(1), 2 * rate
    turn = np.exp(-1j * np.pi * np.fft.rfftfreq(count, 1.0 / rate) * 0.2 / 343.2 * math.sin(math.radians(-50.0)))
    spectrum = np.fft.rfft(rng.normal(size=count))
    sound = np.stack([np.fft.irfft(spectrum / turn, count), np.fft.irfft(spectrum * turn, count)], axis=1)
    soundfile.write(tmp_path / 'slow.wav', 0.1 * sound + 0.01 * rng.normal(size=sound.shape), rate)
    localize.main([str(tmp_path / 'slow.wav'), '--array', str(array_file), '--json'])
    for row in json.loads(capsys.readouterr().out):
        assert min(abs(azimuth + 50.0) for azimuth in row['azimuth_deg']) < 1.0 and row['confidence'] > 0.9


@pytest.mark.parametrize(('scale', 'words'), [(1000.0, 'these look like millimetres'), (100.0, 'these look like centimetres'),
                                              (0.1, 'may be too small by 10'), (0.01, 'may be too small by 100')])
def test_an_array_in_other_units_is_refused(tmp_path, scale, words):
    """By what no array can be, and by delays that no array of the stated size can have: rotors from 60 degrees at 0.2 m."""
    rng = np.random.default_rng(6)
    sound = rotors(rng, 3.0, np.array([0.0, 0.2 * math.sin(math.radians(60.0)) / C]))
    soundfile.write(tmp_path / 'sound.wav', add_noise(rng, sound, 15.0), RATE)
    (tmp_path / 'array.yaml').write_text(f'microphones: [[0, {0.1 * scale}, 0], [0, {-0.1 * scale}, 0]]')
    with pytest.raises(SystemExit, match=words):
        localize.main([str(tmp_path / 'sound.wav'), '--array', str(tmp_path / 'array.yaml')])


@pytest.mark.parametrize(('spacing', 'azimuth_deg', 'snr_db'), [
    (0.2, 90.0, 10.0), (0.2, -5.0, 0.0), (0.06, 90.0, 5.0), (0.9, 70.0, 10.0)])
def test_an_array_in_metres_is_not_refused(tmp_path, capsys, spacing, azimuth_deg, snr_db):
    rng = np.random.default_rng(7)
    sound = rotors(rng, 3.0, np.array([0.0, spacing * math.sin(math.radians(azimuth_deg)) / C]))
    soundfile.write(tmp_path / 'sound.wav', add_noise(rng, sound, snr_db), RATE)
    (tmp_path / 'array.yaml').write_text(f'microphones: [[0, {spacing / 2}, 0], [0, {-spacing / 2}, 0]]')
    localize.main([str(tmp_path / 'sound.wav'), '--array', str(tmp_path / 'array.yaml')])
    assert 'centimetres' not in capsys.readouterr().err


ARRAYS = {'a pair': [[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]],
          'a square': [[0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, -0.1, 0.0], [-0.1, 0.1, 0.0]],
          'in space': [[0.1, 0.0, 0.0], [-0.05, 0.09, 0.0], [-0.05, -0.09, 0.0], [0.0, 0.0, 0.12]]}


def told_of(tmp_path, capsys, sound, positions):
    """What localize says on standard error, or by its end, of a sound (n, m) at positions (m, 3)."""
    soundfile.write(tmp_path / 'sound.wav', sound, RATE, 'FLOAT')
    MicrophoneArray(positions).save(tmp_path / 'array.yaml')
    ended = ''
    try:
        localize.main([str(tmp_path / 'sound.wav'), '--array', str(tmp_path / 'array.yaml'), '--hop', '1'])
    except SystemExit as error:
        ended = str(error)
    return capsys.readouterr().err + ended


@pytest.mark.parametrize('azimuth_deg', [20.0, -70.0])
@pytest.mark.parametrize(('name', 'scale', 'words'), [
    ('a square', 0.1, 'may be too small by 10$'), ('in space', 0.1, 'may be too small by 10$'),
    ('in space', 10.0, 'these, .* m apart, are too large by 10$'), ('a pair', 10.0, 'broadside of microphones 2 m apart'),
    ('a square', 10.0, 'straight up from microphones 2.83 m apart'), ('a square', 1.0, ''), ('in space', 1.0, '')])
def test_positions_ten_times_too_small_or_large_are_told(tmp_path, capsys, name, scale, words, azimuth_deg):
    """Refused where no direction explains the delays, doubted where ahead or above would."""
    positions, elevation = np.array(ARRAYS[name]), math.radians(10.0)
    azimuth = math.radians(azimuth_deg)
    towards = [math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)]
    rng = np.random.default_rng(9)
    sound = rotors(rng, 2.0, (positions.max() - positions @ towards) / C)
    told = told_of(tmp_path, capsys, add_noise(rng, sound, 10.0), scale * positions)
    assert re.search(words, told, re.MULTILINE) if words else not told


def test_copies_of_one_channel_say_nothing_about_positions(tmp_path, capsys):
    """Sound without any delay crosses no array; what is wrong is said as a fault of the channels."""
    one = 0.05 * rotors(np.random.default_rng(9), 2.0, np.zeros(1))
    told = told_of(tmp_path, capsys, np.repeat(one, 4, axis=1), np.array(ARRAYS['in space']))
    assert 'are identical' in told and 'positions' not in told


def test_a_small_array_in_centimetres_is_doubted(tmp_path, capsys):
    """3 cm as 3 m: an array that might be, but all sound would come from ahead."""
    rng = np.random.default_rng(8)
    sound = flat(rng, 3.0, np.array([0.0, 0.03 * math.sin(math.radians(60.0)) / C]))
    soundfile.write(tmp_path / 'sound.wav', add_noise(rng, sound, 20.0), RATE)
    (tmp_path / 'array.yaml').write_text('microphones: [[0, 1.5, 0], [0, -1.5, 0]]')
    localize.main([str(tmp_path / 'sound.wav'), '--array', str(tmp_path / 'array.yaml')])
    assert 'are the positions in centimetres' in capsys.readouterr().err


TABLES = {
    'a byte order mark': '\ufefftime,azimuth_deg\n0,10\n1.5,\n2,-20.5\n',
    'semicolons': 'time;azimuth_deg\n0;10\n1,5;\n2;-20,5\n',
    'tabs': 'time\tazimuth_deg\n0\t10\n1.5\t\n2\t-20.5\n',
    'carriage returns': 'time,azimuth_deg\r\n0,10\r\n1.5,\r\n\r\n2,-20.5\r\n',
    'an old Macintosh': 'time,azimuth_deg\r0,10\r1.5,\r2,-20.5\r',
    'spaces': ' Time , Azimuth_deg \n 0 , 10\n1.5 , \n 2, -20.5 \n',
    'quotes and more columns': '"note","azimuth_deg","time"\n"left, far","10","0"\n"","","1.5"\nx,-20.5,2\n,,\n',
    'a spreadsheet': 'sep=;\n"time";"azimuth_deg"\n0;10\n1,5;\n2;-20,5\n;\n'}


@pytest.mark.parametrize('name', TABLES)
@pytest.mark.parametrize('encoding', ['utf-8', 'utf-16'])
def test_truth_is_read_as_programs_write_it(tmp_path, name, encoding):
    (tmp_path / 'truth.csv').write_bytes(TABLES[name].lstrip('\ufeff' if encoding == 'utf-16' else '').encode(encoding))
    times, azimuths = calibrate.read_truth(tmp_path / 'truth.csv')
    assert times.tolist() == [0.0, 1.5, 2.0]
    np.testing.assert_allclose(np.degrees(azimuths), [10.0, np.nan, -20.5])


@pytest.mark.parametrize(('text', 'words'), [
    ('time,azimuth\n0,10\n', "first line is 'time,azimuth', expected the columns time and azimuth_deg"),
    ('', 'expected the columns'),
    ('time,azimuth_deg\n0,10\n1,north\n', "line 3: '1,north', expected numbers"), ('time,azimuth_deg\n', 'has no rows'),
    ('time,azimuth_deg\n0,0,10,5\n', "line 2: '0,0,10,5' has more fields"),    # commas that are both
    ('x' * 200_000, "first line is 'x+.*expected the columns"),
    (f'time,azimuth_deg\n1,"{"x" * 200_000}\n', "line 2: .* expected numbers"),
    ('time,azimuth_deg\n,10\n', "line 2: ',10', expected numbers"), ('time,azimuth_deg\n1,1\n0,2\n', 'time 0 follows 1')])
def test_what_is_no_truth_is_said_by_line(tmp_path, text, words):
    (tmp_path / 'truth.csv').write_text(text)
    with pytest.raises(ValueError, match=words) as error:
        calibrate.read_truth(tmp_path / 'truth.csv')
    assert str(tmp_path / 'truth.csv') in str(error.value)


def test_the_tables_of_the_field():
    folder = Path(__file__).resolve().parents[4] / 'shared/data/field_cases'
    if not folder.is_dir():
        pytest.skip('needs ../shared/data/field_cases')
    marked, plain = (calibrate.read_truth(folder / 'tables' / name) for name in ('bom.csv', 'plain.csv'))
    np.testing.assert_array_equal(marked, plain)
    with pytest.raises(SystemExit, match=r'arr_mm\.yaml: .* these look like millimetres'):
        localize.main([str(folder / 'sound/plain16.wav'), '--array', str(folder / 'tables/arr_mm.yaml')])
