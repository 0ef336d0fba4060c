from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'pointing_node = av_pointing.nodes.pointing_node:main',
        'rig_frames_node = av_pointing.nodes.rig_frames_node:main',
    ],
})
