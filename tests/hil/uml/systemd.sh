#!/bin/sh
# First process of a user-mode-linux guest that becomes systemd, with the units of the gateway
# installed and one more that runs the job. The host's files are read-only but for the job's folder
# (VCAN_JOB, as in init.sh), in which `paths` names what else of /tmp is needed, `binds` what else is
# installed.
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
paths=$(cat "$VCAN_JOB/paths")
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
mkdir -p /dev/shm /dev/pts
modules=/usr/lib/uml/modules/$(uname -r)/kernel
for where in /run /tmp /var /opt /dev/shm; do
    mount -t tmpfs -o mode=755 tmpfs "$where"
done
# The host's /etc with what is written here on top, but without its services.
insmod "$modules/fs/overlayfs/overlay.ko" && mkdir -p /run/etc/upper /run/etc/work &&
    mount -t overlay -o lowerdir=/etc,upperdir=/run/etc/upper,workdir=/run/etc/work etc /etc
mount -t tmpfs -o mode=755 tmpfs /etc/systemd
chmod 1777 /tmp /dev/shm
mount -t devpts devpts /dev/pts
mkdir -p /var/lib /var/log /run/systemd/system /etc/systemd/system
mkdir -m 1777 /var/tmp
for path in $paths; do
    mkdir -p "$path" && mount -t hostfs -o "ro,$path" none "$path"
done
mkdir -p "$VCAN_JOB" && mount -t hostfs -o "$VCAN_JOB" none "$VCAN_JOB"
for module in net/can/can net/can/can-raw drivers/net/can/dev/can-dev drivers/net/can/vcan; do
    insmod "$modules/$module.ko" || echo "cannot load $module"
done
ip link set lo up
# systemd leaves this to a container manager where the host is a container; credentials need it.
mount --make-rshared /
# As docs/deploy.md says, but for pip: what it would have put there is brought along or bound.
cp -a "$VCAN_JOB/opt" /opt/traction-gateway
while read -r from to; do
    mkdir -p "/opt/traction-gateway/$to" && mount --bind "$from" "/opt/traction-gateway/$to"
done <"$VCAN_JOB/binds"
cp -a "$VCAN_JOB/etc" /etc/traction-gateway
cp "$VCAN_JOB"/units/* /etc/systemd/system
cat >/run/systemd/system/job.service <<UNIT
[Unit]
Requires=sysinit.target
After=sysinit.target
[Service]
Type=oneshot
ExecStart=/bin/sh -c 'sh $VCAN_JOB/run.sh >$VCAN_JOB/output 2>&1; echo \$\$? >$VCAN_JOB/exit.part'
ExecStopPost=/bin/mv $VCAN_JOB/exit.part $VCAN_JOB/exit
ExecStopPost=/sbin/poweroff -f
UNIT
# Not for a guest: what would want to write to the host, and a hundred terminals that take udev
# seconds.
for unit in systemd-remount-fs.service systemd-tmpfiles-setup.service \
    systemd-tmpfiles-setup-dev.service systemd-update-utmp.service systemd-random-seed.service \
    systemd-journal-flush.service systemd-sysusers.service systemd-machine-id-commit.service \
    systemd-udev-trigger.service local-fs.target; do
    ln -s /dev/null "/run/systemd/system/$unit"
done
exec /lib/systemd/systemd --unit=job.service --log-target=journal-or-kmsg --show-status=0 \
    >/dev/console 2>&1
