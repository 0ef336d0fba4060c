"""What microphones hear of moving sources: propagation, voices and noise. See docs/simulated_sound.md."""

from av_sim_bridge.sound.medium import Medium, inverse
from av_sim_bridge.sound.noise import Noise, Snr
from av_sim_bridge.sound.rotor import RotorVoice
from av_sim_bridge.sound.voices import FormulaVoice, RecordingVoice, ToneVoice, Voice
from av_sim_bridge.sound.world import SoundWorld, Source

__all__ = ['FormulaVoice', 'Medium', 'Noise', 'RecordingVoice', 'RotorVoice', 'Snr', 'SoundWorld', 'Source', 'ToneVoice', 'Voice', 'inverse']
