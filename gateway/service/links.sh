#!/bin/sh
# Sets up one CAN interface, for traction-gateway-links@.service: `links.sh can0`. Needs CAP_NET_ADMIN.
# TYPE, BITRATE and the rest come from /etc/traction-gateway/NAME.env; an interface that is up is
# left alone, so that a restart of the gateway does not interrupt the bus.
set -eu
name=$1

# What the gateway asks for its socket, so that a burst is not lost: 8 MiB of frames unread.
wanted=${RECEIVE_BUFFER:-8388608}
if [ "$(sysctl -n net.core.rmem_max)" -lt "$wanted" ]; then
    sysctl -q -w net.core.rmem_max="$wanted"
fi

if [ "${TYPE:-can}" = vcan ] && ! ip link show dev "$name" >/dev/null 2>&1; then
    ip link add dev "$name" type vcan
fi
if ! state=$(ip link show dev "$name" 2>/dev/null); then
    echo "$name is not there; this is run again when it comes"
    exit 0
fi
case $state in
*[\<,]UP[,\>]*)
    echo "$name is up: left as it is"
    exit 0
    ;;
esac

if [ "${TYPE:-can}" = vcan ]; then
    [ -z "${DATA_BITRATE:-}" ] || ip link set dev "$name" mtu 72
else
    : "${BITRATE:?set BITRATE (bit/s) for $name in /etc/traction-gateway/$name.env}"
    # restart-ms: after a bus-off the controller comes back by itself, the gateway sees and says it.
    # berr-reporting: error frames tell the state of the bus; some controllers cannot.
    set -- bitrate "$BITRATE" restart-ms "${RESTART_MS:-100}"
    [ -z "${DATA_BITRATE:-}" ] || set -- "$@" dbitrate "$DATA_BITRATE" fd on
    ip link set dev "$name" type can "$@" berr-reporting on ||
        ip link set dev "$name" type can "$@"
fi
# A short queue: what waits in it while the bus stalls leaves stale.
ip link set dev "$name" txqueuelen "${TXQUEUELEN:-16}"
ip link set dev "$name" up
echo "$name is set up"
