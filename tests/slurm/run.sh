#!/usr/bin/env bash
# A sweep on a real SLURM: controller and node on this machine, an array of six runs, one task cancelled, one requeued in the middle.
# All results must equal those of a local sweep.
#
#   tests/slurm/run.sh [--time-limit] [PROGRAM]      PROGRAM: target/debug/trestle unless given
#
# With --time-limit the warning comes from a time limit of a minute, which takes some minutes more; otherwise from `scancel`.
# Needs Debian's slurm-wlm and munge, and root. Everything else is in a directory that goes again. Status 77: SLURM does not come up here.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/../.."
limit=
if [[ ${1:-} == --time-limit ]]; then
    limit=--time-limit
    shift
fi
program=$(realpath "${1:-target/debug/trestle}")

place=$(mktemp -d)
daemons=()
end() {
    for daemon in "${daemons[@]}"; do
        kill "$daemon" 2>/dev/null || true
        wait "$daemon" 2>/dev/null || true
    done
    rm -rf "$place"
}
trap end EXIT

host=$(hostname -s)
mkdir -p "$place"/{state,spool,munge}
dd if=/dev/urandom of="$place/munge/key" bs=1024 count=1 status=none
chmod 700 "$place/munge"
chmod 400 "$place/munge/key"
cat > "$place/slurm.conf" <<CONF
ClusterName=trestle
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$place/munge/socket
CredType=cred/munge
SlurmctldPort=16817
SlurmdPort=16818
StateSaveLocation=$place/state
SlurmdSpoolDir=$place/spool
SlurmctldPidFile=$place/slurmctld.pid
SlurmdPidFile=$place/slurmd.pid
SlurmctldLogFile=$place/slurmctld.log
SlurmdLogFile=$place/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=bf_interval=2,sched_interval=2
KillWait=30
ReturnToService=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN
PartitionName=all Nodes=$host Default=YES MaxTime=INFINITE State=UP OverSubscribe=NO
CONF
export SLURM_CONF="$place/slurm.conf"

munged --foreground --force --key-file="$place/munge/key" --socket="$place/munge/socket" --pid-file="$place/munge/pid" \
    --log-file="$place/munge/log" --seed-file="$place/munge/seed" >"$place/munged.out" 2>&1 &
daemons+=($!)
for _ in $(seq 100); do
    [[ -S $place/munge/socket ]] && break
    sleep 0.1
done
slurmctld -D >"$place/slurmctld.out" 2>&1 &
daemons+=($!)
slurmd -D -N "$host" >"$place/slurmd.out" 2>&1 &
daemons+=($!)
for _ in $(seq 300); do
    [[ $(sinfo --noheader --format=%T 2>/dev/null) == idle ]] && break
    sleep 0.1
done
if [[ $(sinfo --noheader --format=%T) != idle ]]; then
    sinfo >&2
    cat "$place"/*.out "$place"/*.log >&2
    echo 'SLURM does not come up on this machine' >&2
    exit 77
fi
python3 "$here/sweep.py" $limit "$program" "$place"
