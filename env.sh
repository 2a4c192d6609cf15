# Source this file in bash or zsh: it gives a shell in which `ros2 run PKG EXE` works. Build first with `make build`.
#
# Where a ROS 2 Jazzy is sourced, its own ros2 is used; otherwise workspace/bin/ros2, which knows `ros2 run` only.

if [ -n "${BASH_SOURCE:-}" ]; then _sl_file="${BASH_SOURCE[0]}"; elif [ -n "${ZSH_VERSION:-}" ]; then _sl_file="${(%):-%x}"; else _sl_file="${SL_ROOT:-.}/env.sh"; fi
_sl_root="$(cd "$(dirname "$_sl_file")" && pwd)"

if [ ! -f "$_sl_root/install/.built" ] && [ ! -f "$_sl_root/install/local_setup.sh" ]; then
  echo "error: the workspace is not built yet: run 'make build' in $_sl_root" >&2
  unset _sl_file _sl_root
  return 1
fi

if [ -z "${ROS_DISTRO:-}" ]; then
  # ROS comes from the wheels in .venv, which is an ament prefix. Setting the library path here saves every Python of the
  # venv from executing itself a second time to do so.
  case ":${AMENT_PREFIX_PATH:-}:" in *":$_sl_root/.venv:"*) ;; *) export AMENT_PREFIX_PATH="$_sl_root/.venv${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}" ;; esac
  for _sl_libs in "$_sl_root"/.venv/lib/python3.*/site-packages/ros_*.libs "$_sl_root/.venv/lib"; do
    case ":${LD_LIBRARY_PATH:-}:" in *":$_sl_libs:"*) ;; *) export LD_LIBRARY_PATH="$_sl_libs${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" ;; esac
  done
  export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
  unset _sl_libs
fi

case ":$PATH:" in *":$_sl_root/.venv/bin:"*) ;; *) export PATH="$_sl_root/.venv/bin:$PATH" ;; esac
COLCON_CURRENT_PREFIX="$_sl_root/install"
if [ -n "${ZSH_VERSION:-}" ]; then emulate sh -c '. "$COLCON_CURRENT_PREFIX/local_setup.sh"'; else . "$COLCON_CURRENT_PREFIX/local_setup.sh"; fi
unset COLCON_CURRENT_PREFIX
command -v ros2 >/dev/null 2>&1 || export PATH="$PATH:$_sl_root/workspace/bin"

# The matrices are small: threads of a linear algebra library only take cores from other nodes.
export OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}" OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
unset _sl_file _sl_root
