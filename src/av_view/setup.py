from av_common.packaging import set_up

set_up(package_data={'av_view': ['page/*']}, zip_safe=False, entry_points={
    'console_scripts': [
        'doctor = av_view.cli.doctor:main',
        'setup = av_view.cli.setup:main',
        'view_node = av_view.nodes.view_node:main',
    ],
})
