"""Ground, walls, rooms and obstacles against exact integrals, another library and the formulas they come from."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.signal import firwin

from av_simulator.sound import (
    Box,
    FormulaSignal,
    Ground,
    Medium,
    Noise,
    Room,
    SoundWorld,
    Source,
    Surroundings,
    ToneSignal,
    Trunk,
)
from av_simulator.sound.ground import FLOW_RESISTIVITY, miki_impedance
from av_simulator.sound.obstacles import detours
from av_simulator.sound.rays import edge_loss_db, occlusion

RATE = 16000
C = Medium().speed_of_sound
FREQUENCIES = np.array([125.0, 500.0, 2000.0, 8000.0])


def at(place):
    return lambda times: np.broadcast_to(np.asarray(place, float), (len(times), 3))


def pulse_signal(low=100.0, high=7000.0):
    """A band-limited pulse 0.1 s after time 0."""
    shape = firwin(255, [low, high], pass_zero=False, fs=RATE)
    return FormulaSignal(lambda t: np.interp(t - 0.1, (np.arange(255) - 127) / RATE, shape, left=0.0, right=0.0))


def hear(source, microphones, signal, seconds, surroundings=None):
    world = SoundWorld(RATE, [Source(at(source), signal)], microphones=len(microphones), noise=Noise(None),
                       surroundings=surroundings)
    return world.render(int(seconds * RATE), np.array([microphones, microphones], float))


@pytest.mark.parametrize('surface', ['forest', 'grass', 'gravel'])
@pytest.mark.parametrize('source_z, receiver_z, distance', [(10.0, 1.5, 20.0), (2.0, 1.5, 30.0), (30.0, 2.0, 100.0)])
def test_ground_reflection_is_the_exact_integral(surface, source_z, receiver_z, distance):
    """Di and Gilbert, An exact Laplace transform formulation for a point source above a ground surface, JASA 93 (1993)."""
    height = source_z + receiver_z
    path = np.hypot(distance, height)
    for frequency in (150.0, 600.0, 2500.0):
        k, admittance = 2 * np.pi * frequency / C, 1.0 / miki_impedance(np.array([frequency]), FLOW_RESISTIVITY[surface])[0]

        def line_source(q, k=k, admittance=admittance):
            away = np.sqrt(distance**2 + (height + 1j * q) ** 2)
            return np.exp(-k * admittance * q + 1j * k * (away - path)) * path / away

        end = 40.0 / (k * admittance.real)
        tail = quad_vec(line_source, 0, end)[0]
        exact = np.conj(1.0 - 2.0 * k * admittance * tail)
        found = Ground(surface).reflection(np.array(height / path), np.array(path), np.array([frequency]), C)[0]
        assert abs(found - exact) < 0.02


def test_rendered_ground_effect_is_the_sum_of_two_rays():
    tones = np.arange(200, 4000, 100)
    signal = FormulaSignal(lambda t: sum(np.sin(2 * np.pi * f * t) for f in tones))
    heard = hear([12.0, 0, 3.0], [[0, 0, 1.5]], signal, 1.5, Surroundings(ground=Ground('grass')))[RATE // 2:, 0]
    measured = np.abs(np.fft.rfft(heard))[tones] / (RATE / 2)
    direct, mirrored = np.hypot(12, 1.5), np.hypot(12, 4.5)
    factor = Ground('grass').reflection(np.array(4.5 / mirrored), np.array(mirrored), tones.astype(float), C)
    wave = np.exp(-2j * np.pi * tones / C * direct) / direct + factor * np.exp(-2j * np.pi * tones / C * mirrored) / mirrored
    assert np.max(np.abs(measured - np.abs(wave))) * direct < 0.02


@pytest.fixture
def pra():
    """pyroomacoustics with this speed of sound and without its own high-pass, as long as a test lasts."""
    library = pytest.importorskip('pyroomacoustics')
    before = {name: library.constants.get(name) for name in ('c', 'rir_hpf_enable')}
    library.constants.set('c', C)
    library.constants.set('rir_hpf_enable', False)
    yield library
    for name, value in before.items():
        library.constants.set(name, value)


def test_room_is_that_of_pyroomacoustics(pra):
    size, source, microphones, order, absorption = [6.0, 5.0, 3.0], [2.0, 3.1, 1.4], [[4.1, 1.9, 1.2], [4.1, 2.1, 1.2]], 5, 0.35
    theirs = pra.ShoeBox(size, fs=RATE, materials=pra.Material(absorption), max_order=order)
    theirs.add_source(source)
    theirs.add_microphone_array(np.array(microphones).T)
    theirs.compute_rir()
    heard = hear(source, microphones, pulse_signal(), 0.5, Surroundings(room=Room([0, 0, 0], size, (absorption,), order=order)))
    pulse = pulse_signal().stream(RATE, [0], at(source)).read(0, RATE // 2)
    late = pra.constants.get('frac_delay_length') // 2
    for channel in range(2):
        expected = np.convolve(pulse, theirs.rir[channel][0])[late:late + RATE // 2]
        assert np.corrcoef(heard[:, channel], expected)[0, 1] > 0.9999


@pytest.mark.parametrize(('source', 'microphone'), [([9.0, 3.0, 1.4], [4.0, 2.0, 1.2]), ([4.0, 2.0, 1.2], [3.0, -2.0, 1.4])])
def test_a_room_reflects_nothing_of_what_is_outside(source, microphone):
    room = Surroundings(room=Room([0, 0, 0], [6.0, 5.0, 3.0], (0.1,)))
    heard, free = (hear(source, [microphone], pulse_signal(), 0.3, place) for place in (room, None))
    np.testing.assert_allclose(heard, free, atol=1e-12)


def test_face_of_a_box_is_a_mirror_within_its_edges():
    wall = Box([0.0, 4.0, 2.0], [3.0, 0.2, 4.0], absorption=(0.36,))
    surroundings = Surroundings(obstacles=[wall])
    plain = hear([-1.0, 0, 2.0], [[1.0, 0, 2.0]], pulse_signal(), 0.3)[:, 0]
    reflected = hear([-1.0, 0, 2.0], [[1.0, 0, 2.0]], pulse_signal(), 0.3, surroundings)[:, 0] - plain
    image = hear([-1.0, 7.8, 2.0], [[1.0, 0, 2.0]], pulse_signal(), 0.3)[:, 0]
    np.testing.assert_allclose(reflected, 0.8 * image, atol=1e-3 * np.abs(image).max())
    beside = hear([-6.0, 0, 2.0], [[1.0, 0, 2.0]], pulse_signal(), 0.3, surroundings)
    far_away = Surroundings(obstacles=[Trunk([90, 90])])
    assert np.array_equal(beside, hear([-6.0, 0, 2.0], [[1.0, 0, 2.0]], pulse_signal(), 0.3, far_away))


def test_box_and_ground_mirror_together():
    wall = Box([0.0, 4.1, 5.0], [30.0, 0.2, 10.0], absorption=(0.0,))
    surroundings = Surroundings(ground=Ground('concrete'), obstacles=[wall])
    heard = hear([-1.0, 0, 2.0], [[1.0, 0, 1.0]], pulse_signal(), 0.3, surroundings)[:, 0]
    images = [[-1.0, 0, 2.0], [-1.0, 0, -2.0], [-1.0, 8.0, 2.0], [-1.0, 8.0, -2.0]]
    expected = sum(hear(place, [[1.0, 0, 1.0]], pulse_signal(), 0.3)[:, 0] for place in images)
    assert np.corrcoef(heard, expected)[0, 1] > 0.999


def test_detours_are_taut_strings():
    wall = Box([5.0, 0.0, 1.5], [0.2, 8.0, 3.0])
    left, right, over = detours(wall, np.array([0.0, 1.0, 1.0]), np.array([10.0, 1.0, 1.0]))
    assert left == pytest.approx(2 * np.hypot(4.9, 3.0) + 0.2 - 10.0)
    assert right == pytest.approx(2 * np.hypot(4.9, 5.0) + 0.2 - 10.0)
    assert over == pytest.approx(2 * np.hypot(4.9, 2.0) + 0.2 - 10.0)
    assert detours(wall, np.array([0.0, 0, 1.0]), np.array([4.0, 0, 1.0])) is None
    clear = detours(wall, np.array([0.0, 0, 4.0]), np.array([10.0, 0, 4.0]))
    assert clear[2] == pytest.approx(-(np.hypot(4.9, 1.0) + np.hypot(5.1, 1.0) - 10.0))


@pytest.mark.parametrize('number, loss_db', [(0.0, 5.0), (1.0, 13.0), (10.0, 23.0), (-0.3, 0.0)])
def test_edge_loss_is_maekawas(number, loss_db):
    """Points of Maekawa's chart: 10 lg(20 N + 3) behind the edge, 5 dB at grazing."""
    found = edge_loss_db(np.array([number * C / 2000.0]), np.array([1000.0]), C)[0, 0]
    assert found == pytest.approx(loss_db, abs=0.6)


def test_rendered_sound_behind_a_wall_has_lost_what_the_formula_says():
    wall = Box([5.0, 0.0, 2.0], [0.1, 4000.0, 4.0], reflects=False)
    source, microphone = [10.0, 0, 1.0], [[0.0, 0, 1.0]]
    for frequency in (250.0, 1000.0, 4000.0):
        open_air, shaded = (hear(source, microphone, ToneSignal(frequency), 1.0, place)[4000:].std()
                            for place in (None, Surroundings(obstacles=[wall])))
        detour = 2 * np.hypot(4.95, 3.0) + 0.1 - 10.0
        expected = min(edge_loss_db(np.array([detour]), np.array([frequency]), C)[0, 0], 25.0)
        assert 20 * np.log10(open_air / shaded) == pytest.approx(expected, abs=0.5)


def test_shade_fades_in_smoothly_and_a_thin_trunk_shades_high_frequencies_only():
    trunk = Trunk([5.0, 0.0], radius=0.1)
    across = np.array([occlusion([trunk], np.array([0.0, y, 1.0]), np.array([10.0, y, 1.0]), FREQUENCIES, C)
                       for y in np.linspace(-2.0, 2.0, 401)])
    assert across[:, 0].min() > 0.95 and across[:, 3].min() < 0.7
    assert np.all(across[[0, -1]] == 1.0)
    assert np.abs(np.diff(across[:, :3], axis=0)).max() < 0.1


@pytest.mark.parametrize('make, message', [
    (lambda: Ground('moon'), "surface is 'moon'"),
    (lambda: Room([0, 0, 0], [1, 1, 0]), 'maximum'),
    (lambda: Room([0, 0, 0], [1, 1, 1], absorption=(1.5,)), r'absorption is \(1.5,\)'),
    (lambda: Surroundings(ground=Ground(), room=Room([0, 0, 0], [1, 1, 1])), 'ground and room'),
    (lambda: Box([0, 0, 0], [1, 0, 1]), 'size'),
])
def test_impossible_surroundings_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
