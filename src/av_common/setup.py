from setuptools import find_packages, setup

package_name = 'av_common'

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
    description='What the nodes of the rig share: lifecycle, diagnostics, parameters, angles and frames.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
        ],
    },
)
