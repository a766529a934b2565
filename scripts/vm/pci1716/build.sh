#!/bin/bash
# Builds QEMU with the emulated board, from Debian's source package, into folder $1; prints the program's path.
#
# Nothing is installed: compilers' tools and headers are fetched as packages and unpacked. The program is built once
# for each content of this folder and each version of the package; a changed board compiles one file anew.
# The exit status is 4 where the sources cannot be fetched, or apt has another version of QEMU.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$1/packages"
cache=$(cd "$1" && pwd)
jobs=${SOFTRIG_BUILD_JOBS:-2}

missing=
needs() { command -v "$1" >/dev/null 2>&1 || missing="$missing $2"; }
needs gcc gcc
needs dpkg-source dpkg-dev
needs xz xz-utils
needs patch patch
needs qemu-system-x86_64 qemu-system-x86
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086
    sh "$here/../../packages.sh" "the emulated board" $missing
fi

version=$(dpkg-query -W -f '${source:Version}' qemu-system-x86)
content=$({ echo "$version" && cat "$here"/build.sh "$here"/pci1716.c; } | sha256sum | cut -c1-16)
program=$cache/qemu-board-$content
if [ -x "$program" ]; then
    echo "$program"
    exit 0
fi
case $version in
*7.2*) ;;
*)
    echo "softrig: the emulated board is written for QEMU 7.2 (Debian 12); apt has $version here" >&2
    exit 4
    ;;
esac

# apt's own lists have no source packages as a rule: lists of our own, from the same servers.
apt=$cache/apt
if ! compgen -G "$cache/packages/qemu_*.dsc" >/dev/null; then
    echo "softrig: fetching the sources of QEMU $version (once, 24 MB)" >&2
    mkdir -p "$apt/lists/partial" "$apt/parts"
    for list in /etc/apt/sources.list.d/debian.sources /etc/apt/sources.list; do
        case $list in
        *.sources) [ ! -e "$list" ] || sed 's/^Types: .*/Types: deb-src/' "$list" >"$apt/parts/softrig.sources" ;;
        *) [ ! -e "$list" ] || sed -n 's/^deb /deb-src /p' "$list" >"$apt/parts/softrig.list" ;;
        esac
    done
    options=(-q -o "Dir::Etc::sourcelist=/dev/null" -o "Dir::Etc::sourceparts=$apt/parts"
        -o "Dir::State::lists=$apt/lists" -o APT::Sandbox::User=root)
    { apt-get "${options[@]}" update &&
        (cd "$cache/packages" && apt-get "${options[@]}" source --download-only "qemu=$version"); } >"$apt/log" 2>&1 || {
        echo "softrig: apt cannot fetch the source package qemu=$version; the end of $apt/log:" >&2
        tail -n 5 "$apt/log" >&2
        exit 4
    }
fi

system=$cache/board-system
if [ ! -e "$system/complete" ]; then
    mkdir -p "$system" "$cache/packages/board"
    (cd "$cache/packages/board" && apt-get download -q -o APT::Sandbox::User=root meson ninja-build pkgconf-bin \
        libpkgconf3 libglib2.0-dev libglib2.0-0 libpcre2-dev libpcre2-8-0 libpixman-1-dev libpixman-1-0 \
        libfdt-dev libfdt1 libattr1-dev libattr1 libcap-ng-dev libcap-ng0 zlib1g-dev zlib1g \
        libffi-dev libmount-dev libselinux1-dev libblkid-dev libsepol-dev >/dev/null) || {
        echo "softrig: apt cannot download what QEMU is built with; sudo apt-get update and try again" >&2
        exit 2
    }
    for package in "$cache"/packages/board/*.deb; do dpkg -x "$package" "$system"; done
    touch "$system/complete"
fi
machine=$(gcc -dumpmachine)
export PATH=$system/usr/bin:$PATH PYTHONPATH=$system/usr/lib/python3/dist-packages
export PKG_CONFIG=$system/usr/bin/pkgconf PKG_CONFIG_SYSROOT_DIR=$system
export PKG_CONFIG_LIBDIR=$system/usr/lib/$machine/pkgconfig:$system/usr/share/pkgconfig
export LD_LIBRARY_PATH=$system/usr/lib/$machine

sources=$cache/qemu-source build=$cache/qemu-build
configured=$(sha256sum <"$here/build.sh")
if [ ! -e "$build/build.ninja" ] || [ "$(cat "$build/configured" 2>/dev/null)" != "$configured" ]; then
    rm -rf "$sources" "$build"
    dpkg-source --no-check -x "$cache"/packages/qemu_*.dsc "$sources" >/dev/null 2>&1
    # The firmware comes from Debian's packages.
    echo 'roms = []' >"$sources/pc-bios/meson.build"
    printf '\nconfig PCI1716\n    bool\n    depends on PCI\n' >>"$sources/hw/misc/Kconfig"
    printf "\nsoftmmu_ss.add(when: 'CONFIG_PCI1716', if_true: files('pci1716.c'))\n" >>"$sources/hw/misc/meson.build"
    printf 'CONFIG_%s=y\n' Q35 VIRTIO_PCI VIRTIO_9P IVSHMEM_DEVICE PCI1716 >"$sources/configs/devices/x86_64-softmmu/softrig.mak"
    cp "$here/pci1716.c" "$sources/hw/misc/"
    mkdir -p "$build"
    (cd "$build" && "$sources/configure" --target-list=x86_64-softmmu --without-default-features \
        --without-default-devices --with-devices-x86_64=softrig --disable-install-blobs --enable-tcg \
        --enable-virtfs --enable-attr --enable-cap-ng --enable-fdt=system --disable-tools --disable-guest-agent \
        --disable-docs --disable-debug-info --meson="$system/usr/bin/meson" --ninja="$system/usr/bin/ninja" \
        --extra-cflags="-O1 -I$system/usr/include -I$system/usr/include/$machine" \
        --extra-ldflags="-L$system/usr/lib/$machine -L$system/lib/$machine") >"$cache/qemu.log" 2>&1 || {
        tail -n 20 "$cache/qemu.log" >&2
        rm -f "$build/build.ninja"
        exit 1
    }
    echo "$configured" >"$build/configured"
fi
cp "$here/pci1716.c" "$sources/hw/misc/"
echo "softrig: building QEMU with the emulated board (once, some minutes; $cache/qemu.log)" >&2
"$system/usr/bin/ninja" -C "$build" -j "$jobs" qemu-system-x86_64 >>"$cache/qemu.log" 2>&1 || {
    grep -A5 -E 'error|FAILED' "$cache/qemu.log" | tail -n 20 >&2
    exit 1
}
cp "$build/qemu-system-x86_64" "$program.part"
mv "$program.part" "$program"
echo "$program"
