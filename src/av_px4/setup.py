from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'px4_node = av_px4.nodes.px4_node:main',
    ],
})
