from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'scenario_schema = av_simulator.cli.scenario_schema:main',
        'simulate = av_simulator.cli.simulate:main',
        'simulator = av_simulator.cli.simulator:main',
    ],
})
