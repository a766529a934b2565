#!/bin/bash
# Builds comedi.ko and adv_pci1710.ko of Linux-Comedi for the kernel of the virtual machine, in the cache $1; prints
# the folder with both. Built once for each commit and kernel. The exit status is 4 where it cannot be fetched.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
cache=$(cd "$1" && pwd)
release=$(cat "$cache/release")
# The last commit whose driver takes commands: docs/reference/emulated-board.md. git checks the content against it.
commit=3f163ae01a8eb5a5fde5d0e6993e0dc8f5508011
url=https://github.com/Linux-Comedi/comedi.git
drivers=$cache/linux-comedi-${commit:0:12}-$release
if [ -e "$drivers/adv_pci1710.ko" ]; then
    echo "$drivers"
    exit 0
fi

work=$cache/linux-comedi-build log=$cache/linux-comedi.log
rm -rf "$work"
mkdir -p "$work"
git init -q "$work/comedi"
GIT_TERMINAL_PROMPT=0 timeout 300 git -C "$work/comedi" fetch -q --depth 1 "$url" "$commit" >"$log" 2>&1 || {
    echo "softrig: git cannot fetch Linux-Comedi from $url:" >&2
    tail -n 1 "$log" >&2
    rm -rf "$work"
    exit 4
}
git -C "$work/comedi" checkout -q FETCH_HEAD

missing=
needs() { command -v "$1" >/dev/null 2>&1 || missing="$missing $2"; }
needs autoconf autoconf
needs automake automake
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086
    sh "$here/../../packages.sh" "the driver of the PCI-1716" $missing >&2
fi
echo "softrig: building Linux-Comedi's adv_pci1710 (once, a minute)" >&2
headers=$(bash "$here/../headers.sh" "$cache" "$work/headers")
# Its core and this one driver of some 200.
sed -i '/kcomedilib/d' "$work/comedi/comedi/Kbuild"
sed -i '/^obj-.*[.]o$/d' "$work/comedi/comedi/drivers/Kbuild"
echo 'obj-m += adv_pci1710.o' >>"$work/comedi/comedi/drivers/Kbuild"
(cd "$work/comedi" && ./autogen.sh && ./configure --with-linuxdir="$headers" --with-kernel-release="$release" \
    --disable-pcmcia --disable-usb && make -C comedi CC=gcc all-local) >"$log" 2>&1 || {
    tail -n 20 "$log" >&2
    exit 1
}
rm -rf "$drivers.part"
mkdir "$drivers.part"
cp "$work/comedi/comedi/comedi.ko" "$work/comedi/comedi/drivers/adv_pci1710.ko" "$drivers.part"
mv "$drivers.part" "$drivers"
rm -rf "$work"
echo "$drivers"
