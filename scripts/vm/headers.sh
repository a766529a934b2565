#!/bin/bash
# Unpacks the headers of the virtual machine's kernel into folder $2, from packages kept in the cache $1; prints where.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=scripts/vm/unpack.sh
. "$here/unpack.sh"
cache=$(cd "$1" && pwd)
mkdir -p "$2"
into=$(cd "$2" && pwd)
release=$(cat "$cache/release")

# shellcheck disable=SC2046
unpack "$cache/packages" "$into" "linux-headers-$release" \
    $(apt-cache depends "linux-headers-$release" | sed -n 's/.*Depends: \(linux-\(headers\|kbuild\)-.*\)/\1/p')
headers=$into/usr/src/linux-headers-$release
# Debian's headers name each other by where they would be installed.
grep -rlI '/usr/src/linux-headers' "$headers/Makefile" | xargs -r sed -i "s#\(^\|[^[:alnum:]/]\)/usr/src/#\1$into/usr/src/#g"
echo "$headers"
