#!/bin/sh
# Builds pycomedi 0.9 from its source distribution and installs it into the virtual environment $1.
#
# The sources of 2015 declare no build requirements and were written for Python 2 and an old Cython; pycomedi-0.9.patch
# has the changes and their reasons. Doing it twice does nothing; an older build is replaced.
set -eu
venv=$1
python=$venv/bin/python
here=$(cd "$(dirname "$0")" && pwd)

# Says why not, where it is not.
installed() {
    "$python" -c '
import sys
from rig.hardware.cards.comedi_device import require
try:
    require()
except Exception as error:
    sys.exit(str(error))'
}

if installed 2>/dev/null; then
    echo "pycomedi is installed in $venv"
    exit 0
fi
if ! "$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))'; then
    echo "pycomedi 0.9 was not tried with $("$python" --version): the Cython that it needs knows Python up to 3.13." >&2
    echo "Make the environment anew with Python 3.11 to 3.13: make clean && PYTHON=python3.13 make comedi" >&2
    echo "Everything but a real card works as it is." >&2
    exit 2
fi

numpy=$("$python" -c 'import numpy; print(numpy.__version__)')
missing=
command -v cc >/dev/null 2>&1 || missing="$missing gcc libc6-dev"
command -v patch >/dev/null 2>&1 || missing="$missing patch"
[ -e /usr/include/comedilib.h ] || [ -e /usr/local/include/comedilib.h ] ||
    echo '#include <comedilib.h>' | cc -E - >/dev/null 2>&1 || missing="$missing libcomedi-dev"
headers=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
[ -e "$headers/Python.h" ] || missing="$missing $("$python" -c 'import sys; print("python%d.%d-dev" % sys.version_info[:2])')"
if [ -n "$missing" ]; then
    sh "$here/../packages.sh" "building pycomedi" $missing
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
quietly() {
    if ! "$@" >"$work/log" 2>&1; then
        cat "$work/log" >&2
        echo "make comedi failed at: $*" >&2
        exit 1
    fi
}
fetched() {
    if ! (quietly "$@"); then
        echo "If no package index was reached: behind a proxy set https_proxy; PIP_INDEX_URL names another index;" \
            "offline, PIP_NO_INDEX=1 and PIP_FIND_LINKS name a folder with these packages." >&2
        exit 1
    fi
}

echo "softrig: building pycomedi (once, half a minute)"
echo "pycomedi is licensed under the GPL, version 2 or later; softrig itself under BSD-3-Clause."
quietly "$python" -m venv "$work/build"
build=$work/build/bin/python
fetched "$build" -m pip install --disable-pip-version-check "cython==3.1.*" "numpy==$numpy" "setuptools<81" wheel
fetched "$build" -m pip download --disable-pip-version-check --no-deps --no-binary :all: --no-build-isolation \
    --require-hashes --dest "$work" -r "$here/requirements.txt"
tar -xzf "$work/pycomedi-0.9.tar.gz" -C "$work"
quietly patch -d "$work/pycomedi-0.9" -p1 -i "$here/pycomedi-0.9.patch"
quietly "$build" "$here/constants.py" "$work/pycomedi-0.9/pycomedi/comedi_h.py"
quietly "$build" -m pip wheel --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir "$work" "$work/pycomedi-0.9"
quietly "$python" -m pip install --disable-pip-version-check --no-deps --force-reinstall "$work"/pycomedi-0.9.post3-*.whl
if ! installed; then
    echo "pycomedi was built and cannot be imported, for the reason above" >&2
    exit 1
fi
echo "pycomedi is installed in $venv"
