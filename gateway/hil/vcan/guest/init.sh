#!/bin/sh
# First process of the user-mode-linux guest: CAN modules, then the job, its exit code, halt.
# VCAN_JOB (kernel command line) is a directory on the host with `run.sh`; it gets `output`,
# `errors` and `exit`. A signal whose name is read from the console is sent to the job.
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t tmpfs tmpfs /run
mkdir -p /dev/shm /dev/pts
mount -t tmpfs tmpfs /dev/shm
mount -t devpts devpts /dev/pts
modules=/usr/lib/uml/modules/$(uname -r)/kernel
for module in net/can/can net/can/can-raw net/can/can-bcm net/can/can-gw \
    net/can/j1939/can-j1939 drivers/net/can/dev/can-dev drivers/net/can/vcan \
    drivers/net/can/vxcan drivers/net/can/slcan/slcan; do
    insmod "$modules/$module.ko" || echo "cannot load $module"
done
# Tests give programs real-time priority so that none waits for another: so it is not rationed, and
# the kernel thread that delivers frames gets a higher priority (and a queue that is no limit).
echo -1 >/proc/sys/kernel/sched_rt_runtime_us
echo 100000 >/proc/sys/net/core/netdev_max_backlog
for process in /proc/[0-9]*; do
    grep -q ksoftirqd "$process/comm" && chrt -f -p 50 "${process#/proc/}"
done
ip link set lo up
exec 3<&0
# A shell starts a background job with SIGINT ignored, and no program inside could be interrupted.
setsid env --default-signal=INT,QUIT sh "$VCAN_JOB/run.sh" >"$VCAN_JOB/output" 2>"$VCAN_JOB/errors" &
job=$!
while read -r name; do kill -s "$name" -- "-$job"; done <&3 &
wait "$job"
echo $? >"$VCAN_JOB/exit.part"
mv "$VCAN_JOB/exit.part" "$VCAN_JOB/exit"
sync
poweroff -f
