from pathlib import Path

from setuptools import find_packages, setup

package_name = 'av_bringup'

setup(
    name=package_name,
    version='0.3.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
        *((f'share/{package_name}/{file.parent}', [str(file)]) for file in Path('config').rglob('*') if file.is_file()),
    ],
    install_requires=['setuptools'],
    zip_safe=True,
    maintainer='The av_rig maintainers',
    maintainer_email='av_rig@users.noreply.github.com',
    description='What launch files are made of, and the configuration of the suite.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'security = av_bringup.cli.security:main',
        ],
    },
)
