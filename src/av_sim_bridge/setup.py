from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'bridge_node = av_sim_bridge.nodes.bridge_node:main',
    ],
})
