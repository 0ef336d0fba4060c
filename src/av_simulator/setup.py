from setuptools import find_packages, setup

package_name = 'av_simulator'

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
    description='Physics simulator: sound, images and truth of drones in a world, sent as RFlySim sends them.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'scenario_schema = av_simulator.cli.scenario_schema:main',
            'simulate = av_simulator.cli.simulate:main',
            'simulator = av_simulator.cli.simulator:main',
        ],
    },
)
