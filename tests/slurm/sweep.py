"""A sweep of six runs on the SLURM that SLURM_CONF names, and the same sweep here: sweep.py [--time-limit] PROGRAM PLACE"""

import csv
import json
import pathlib
import re
import subprocess
import sys
import time

LIMIT_S = 900
# Columns and keys that tell of time and place.
TIMES = {"wall_s", "restarts", "time/time_elapsed"}


def call(*command):
    done = subprocess.run([str(word) for word in command], check=False, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{command}: {done.stdout}{done.stderr}")
    return done.stdout


def until(what, condition):
    start = time.monotonic()
    while not (found := condition()):
        if time.monotonic() - start > LIMIT_S:
            raise SystemExit(f"{what}: not within {LIMIT_S} s\n{call('squeue', '--array')}")
        time.sleep(0.1)
    return found


def signalled(*what):
    """Tasks in the middle of a change take no signal."""
    until(f"scancel {what}", lambda: subprocess.run(["scancel", *what], capture_output=True, check=False).returncode == 0)


def states(job):
    """The state of each task that SLURM still knows."""
    lines = call("squeue", "--array", "--noheader", "--states=all", "--format=%K %T %r", "--job", job).splitlines()
    return {int(task): (state, reason) for task, state, reason in (line.split(maxsplit=2) for line in lines)}


def without(row):
    return {key: value for key, value in row.items() if key not in TIMES}


def comes_to(run):
    """Everything that a run comes to but for times."""
    episodes = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    mentor = run / "mentor.csv"
    return {
        "result": without(json.loads((run / "result.json").read_text())),
        "evaluations": [without(row) for row in csv.DictReader((run / "evals.csv").open())],
        "episodes": [without(row) for row in episodes if "rollout/ep_rew" in row],
        "mentor": mentor.read_text() if mentor.exists() else None,
        "configuration": (run / "config.toml").read_text(),
    }


def main():
    arguments = sys.argv[1:]
    by_limit = arguments[0] == "--time-limit"
    program, place = arguments[by_limit:]
    here, there = pathlib.Path(place) / "here", pathlib.Path(place) / "there"
    steps = "1000000" if by_limit else "120000"
    sweep = ["sweep", "maze30", "--algos", "dqn,ha-diiqn", "--seeds", "0..3", "--env-steps", steps, "--episodes", "1000000",
             "--set", "run.stop_when_solved=false", "--set", "learner.hidden=[16]"]
    runs = [f"{arm}/seed-{seed}" for arm in ("dqn", "ha-diiqn") for seed in range(3)]
    options = "time=1,signal=B:USR1@50" if by_limit else "time=10"
    submit = ["--submit", "slurm", "--slurm", f"cpus=1,{options}", "--out", there]
    job = call(program, *sweep, *submit).strip()
    print(f"job {job}: {states(job)}", flush=True)

    # The first task is cancelled in the middle, and the one beside it is warned.
    for task in (0, 1):
        until(f"task {task} trains", lambda: (there / runs[task] / "evals.csv").exists())
        print(f"task {task} trains: {states(job)}", flush=True)
    signalled(f"{job}_0")
    if not by_limit:
        signalled("--signal=USR1", "--batch", f"{job}_1")
    until("the cancelled task is over", lambda: states(job).get(0, ("GONE", ""))[0] in ("CANCELLED", "GONE"))
    if not (there / runs[0] / "last").exists() or json.loads((there / runs[0] / "result.json").read_text())["interrupted"] is not True:
        raise SystemExit("the cancelled task was not saved in the middle")
    print(f"cancelled: {(there / 'submit' / f'{job}_0.log').read_text()!r}", flush=True)

    requeued = set()

    def over():
        for line in call("scontrol", "show", "job", job).splitlines() if states(job) else []:
            if found := re.search(r"Restarts=([1-9]\d*)", line):
                requeued.add(found[1])
        tasks = states(job)
        for task, (state, reason) in tasks.items():
            # SLURM lets a task that was requeued wait for two minutes.
            if state == "PENDING" and reason == "BeginTime":
                subprocess.run(["scontrol", "update", f"JobId={job}_{task}", "StartTime=now"], capture_output=True, check=False)
        # A task that asks to be requeued looks failed for a moment; one that has failed never gets there.
        return all(state in ("COMPLETED", "CANCELLED") for state, _ in tasks.values())

    until("all tasks are over", over)
    print(f"tasks: {states(job)}; restarts {requeued}", flush=True)
    if not requeued:
        raise SystemExit("no task was requeued")

    # What was cancelled goes on with another job.
    second = call(program, "sweep", "--resume", *submit).strip()
    until("the second job is over", lambda: all(state == "COMPLETED" for state, _ in states(second).values()))
    print(f"job {second}: {states(second)}", flush=True)
    call(program, *sweep, "--quiet", "--out", here)
    for run in runs:
        if comes_to(here / run) != comes_to(there / run):
            differ = [key for key, value in comes_to(here / run).items() if value != comes_to(there / run)[key]]
            raise SystemExit(f"{run}: {differ} differ from the local sweep's")
    print(f"{len(runs)} runs equal those of a local sweep")


if __name__ == "__main__":
    main()
