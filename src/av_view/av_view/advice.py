"""What to do about what nodes report: a pattern of the node's name, one of its words, and the advice."""

from __future__ import annotations

ADVICE: tuple[tuple[str, str, str], ...] = (
    ('.*', r'says nothing for',
     'A process of the launch that has ended is started again within a second, one that hangs is replaced after 8 s. If NODE '
     'does not come back, look at its last lines in ~/.ros/log.'),
    ('.*', r'\d+ publishers .* not used', 'Nothing moves on an input of two programs: `ros2 topic info -v TOPIC` shows both.'),
    ('recorder_node', r'^not active', 'It waits for the button, or for `ros2 lifecycle set NODE configure` and `activate`.'),
    ('(?!recorder_node).*', r'^not active', 'The node is inactive: `ros2 lifecycle set NODE activate`.'),
    ('.*', r'stamps from the future|stamps? .*expected', 'Two clocks differ: run `chronyc tracking` on each machine; '
     'for simulators see docs/reference/clocks.md.'),
    ('.*', r' refused: ', 'Something sends messages that cannot be used: the name before "refused" is the topic or service.'),
    ('audio_node', r'silent', 'Is the microphone muted? `alsamixer`, then `ros2 run av_view doctor` with a clap.'),
    ('audio_node', r'device', 'Is it plugged in, and used by no other program? `ros2 run av_view doctor` lists the devices.'),
    ('doa_node', r'no audio', 'Nothing is heard: look at audio_node, or at bridge_node and the simulator.'),
    ('doa_node', r'motor speeds', 'Publish motor_speeds, or set the parameter ego_rotor_blades of doa_node to 0.'),
    ('camera_node', r'no images|failed', 'Is the camera plugged in, and used by no other program? `ros2 run av_view doctor` '
     'opens it as camera_node does.'),
    ('detector_node', r'no images', 'Nothing is seen: look at camera_node, or at bridge_node and the simulator.'),
    ('bridge_node', r'no data', 'Is the simulator running, and does it send to these ports?'),
    ('bridge_node', r'allowed_senders', 'Name the simulator\'s address in allowed_senders:=, if it may send.'),
    ('fusion_node', r'no .*odometry', 'The attitude of the rig is unknown: px4:=true, or publish odometry. On a mast that '
     'never turns this is harmless.'),
    ('fusion_node', r'no .*(doa|detections)', 'A sensor gives nothing: its node above says why.'),
    ('fusion_node', r'transform', 'Is rig_frames_node running, or the robot\'s own publisher of tf, in the '
     'rig\'s namespace?'),
    ('pointing_node', r'no target/bearing', 'fusion_node gives no bearing: look there.'),
    ('pointing_node', r'no odometry', 'The body stands still without odometry: px4:=true, or publish odometry.'),
    ('recorder_node', r'messages lost', 'The disk is too slow: record fewer topics or images:=jpeg, or onto another disk.'),
    ('recorder_node', r'No space', 'The disk is full.'),
    ('px4_node', r'.', 'See docs/guides/px4.md, "Before the first flight, without propellers".'),
)
