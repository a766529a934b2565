#!/bin/sh
# Says which Debian/Ubuntu packages $1 needs; $2.. are the missing ones. In CI, as root, it installs them instead.
set -eu
what=$1
shift
if [ -n "${CI:-}" ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    echo "softrig: installing for $what: $*"
    apt-get update -q >/dev/null 2>&1 || :
    DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "$@" >/dev/null
    exit 0
fi
echo "softrig: $what needs packages that are not here. On Debian or Ubuntu:" >&2
echo "    sudo apt-get install $*" >&2
exit 2
