#!/bin/bash
# Makes ready in folder $1 what the virtual machine needs: kernel, modules, initrd. Nothing is installed.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
cache=$1
mkdir -p "$cache/packages"
cache=$(cd "$cache" && pwd)

missing=
needs() { command -v "$1" >/dev/null 2>&1 || [ -e "/sbin/$1" ] || [ -e "/usr/sbin/$1" ] || missing="$missing $2"; }
needs qemu-system-x86_64 qemu-system-x86
needs busybox busybox-static
needs cpio cpio
needs depmod kmod
needs make make
needs gcc gcc
PATH=$PATH:/sbin:/usr/sbin ldconfig -p | grep 'libelf\.so\.1' >/dev/null || missing="$missing libelf1"
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086
    sh "$here/../packages.sh" "the hardware test" $missing
fi

release() { apt-cache depends linux-image-amd64 2>/dev/null | sed -n 's/.*Depends: linux-image-//p' | head -n 1; }
if [ ! -e "$cache/release" ]; then
    if [ -z "$(release)" ]; then
        echo "softrig: the hardware test takes Debian's kernel package, which apt does not know here" >&2
        echo "(linux-image-amd64; on Debian: sudo apt-get update)." >&2
        exit 2
    fi
    release >"$cache/release"
fi
release=$(cat "$cache/release")

# shellcheck source=scripts/vm/unpack.sh
. "$here/unpack.sh"
kernel=$cache/kernel
modules=$kernel/lib/modules/$release
if [ ! -e "$modules/modules.dep.bin" ]; then
    echo "softrig: fetching kernel $release (once, 70 MB)"
    unpack "$cache/packages" "$kernel" "linux-image-$release"
    PATH=$PATH:/sbin:/usr/sbin depmod -b "$kernel" "$release"
fi

# v4l2loopback is no part of the kernel: built from Debian's source package against unpacked headers.
if [ ! -e "$cache/v4l2loopback.ko" ]; then
    echo "softrig: building v4l2loopback (once)"
    sources=$cache/sources
    headers=$(bash "$here/headers.sh" "$cache" "$sources")
    unpack "$cache/packages" "$sources" v4l2loopback-dkms
    cp -r "$sources"/usr/src/v4l2loopback-* "$cache/v4l2loopback"
    make -s -C "$headers" "M=$cache/v4l2loopback" CC=gcc modules >"$cache/v4l2loopback.log" 2>&1 || {
        tail -n 20 "$cache/v4l2loopback.log" >&2
        exit 1
    }
    cp "$cache/v4l2loopback/v4l2loopback.ko" "$cache/v4l2loopback.ko"
    rm -rf "$sources" "$cache/v4l2loopback"
fi

# An initrd that can do one thing: mount the host's root through virtio, and go there.
if [ ! -e "$cache/initrd" ] || [ "$here/init.sh" -nt "$cache/initrd" ]; then
    tree=$(mktemp -d)
    trap 'rm -rf "$tree"' EXIT
    mkdir -p "$tree"/{bin,modules,proc,sys,dev,lower,upper,root}
    cp "$(command -v busybox)" "$tree/bin/busybox"
    for applet in sh mount insmod switch_root mkdir; do ln -s busybox "$tree/bin/$applet"; done
    for module in virtio_pci 9pnet_virtio 9p overlay; do
        PATH=$PATH:/sbin:/usr/sbin modprobe -d "$kernel" -S "$release" --show-depends "$module"
    done | awk '$1 == "insmod" && !seen[$2]++ { print $2 }' | while read -r path; do
        cp "$path" "$tree/modules/"
        basename "$path" >>"$tree/order"
    done
    install -m 755 "$here/init.sh" "$tree/init"
    (cd "$tree" && find . | cpio -o -H newc --quiet | gzip -1) >"$cache/initrd.part"
    mv "$cache/initrd.part" "$cache/initrd"
fi
