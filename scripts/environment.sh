#!/bin/sh
# Creates the virtual environment $1 from requirements.lock and installs softrig into it, editable.
set -eu
venv=$1

python=
for candidate in ${PYTHON:-python3 python3.13 python3.12 python3.11}; do
    if command -v "$candidate" >/dev/null 2>&1 &&
        "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; then
        python=$candidate
        break
    fi
done
if [ -z "$python" ] && [ -n "${PYTHON:-}" ]; then
    echo "PYTHON=$PYTHON is not a Python that softrig can use: it needs 3.11, 3.12 or 3.13." >&2
    exit 2
fi
if [ -z "$python" ]; then
    echo "softrig needs Python 3.11, 3.12 or 3.13, and found none." >&2
    echo "On Debian 12, Ubuntu 24.04 or newer: sudo apt-get install python3 python3-venv" >&2
    exit 2
fi
if ! "$python" -c 'import venv, ensurepip' 2>/dev/null; then
    echo "softrig needs Python's venv module, which $python lacks." >&2
    echo "On Debian or Ubuntu: sudo apt-get install python3-venv" >&2
    exit 2
fi

echo "softrig: creating $venv with $("$python" --version) (once, a minute or two)"
rm -rf "$venv"
"$python" -m venv "$venv"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
echo "softrig: compiling the rod model (once, a minute or two)"
"$venv/bin/python" -m rig.experiment.warm
