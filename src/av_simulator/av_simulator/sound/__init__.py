"""Simulation of sound at microphones: moving sources, propagation, signals and noise.

The models are described in docs/reference/simulated_sound.md.
"""

from av_simulator.sound.bystander_signals import EngineSignal, HelicopterSignal, SirenSignal, VoiceSignal
from av_simulator.sound.ego_rotors import EgoRotors
from av_simulator.sound.ground import Ground
from av_simulator.sound.medium import Medium
from av_simulator.sound.noise import Noise, Snr, Wind
from av_simulator.sound.obstacles import Box, Trunk
from av_simulator.sound.reverberation import ReverbZone
from av_simulator.sound.rotor import RotorSignal
from av_simulator.sound.source import RotorDirectivity, Source, load_profile
from av_simulator.sound.source_signals import FormulaSignal, RecordedSignal, SourceSignal, ToneSignal
from av_simulator.sound.surroundings import Room, Surroundings
from av_simulator.sound.world import SoundWorld

__all__ = [
    'Box',
    'EgoRotors',
    'EngineSignal',
    'FormulaSignal',
    'Ground',
    'HelicopterSignal',
    'Medium',
    'Noise',
    'RecordedSignal',
    'ReverbZone',
    'Room',
    'RotorDirectivity',
    'RotorSignal',
    'SirenSignal',
    'Snr',
    'SoundWorld',
    'Source',
    'SourceSignal',
    'Surroundings',
    'ToneSignal',
    'Trunk',
    'VoiceSignal',
    'Wind',
    'load_profile',
]
