from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'security = av_bringup.cli.security:main',
    ],
})
