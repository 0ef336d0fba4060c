from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'fusion_node = av_fusion.nodes.fusion_node:main',
        'security = av_bringup.cli.security:main',
    ],
})
