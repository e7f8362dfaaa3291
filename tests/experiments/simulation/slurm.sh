#!/usr/bin/env bash
# A SLURM of this one machine, for tests, without systemd or cgroups: slurm.sh start|stop FOLDER. All of it stays in the
# FOLDER and on 127.0.0.1; clients find it by SLURM_CONF=FOLDER/slurm.conf. Needs root and Debian's slurmctld, slurmd,
# slurm-client and munge.
set -euo pipefail
folder=$(realpath "$2")

start() {
    local host
    host=$(hostname -s)
    mkdir -p "$folder/munge" "$folder/state" "$folder/spool"
    head -c 128 /dev/urandom >"$folder/munge/key"
    chmod 600 "$folder/munge/key"
    chmod 755 "$folder"
    chown -R munge "$folder/munge"
    runuser -u munge -- munged --force --key-file="$folder/munge/key" --socket="$folder/munge/socket" \
        --pid-file="$folder/munge/pid" --seed-file="$folder/munge/seed" --log-file="$folder/munge/log"
    cat >"$folder/slurm.conf" <<END
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=16817
SlurmdPort=16818
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge/socket
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SwitchType=switch/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc --all) RealMemory=$(awk '/MemTotal/ {print int($2 / 2048)}' /proc/meminfo)
PartitionName=all Nodes=$host Default=YES MaxTime=INFINITE State=UP
END
    slurmctld -f "$folder/slurm.conf"
    slurmd -f "$folder/slurm.conf" -N "$host"
    for _ in $(seq 100); do
        [ "$(SLURM_CONF=$folder/slurm.conf sinfo --noheader --format=%T)" = idle ] && return
        sleep 0.3
    done
    cat "$folder"/*.log >&2
    return 1
}

stop() {
    local pid
    SLURM_CONF=$folder/slurm.conf scancel --user="$(id -un)" || true
    for file in "$folder/slurmd.pid" "$folder/slurmctld.pid" "$folder/munge/pid"; do
        [ -s "$file" ] || continue
        pid=$(cat "$file")
        kill "$pid" 2>/dev/null || true
        while kill -0 "$pid" 2>/dev/null; do sleep 0.1; done
    done
}

"$1"
