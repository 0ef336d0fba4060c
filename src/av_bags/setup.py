from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'player_node = av_bags.nodes.player_node:main',
        'recorder_node = av_bags.nodes.recorder_node:main',
        'repair_bag = av_bags.cli.repair_bag:main',
    ],
})
