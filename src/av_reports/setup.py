from av_common.packaging import set_up

set_up(entry_points={
    'console_scripts': [
        'report_node = av_reports.nodes.report_node:main',
    ],
})
