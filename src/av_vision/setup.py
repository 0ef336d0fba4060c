from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'camera_node = av_vision.nodes.camera_node:main',
        'detect = av_vision.cli.detect:main',
        'detector_node = av_vision.nodes.detector_node:main',
    ],
})
