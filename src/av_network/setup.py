from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'network_node = av_network.nodes.network_node:main',
    ],
})
