from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'audio_node = av_audio.nodes.audio_node:main',
        'doa_node = av_audio.nodes.doa_node:main',
        'calibrate = av_audio.cli.calibrate:main',
        'localize = av_audio.cli.localize:main',
        'record_ego_noise = av_audio.cli.record_ego_noise:main',
    ],
})
