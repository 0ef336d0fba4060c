from contextlib import redirect_stdout
from pathlib import Path

from generate_parameter_library_py.generate_python_module import run as generate_parameters
from setuptools import find_packages, setup

package_name = 'av_view'

for description in Path(package_name, 'nodes').glob('*_parameters.yaml'):
    with redirect_stdout(None):  # colcon reads what this file prints
        generate_parameters(str(description.with_suffix('.py')), str(description), '')

setup(
    name=package_name,
    version='0.3.0',
    packages=find_packages(exclude=['test']),
    package_data={package_name: ['page/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
        (f'share/{package_name}/config', [str(file) for file in Path('config').iterdir() if file.is_file()]),
    ],
    install_requires=['setuptools'],
    zip_safe=False,
    maintainer='The av_rig maintainers',
    maintainer_email='av_rig@users.noreply.github.com',
    description='The rig in a browser, in Foxglove, RViz and PlotJuggler; a check of the machine before the first launch.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'doctor = av_view.cli.doctor:main',
            'setup = av_view.cli.setup:main',
            'view_node = av_view.nodes.view_node:main',
        ],
    },
)
