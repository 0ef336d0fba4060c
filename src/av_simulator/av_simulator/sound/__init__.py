"""What microphones hear of moving sources: propagation, voices and noise. See docs/simulated_sound.md."""

from av_simulator.sound.attenuation import Attenuation
from av_simulator.sound.directivity import CardioidDirectivity, RotorDirectivity
from av_simulator.sound.ego_rotors import EgoRotors
from av_simulator.sound.ground import Ground
from av_simulator.sound.medium import Medium
from av_simulator.sound.noise import Noise, Snr, Wind
from av_simulator.sound.obstacles import Box, Trunk
from av_simulator.sound.profiles import load_profile
from av_simulator.sound.reverberation import ReverbZone
from av_simulator.sound.rotor import RotorVoice
from av_simulator.sound.source import Source
from av_simulator.sound.surroundings import Room, Surroundings
from av_simulator.sound.voices import FormulaVoice, RecordingVoice, ToneVoice, Voice
from av_simulator.sound.world import SoundWorld

__all__ = [
    'Attenuation',
    'Box',
    'CardioidDirectivity',
    'EgoRotors',
    'FormulaVoice',
    'Ground',
    'Medium',
    'Noise',
    'RecordingVoice',
    'ReverbZone',
    'Room',
    'RotorDirectivity',
    'RotorVoice',
    'Snr',
    'SoundWorld',
    'Source',
    'Surroundings',
    'ToneVoice',
    'Trunk',
    'Voice',
    'Wind',
    'load_profile',
]
