from setuptools import find_packages, setup

package_name = 'av_network'

setup(
    name=package_name,
    version='0.2.0',
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
)
