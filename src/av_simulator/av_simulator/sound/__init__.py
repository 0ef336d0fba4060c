"""Simulation of sound at microphones: moving sources, propagation, signals and noise.

The models are described in docs/reference/simulated_sound.md.
"""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'bystander_signals': 'EngineSignal HelicopterSignal SirenSignal VoiceSignal',
    'ground': 'Ground',
    'medium': 'Medium',
    'noise': 'EgoRotors Noise Snr Wind',
    'obstacles': 'Box Trunk',
    'rays': 'Room Surroundings',
    'reverberation': 'ReverbZone',
    'rotor': 'RotorSignal',
    'source': 'RotorDirectivity Source load_profile',
    'source_signals': 'FormulaSignal RecordedSignal SourceSignal ToneSignal',
    'world': 'SoundWorld',
})
