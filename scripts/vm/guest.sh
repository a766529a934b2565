#!/bin/bash
# Second program of the guest: load the devices' drivers, run the tests, switch off.
exec >>/out/log 2>&1
. /out/job
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8
mount -t tmpfs memory /run
mkdir -p /dev/shm /dev/pts
mount -t tmpfs memory /dev/shm
mount -t devpts terminals /dev/pts
mkdir -p "/lib/modules/$release"
mount --bind "$cache/kernel/lib/modules/$release" "/lib/modules/$release"
ip link set lo up 2>/dev/null
echo "guest: up after $(cut -d' ' -f1 /proc/uptime) s, kernel $(uname -r)"

modprobe comedi_test
modprobe vivid n_devs=1 node_types=0x1
modprobe videodev
insmod "$cache/v4l2loopback.ko" devices=1 video_nr=9 card_label=played exclusive_caps=1

cd "$checkout" || exit
eval "set -- $arguments"
export PYTHONPATH=$checkout SOFTRIG_GUEST=1 SOFTRIG_GUEST_OUT=/out SOFTRIG_PICTURES=$cache/pictures.npz
# What the host compiled for any processor of its kind serves the guest, which would take minutes.
export SOFTRIG_CACHE=$cache/kernels NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES=
"$python" -m pytest -p no:cacheprovider -v --durations=10 --reruns 1 -rfEsR "$@"
echo $? >/out/status
echo "guest: done after $(cut -d' ' -f1 /proc/uptime) s"
sync
echo o >/proc/sysrq-trigger
sleep 60
