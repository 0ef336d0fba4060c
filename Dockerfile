# The rig on the official ROS 2 image.
#   docker build -t av_rig .
#   docker run --rm -it --network host av_rig duration:=40
#   docker run --rm -it --network host --device /dev/snd --device /dev/video0 av_rig source:=hardware
# Other cameras: docs/guides/install.md
FROM ros:jazzy-ros-base

# rosdep uses pip for dependencies that Ubuntu does not package.
ENV PIP_BREAK_SYSTEM_PACKAGES=1 RMW_IMPLEMENTATION=rmw_cyclonedds_cpp
SHELL ["/bin/bash", "-euo", "pipefail", "-c"]
WORKDIR /av_rig

COPY . .
RUN apt-get update && apt-get install -y --no-install-recommends python3-pip \
    && rosdep update --rosdistro "$ROS_DISTRO" && rosdep install -y --from-paths src --ignore-src \
    && python3 -m pip install --no-cache-dir "websockets>=13" \
    && rm -rf /var/lib/apt/lists/*
RUN . "/opt/ros/$ROS_DISTRO/setup.bash" && colcon build

ENTRYPOINT ["/bin/bash", "-c", ". tools/ros_env.sh && exec ros2 launch av_fusion rig.launch.py \"$@\"", "rig"]
