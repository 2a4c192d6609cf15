#!/usr/bin/env bash
# Build the workspace into install/. Run by `make build`; does nothing when nothing that needs a build has changed
# (Python modules are linked, not copied: editing one needs no build).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
exec 9>.build.lock
flock 9

root=$PWD
packages=(arm_positioner pattern_gen sl_bringup sl_calibration sl_common sl_decoder sl_msgs sl_sim)
inputs() {
  { find sl_msgs -type f
    for package in "${packages[@]}"; do
      find "$package" -type f \( -name setup.py -o -name setup.cfg -o -name package.xml -o -name colcon.pkg \)
      find "$package" -type f ! -name '*.py' ! -name '*.nb?' ! -path '*/__pycache__/*' ! -path '*/test/*' ! -path '*.egg-info/*' -printf '%p\n'
    done
  } | sort -u
}
key="$(cat .venv/ready) $root $(inputs) $(inputs | grep -E '(^sl_msgs/|setup\.(py|cfg)$|package\.xml$|colcon\.pkg$)' | xargs cat | sha256sum)"
if [ ! -f install/.built ] || [ "$(cat install/.built)" != "$key" ]; then
  rm -f install/.built
  python=$root/.venv/bin/python
  if [ -z "${ROS_DISTRO:-}" ]; then
    export AMENT_PREFIX_PATH=$root/.venv CMAKE_PREFIX_PATH=$root/.venv
    export PATH=$root/.venv/bin:$PATH
  fi
  export _ROS_WHEELS_BOOTSTRAP_COMPLETE=
  echo "building the workspace"
  mkdir -p log
  "$python" -m colcon build --base-paths . --symlink-install --parallel-workers "$(nproc)" --packages-select "${packages[@]}" \
    --event-handlers console_direct- console_cohesion- \
    --cmake-args -DPython3_EXECUTABLE="$python" -DBUILD_TESTING=OFF >log/build.log 2>&1 ||
    { tail -n 40 log/build.log >&2; echo "error: the build failed; the whole log is in log/build.log" >&2; exit 1; }
  echo "$key" >install/.built
fi

# numba's caches know when a function's own file changes, not when a function that it calls does.
for package in "${packages[@]}"; do
  oldest=$(find "$package" -name '*.nbi' -printf '%T@ %p\n' | sort -n | sed -n '1s/^[^ ]* //p')
  if [ -n "$oldest" ] && find "$package" -name '*.py' ! -path '*/test/*' -newer "$oldest" | grep -q .; then
    find "$package" -name '*.nb[ic]' -delete
  fi
done

# Compile the numba functions now, never in a first frame's callback; the cache makes this a second when nothing changed.
(
  # shellcheck source=/dev/null
  set +u; . ./env.sh; set -u
  jobs=()
  for module in sl_decoder.warmup pattern_gen.warmup sl_sim.warmup; do
    python -m "$module" &
    jobs+=($!)
  done
  for job in "${jobs[@]}"; do wait "$job"; done
)
