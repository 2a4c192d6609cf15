#!/usr/bin/env bash
# Check the types of every package. Each is checked from its own folder's root, so that module names are what users import.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
packages=(sl_common pattern_gen sl_decoder sl_calibration arm_positioner sl_sim sl_bringup)
path=$(printf ':%s' "${packages[@]/#/$PWD/}")
MYPYPATH=${path:1} mypy --explicit-package-bases "${packages[@]/%//}" --exclude '(/test/|setup\.py$|/launch/|/build/)'
