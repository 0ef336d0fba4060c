"""The message classes of the optional package `sapient-msg`, the bindings that Dstl's protobuf files were compiled to.

Raises ImportError, which says what to install, when it is imported without that package.
"""

from __future__ import annotations

try:
    from sapient_msg import proto_options_pb2 as options
    from sapient_msg.bsi_flex_335_v2_0 import (
        detection_report_pb2,
        error_pb2,
        location_pb2,
        range_bearing_pb2,
        registration_pb2,
        sapient_message_pb2,
        status_report_pb2,
        task_ack_pb2,
        task_pb2,
        velocity_pb2,
    )
except ImportError as error:
    raise ImportError('SAPIENT needs the Python package sapient-msg, which needs Python 3.11: pip install sapient-msg '
                      f'({error})') from error

__all__ = ('ICD_VERSION', 'DetectionReport', 'Error', 'Location', 'RangeBearing', 'Registration',
           'SapientMessage', 'StatusReport', 'Task', 'TaskAck', 'location', 'options', 'range_bearing', 'velocity')

ICD_VERSION = 'BSI Flex 335 v2.0'
SapientMessage = sapient_message_pb2.SapientMessage
Registration = registration_pb2.Registration
StatusReport = status_report_pb2.StatusReport
DetectionReport = detection_report_pb2.DetectionReport
Error = error_pb2.Error
Task, TaskAck = task_pb2.Task, task_ack_pb2.TaskAck
Location = location_pb2.Location
RangeBearing = range_bearing_pb2.RangeBearing
location, range_bearing, velocity = location_pb2, range_bearing_pb2, velocity_pb2  # modules, for their enumerations
