#!/bin/bash
# Second program of the guest with the emulated board: load the board's driver, run the tests, switch off.
exec >>/out/log 2>&1
. /out/job
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8
# The machine's monitor listens on this line: what it says must not be echoed to it.
stty -F /dev/ttyS1 raw -echo
mount -t tmpfs memory /run
mkdir -p /dev/shm /dev/pts
mount -t tmpfs memory /dev/shm
mkdir -p "/lib/modules/$release"
mount --bind "$cache/kernel/lib/modules/$release" "/lib/modules/$release"
ip link set lo up 2>/dev/null
echo "guest: up after $(cut -d' ' -f1 /proc/uptime) s, kernel $(uname -r), $board"
if [ -n "$drivers" ]; then
    insmod "$drivers/comedi.ko" && insmod "$drivers/adv_pci1710.ko"
    export SOFTRIG_BOARD_LOAD="insmod $drivers/adv_pci1710.ko"
else
    modprobe adv_pci1710
    export SOFTRIG_BOARD_LOAD="modprobe adv_pci1710"
fi
# The camera: softrig reads it here, and a test writes the pictures of the bench to it.
modprobe videodev
insmod "$cache/v4l2loopback.ko" devices=1 video_nr=9 card_label=bench exclusive_caps=1
cd "$checkout" || exit
eval "set -- $arguments"
export PYTHONPATH=$checkout SOFTRIG_BOARD=$board SOFTRIG_BOARD_TRIALS=$trials
# What the host compiled for any processor of its kind serves the guest, which would take minutes.
export SOFTRIG_CACHE=$cache/kernels NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES=
"$python" -u -m pytest -o faulthandler_timeout=900 -p no:cacheprovider -p no:randomly -v --durations=5 "$@"
echo $? >/out/status
dmesg | grep -E 'comedi|adv_pci|irq' | tail -n 20
echo "guest: done after $(cut -d' ' -f1 /proc/uptime) s"
sync
echo o >/proc/sysrq-trigger
sleep 60
