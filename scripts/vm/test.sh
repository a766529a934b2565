#!/bin/bash
# Runs tests/hardware against a real kernel's devices, in a virtual machine on this computer's own files.
#
#   test.sh VENV [PYTEST ARGUMENT..]
#
# The guest is Debian's stock kernel under QEMU, emulated: no hardware, no /dev/kvm and no root needed. Its root is
# this computer's, read-only, under a layer of memory; what the tests leave is in $SOFTRIG_VM_CACHE/out.
# The exit status is pytest's; 3 where the guest never came to run it.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
checkout=$(cd "$here/../.." && pwd)
venv=$(cd "$1" && pwd)
shift
cache=$(realpath -m "${SOFTRIG_VM_CACHE:-$checkout/.vm}")
limit_s=${SOFTRIG_VM_LIMIT_S:-2700}
memory_mib=${SOFTRIG_VM_MEMORY_MIB:-2048}

bash "$here/prepare.sh" "$cache"
release=$(cat "$cache/release")
echo "softrig: compiling for the virtual machine, and rendering what its camera will see"
(cd "$checkout" && SOFTRIG_CACHE=$cache/kernels NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES='' PYTHONPATH=. \
    "$venv/bin/python" tests/hardware/played_pictures.py render "$cache/pictures.npz")

prepare_out() {
    rm -rf "$cache/out"
    mkdir -p "$cache/out"
    cat >"$cache/out/job" <<END
release=$release
cache='$cache'
checkout='$checkout'
python='$venv/bin/python'
arguments='$(printf '%q ' "$@")'
END
    cp "$here/guest.sh" "$cache/out/guest.sh"
}

# One processor at a time, and one without AVX: QEMU 7.2 crashes now and then where two are emulated by two threads,
# and programs in its guest with it; its emulation of AVX is of that same release. `mitigations=off`, because the emulator
# forgets its translation of addresses at each switch of the page table: 38 µs for a system call, and 1.6 µs without.
emulate() {
    local root="local,path=/,security_model=none,readonly=on,multidevs=remap"
    local out="local,path=$cache/out,security_model=none"
    timeout "$limit_s" qemu-system-x86_64 -accel tcg,thread=single -cpu Nehalem -M q35 -smp 2 -m "$memory_mib" \
        -nodefaults -no-reboot -display none -serial "file:$cache/console" \
        -kernel "$cache/kernel/boot/vmlinuz-$release" -initrd "$cache/initrd" -append "console=ttyS0 quiet panic=-1 mitigations=off" \
        -fsdev "$root,id=root" -device virtio-9p-pci,fsdev=root,mount_tag=root \
        -fsdev "$out,id=out" -device virtio-9p-pci,fsdev=out,mount_tag=out &
    machine=$!
    # The guest's log appears as it is written: an emulated machine is slow, and silence looks like a fault.
    touch "$cache/out/log"
    tail -n +1 -f --pid=$machine "$cache/out/log" &
    ended=0
    wait $machine || ended=$?
    wait
}

started=$(date +%s)
trap 'kill $machine 2>/dev/null || :' EXIT
trap 'exit 143' INT TERM
for attempt in 1 2; do
    prepare_out "${@:-$checkout/tests/hardware}"
    emulate
    # 128 and more: the emulator itself was killed by a signal, which says nothing about what it emulated.
    { [ -e "$cache/out/status" ] || [ "$ended" -le 128 ]; } && break
    echo "softrig: the emulator crashed (exit status $ended), attempt $attempt of 2" >&2
done

echo "softrig: $(($(date +%s) - started)) s in the virtual machine (kernel $release, emulated)"
if [ ! -e "$cache/out/status" ]; then
    echo "softrig: the virtual machine ended without a result; the end of its console:" >&2
    tail -n 20 "$cache/console" >&2
    exit 3
fi
status=$(cat "$cache/out/status")
[ "$status" = 0 ] || exit "$status"
if compgen -G "$cache/out/runs/*.h5" >/dev/null; then
    cd "$checkout" && SOFTRIG_GUEST_LEFT=$cache/out "$venv/bin/python" -m pytest tests/hardware/test_hardware_archive.py
fi
