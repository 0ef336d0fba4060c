"""What microphones hear of moving sources: propagation, voices and noise. See docs/simulated_sound.md."""

from av_sim_bridge.sound.attenuation import Attenuation
from av_sim_bridge.sound.directivity import CardioidDirectivity, RotorDirectivity
from av_sim_bridge.sound.ground import Ground
from av_sim_bridge.sound.medium import Medium
from av_sim_bridge.sound.noise import Noise, Snr, Wind
from av_sim_bridge.sound.obstacles import Box, Trunk
from av_sim_bridge.sound.own_rotors import OwnRotors
from av_sim_bridge.sound.profiles import load_profile
from av_sim_bridge.sound.reverberation import ReverbZone
from av_sim_bridge.sound.rotor import RotorVoice
from av_sim_bridge.sound.source import Source
from av_sim_bridge.sound.surroundings import Room, Surroundings
from av_sim_bridge.sound.voices import FormulaVoice, RecordingVoice, ToneVoice, Voice
from av_sim_bridge.sound.world import SoundWorld

__all__ = [
    'Attenuation', 'Box', 'CardioidDirectivity', 'FormulaVoice', 'Ground', 'Medium', 'Noise', 'OwnRotors',
    'RecordingVoice', 'ReverbZone', 'Room', 'RotorDirectivity', 'RotorVoice', 'Snr', 'SoundWorld', 'Source',
    'Surroundings', 'ToneVoice', 'Trunk', 'Voice', 'Wind', 'load_profile',
]
