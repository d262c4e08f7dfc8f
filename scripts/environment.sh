# Shared by scripts/setup and scripts/ros_env (sourced, bash): where the environment lives, whether it is
# up to date, and how to enter it.
#
# ROS_DISTRO=jazzy in the caller's environment selects the ROS 2 that is sourced there; anything else
# selects the wheels of requirements/lock.txt. The two never share a folder.

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
if [[ ${ROS_DISTRO:-} == jazzy ]]; then
    route=sourced venv=$root/.venv-jazzy
else
    route=wheels venv=$root/.venv
fi
stamps=$venv/stamps

# One line that changes whenever another interpreter would be used; fails if it does not run.
python_identity() {
    "$1" -I -S -c 'import sys; print(*sys.version_info[:3], sys.implementation.cache_tag, sys.base_prefix)' \
        2>/dev/null
}

digest() { sha256sum | cut -c 1-16; }

# What each step of the set-up depends on. The folder counts: scripts of a virtual environment hold its path.
base_key() { (cd "$root" && { echo "$route $root $1"; cat scripts/setup scripts/*.py requirements/lock.txt; } | digest); }
messages_key() { (cd "$root" && { base_key "$1"; find msg_defs -type f | sort | xargs cat; find msg_defs | sort; } | digest); }
project_key() { (cd "$root" && { base_key "$1"; cat setup.py setup.cfg package.xml; ls config launch bags; } | digest); }

is_current() { # STEP KEY
    [[ -r $stamps/$1 && $(<"$stamps/$1") == "$2" ]]
}

# True when every step is done for the present sources and Python; about 0.05 s.
environment_is_current() {
    local identity
    identity=$(python_identity "$venv/bin/python") || return 1
    if [[ -n ${PYTHON:-} && $(python_identity "$PYTHON") != "$identity" ]]; then
        return 1
    fi
    is_current packages "$(base_key "$identity")" &&
        is_current messages "$(messages_key "$identity")" &&
        is_current project "$(project_key "$identity")"
}

# Set the variables that let `import rclpy, fden_msgs.msg` work in any child process.
enter_environment() {
    local site libraries
    site=$(echo "$venv"/lib/python3.*/site-packages)
    libraries=$venv/lib
    export VIRTUAL_ENV=$venv PATH=$venv/bin:$PATH
    if [[ $route == wheels ]]; then
        # Another ROS distribution may be sourced: its libraries must not mix with the wheels'.
        if [[ -n ${ROS_DISTRO:-} ]]; then
            unset ROS_DISTRO LD_LIBRARY_PATH
        fi
        unset PYTHONPATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH
        export RMW_IMPLEMENTATION=rmw_fastrtps_cpp
        # The wheels' start-up hook would run the interpreter a second time to set LD_LIBRARY_PATH.
        export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
        libraries=$(IFS=: && set -- "$venv/lib" "$site"/ros_*.libs && echo "$*")
    else
        # A workspace of the user's may hold an installed copy of the project: this tree comes first.
        export PYTHONPATH=$root:$site${PYTHONPATH:+:$PYTHONPATH}
    fi
    export LD_LIBRARY_PATH=$libraries${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
    export AMENT_PREFIX_PATH=$venv${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}
    export CMAKE_PREFIX_PATH=$venv${CMAKE_PREFIX_PATH:+:$CMAKE_PREFIX_PATH}
}
