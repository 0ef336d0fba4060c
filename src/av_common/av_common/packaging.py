"""What the setup.py of all packages have in common. What package.xml says is taken from there."""

from __future__ import annotations

from contextlib import redirect_stdout
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup

DATA = ('config', 'launch', 'models')  # folders of a package that are installed into its share


def set_up(**others: Any) -> None:
    """Generate the parameters of the nodes of the package in the working folder, and run setuptools.

    Parameters:
        others: further arguments of `setuptools.setup`, such as `entry_points`.
    """
    said = ET.parse('package.xml').getroot()
    name, version, description, license_ = (said.findtext(key) or '' for key in ('name', 'version', 'description', 'license'))
    for parameters in Path(name, 'nodes').glob('*_parameters.yaml'):
        from generate_parameter_library_py.generate_python_module import run as generate
        with redirect_stdout(None):  # colcon reads what this prints
            generate(str(parameters.with_suffix('.py')), str(parameters), '')
    data = [file for folder in DATA for file in Path(folder).rglob('*') if file.is_file() and '__pycache__' not in file.parts]
    setup(**{
        'name': name, 'version': version, 'description': description, 'license': license_,
        'maintainer': said.findtext('maintainer'), 'maintainer_email': said.findall('maintainer')[0].get('email'),
        'packages': find_packages(exclude=['test']), 'install_requires': ['setuptools'], 'zip_safe': True,
        'data_files': [('share/ament_index/resource_index/packages', [f'resource/{name}']),
                       (f'share/{name}', ['package.xml']),
                       *((f'share/{name}/{file.parent}', [str(file)]) for file in data)],
        **others})
