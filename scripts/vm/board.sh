#!/bin/bash
# Runs tests/board: an Advantech board emulated at register level, driven by its real driver in a virtual machine.
#
#   board.sh VENV [PYTEST ARGUMENT..]
#
# SOFTRIG_BOARD_TRIALS is the number of trials of each fault in tests/board/test_safe_state.py (1).
# It is a PCI-1716 under Linux-Comedi's driver, which is fetched from GitHub and built. Where git cannot fetch it, or with
# SOFTRIG_EMULATED=pci1711, it is a PCI-1711 under the driver of Debian's kernel. SOFTRIG_LINUX_COMEDI names a folder with
# comedi.ko and adv_pci1710.ko, built for the kernel in $SOFTRIG_VM_CACHE/release, to use in place of that build.
# The guest's clock counts instructions, 1 ns each: a busy host makes the test longer, not the guest slower.
# The exit status is pytest's; 3 where the guest never came to run it. Where the sources of QEMU cannot be fetched, or are
# not those of QEMU 7.2, the tests are skipped with status 0 and the reason: this says nothing about softrig, so in CI, too.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
checkout=$(cd "$here/../.." && pwd)
venv=$(cd "$1" && pwd)
shift
cache=$(realpath -m "${SOFTRIG_VM_CACHE:-$checkout/.vm}")
bash "$here/prepare.sh" "$cache"
release=$(cat "$cache/release")
program=$(bash "$here/pci1716/build.sh" "$cache") || {
    failed=$?
    [ $failed = 4 ] || exit $failed
    echo "softrig: SKIPPED, the emulated board was not tested: QEMU cannot be built here, for the reason above" >&2
    exit 0
}
board=${SOFTRIG_EMULATED:-pci1716}
drivers=
case $board in
pci1711) ;;
pci1716)
    drivers=${SOFTRIG_LINUX_COMEDI:-$(bash "$here/pci1716/linux_comedi.sh" "$cache")} || {
        failed=$?
        [ $failed = 4 ] || exit $failed
        echo "softrig: SKIPPED, the PCI-1716 was not tested, for the reason above; a PCI-1711 takes its place" >&2
        board=pci1711
    }
    ;;
*)
    echo "softrig: SOFTRIG_EMULATED is $board; expected pci1716 or pci1711" >&2
    exit 2
    ;;
esac
for module in ${drivers:+comedi adv_pci1710}; do
    if [ ! -e "$drivers/$module.ko" ]; then
        echo "softrig: SOFTRIG_LINUX_COMEDI names $drivers, which has no $module.ko" >&2
        exit 2
    fi
done
drivers=${drivers:+$(realpath "$drivers")}

# The guest takes minutes to compile the kernels; this computer compiles them for any processor of its kind.
(cd "$checkout" && SOFTRIG_CACHE=$cache/kernels NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES='' PYTHONPATH=. \
    "$venv/bin/python" -m rig.experiment.warm)
out=$cache/board-out
rm -rf "$out"
mkdir -p "$out"
cat >"$out/job" <<END
release=$release
cache='$cache'
checkout='$checkout'
python='$venv/bin/python'
board=$board
drivers='$drivers'
trials=${SOFTRIG_BOARD_TRIALS:-1}
arguments='$(printf '%q ' "${@:-$checkout/tests/board}")'
END
cp "$here/pci1716/guest.sh" "$out/guest.sh"
# An emulated machine would compile every module anew: its layer over this computer's files is forgotten.
env -u PYTHONDONTWRITEBYTECODE "$venv/bin/python" -m compileall -q "$venv/lib" "$checkout"/{rig,model,runs,protocols,calibration,tests} \
    >/dev/null || :

# The monitor of the machine is at the end of the guest's own serial line ttyS1: its tests set voltages and faults.
sockets=$(mktemp -d)
machine=
bench=
trap 'kill $machine $bench 2>/dev/null || :; rm -rf "$sockets"' EXIT
trap 'exit 143' INT TERM
# The simulator behind the board: its process must listen before the machine starts.
touch "$sockets/memory"
(cd "$checkout" && PYTHONPATH=. exec "$venv/bin/python" -m scripts.vm.pci1716.bench "$sockets/bench" "$sockets/memory") &
bench=$!
until [ -e "$sockets/bench" ]; do
    kill -0 $bench 2>/dev/null || exit 3
    sleep 0.1
done
timeout "${SOFTRIG_VM_LIMIT_S:-1200}" "$program" -L /usr/share/qemu -L /usr/share/seabios \
    -accel tcg,thread=single -icount shift=0,sleep=on -cpu Nehalem -M q35 -smp 1 -m "${SOFTRIG_VM_MEMORY_MIB:-2048}" \
    -nodefaults -no-reboot -display none -chardev "socket,id=bench,path=$sockets/bench" \
    -device "$board,id=board,bench=bench" \
    -object "memory-backend-file,id=memory,share=on,mem-path=$sockets/memory,size=1M" -device ivshmem-plain,memdev=memory \
    -serial "file:$cache/board-console" \
    -chardev "socket,id=monitor,path=$sockets/monitor,server=on,wait=off" -mon chardev=monitor,mode=control \
    -chardev "socket,id=line,path=$sockets/monitor" -serial chardev:line \
    -kernel "$cache/kernel/boot/vmlinuz-$release" -initrd "$cache/initrd" -append "console=ttyS0 quiet panic=-1 mitigations=off" \
    -fsdev "local,path=/,security_model=none,readonly=on,multidevs=remap,id=root" \
    -device virtio-9p-pci,fsdev=root,mount_tag=root \
    -fsdev "local,path=$out,security_model=none,id=out" -device virtio-9p-pci,fsdev=out,mount_tag=out &
machine=$!
touch "$out/log"
tail -n +1 -f --pid=$machine "$out/log" &
wait $machine || :
kill $bench 2>/dev/null || :
wait
if [ ! -e "$out/status" ]; then
    echo "softrig: the virtual machine ended without a result; the end of its console:" >&2
    tail -n 20 "$cache/board-console" >&2
    exit 3
fi
exit "$(cat "$out/status")"
