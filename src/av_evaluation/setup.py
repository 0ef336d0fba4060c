from contextlib import redirect_stdout
from pathlib import Path

from generate_parameter_library_py.generate_python_module import run as generate_parameters
from setuptools import find_packages, setup

package_name = 'av_evaluation'

for description in Path(package_name, 'nodes').glob('*_parameters.yaml'):
    with redirect_stdout(None):  # colcon reads what this file prints
        generate_parameters(str(description.with_suffix('.py')), str(description), '')

setup(
    name=package_name,
    version='0.3.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    zip_safe=True,
    maintainer='The av_rig maintainers',
    maintainer_email='av_rig@users.noreply.github.com',
    description='Replay of bags, offline runs, metrics, experiments, report, benchmarks and monitor.',
    license='Apache-2.0',
    entry_points={
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
    },
)
