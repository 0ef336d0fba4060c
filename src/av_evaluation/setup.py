from av_common.packaging import set_up

set_up(entry_points={
    'av_rig.trackers': [
        'kalman = av_evaluation.experiments.baselines:KalmanTracker',
        'moving_average = av_evaluation.experiments.baselines:MovingAverage',
    ],
    'console_scripts': [
        'monitor_node = av_evaluation.nodes.monitor_node:main',
        'attack = av_evaluation.cli.attack:main',
        'city = av_evaluation.cli.city:main',
        'estimate_latency = av_evaluation.cli.estimate_latency:main',
        'evaluate = av_evaluation.cli.evaluate:main',
        'false_targets = av_evaluation.cli.false_targets:main',
        'faults = av_evaluation.cli.faults:main',
        'flying_arrays = av_evaluation.cli.flying_arrays:main',
        'front_back = av_evaluation.cli.front_back:main',
        'fuzz = av_evaluation.cli.fuzz:main',
        'hearing = av_evaluation.cli.hearing:main',
        'network = av_evaluation.cli.network:main',
        'multi_target = av_evaluation.cli.multi_target:main',
        'range = av_evaluation.cli.range:main',
        'replay = av_evaluation.cli.replay:main',
        'report = av_evaluation.cli.report:main',
        'sight_truth = av_evaluation.cli.sight_truth:main',
        'soak = av_evaluation.cli.soak:main',
    ],
})
