"""Microphones to direction of arrival."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'calibration': 'Calibration calibrate',
    'device_source': 'DeviceSource',
    'drone_classifier': 'DroneClassifier load_model',
    'ego_noise': 'NoiseRecording',
    'file_source': 'FileSource open_sound read_sound',
    'health': 'ChannelHealth',
    'localizer': 'DoaEstimate Localizer LocalizerSettings',
    'messages': 'audio_frame samples_of',
    'methods': 'DOA_METHODS Direction',
    'ring_buffer': 'RingBuffer',
    'stage': 'DoaStage make_doa_stage',
})
