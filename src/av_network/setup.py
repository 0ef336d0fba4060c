from contextlib import redirect_stdout
from pathlib import Path

from generate_parameter_library_py.generate_python_module import run as generate_parameters
from setuptools import find_packages, setup

package_name = 'av_network'

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
    description='Several rigs: their tracks to targets with positions.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'network_node = av_network.nodes.network_node:main',
        ],
    },
)
