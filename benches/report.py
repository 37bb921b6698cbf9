"""Rewrites the tables between markers in a Markdown file from what benches/report.sh measured.

Usage: report.py DIRECTORY FILE. A table whose measurements are missing stays as it is.
"""

import json
import re
import sys
from pathlib import Path


def number(value) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        return " x ".join(map(str, value))
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"
    return f"{value:,}" if isinstance(value, int) and value >= 10_000 else str(value)


def table(rows: list[dict], columns: dict[str, str]) -> str:
    """Rows of `rows`, the columns being those of `columns` under its names."""
    lines = ["| " + " | ".join(columns.values()) + " |", "|" + "---|" * len(columns)]
    lines += ["| " + " | ".join(number(row.get(key)) for key in columns) + " |" for row in rows]
    return "\n".join(lines)


def conditions(report: dict) -> str:
    machine = report["machine"]
    cores = f"{machine['cores']} cores"
    versions = "".join(f", {name} {version}" for name, version in report.get("versions", {}).items())
    return f"{machine['cpu']}, {cores}, Linux {machine['kernel']}{versions}; load average before: " \
           f"{number(machine['load_average'])}."


def measured(report: dict, columns: dict[str, str]) -> str:
    return f"{table(report['rows'], columns)}\n\n{conditions(report)}"


def network(row: dict) -> tuple:
    return row["inputs"], row["conv"], *row["hidden"], row["batch"]


def peers(step: dict, *others: dict) -> str:
    """The step beside those of other libraries."""
    rows = []
    for row in step["rows"]:
        if row["isa"] != step["machine"]["isa"] or row["algo"] != "dqn":
            continue
        line = {"inputs": row["inputs"], "conv": row["conv"], "hidden": row["hidden"], "batch": row["batch"], "us": row["us"]}
        for other in others:
            for found in other["rows"]:
                if network(found) == network(row):
                    name = f"{other['name']}_{found['how']}"
                    line[name] = found["us"]
                    line[f"{name}_ratio"] = found["us"] / row["us"]
        rows.append(line)
    columns = {"inputs": "inputs", "conv": "convolution", "hidden": "hidden", "batch": "batch", "us": "Trestle, us"}
    for key, title in (("step_torch_eager", "PyTorch eager"), ("step_torch_compiled", "PyTorch compiled"),
                       ("step_jax_jit", "JAX jit")):
        if any(key in row for row in rows):
            columns |= {key: f"{title}, us", f"{key}_ratio": "times ours"}
    notes = "\n\n".join(conditions(report) for report in (step, *others))
    return f"{table(rows, columns)}\n\n{notes}"


def whole_runs(report: dict) -> str:
    by = {(row["algo"], row["mode"]): row["steps_per_s"] for row in report["rows"]}
    rows = [{"algo": algo, **{mode: by[algo, mode] for mode in ("reference", "lockstep", "free")},
             "ratio": by[algo, "lockstep"] / by[algo, "reference"],
             "of_dqn": by[algo, "lockstep"] / by["dqn", "lockstep"]} for algo in ("dqn", "ha-diiqn")]
    columns = {"algo": "algorithm", "reference": "reference, steps/s", "lockstep": "lockstep, steps/s", "free": "free, steps/s",
               "ratio": "lockstep / reference", "of_dqn": "lockstep / DQN's"}
    return f"{table(rows, columns)}\n\n{conditions(report)}"


def against_sb3(report: dict) -> str:
    row = {"sb3": report["median_sb3_steps_per_s"], "trestle": report["median_trestle_steps_per_s"],
           "ratio": report["median_ratio"], "cpu": report["median_cpu_ratio"]}
    columns = {"sb3": "Stable-Baselines3, steps/s", "trestle": "Trestle, steps/s", "ratio": "ratio",
               "cpu": "ratio by CPU time"}
    loads = [run[side]["load_average_before"] for run in report["runs"] for side in ("sb3", "trestle")]
    versions = ", ".join(f"{name} {version}" for name, version in report["versions"].items())
    return f"{table([row], columns)}\n\n{report['cpu_model']}, CPUs {report['cpus']}, Linux {report['kernel']}, " \
           f"{versions}; load average before the runs: {min(loads)} to {max(loads)}."


def minatar(report: dict) -> str:
    """Whole loops on MinAtar's Breakout; ratios are to Stable-Baselines3."""
    names = {"sb3": "Stable-Baselines3", "cleanrl": "a loop like CleanRL's", "trestle": "Trestle", "trestle_lag": "Trestle, `run.lag = 1`"}
    rows = [{"loop": title, "steps": report[name], "ratio": report.get(f"{name}_ratio", 1.0), "cpu_us": report[f"{name}_cpu_us"],
             "cpu_ratio": report.get(f"{name}_cpu_ratio", 1.0)} for name, title in names.items()]
    columns = {"loop": "loop", "steps": "steps/s", "ratio": "ratio", "cpu_us": "CPU us a step", "cpu_ratio": "ratio by CPU time"}
    return f"{table(rows, columns)}\n\n{conditions(report)}"


def sampling(ours: dict, theirs: dict) -> str:
    """Drawing from a large replay beside cpprb."""
    rows = []
    for other in theirs["rows"]:
        size = 1 if other["element"] == "u8" else 4
        for row in ours["rows"]:
            if (row["op"], row["dim"], row["bytes"], row["stored"]) == ("sample", other["dim"], size, other["stored"]):
                rows.append(row | {"cpprb": other["ns"], "ratio": other["ns"] / row["ns"]})
    columns = {"dim": "features", "bytes": "bytes each", "stored": "stored", "ns": "Trestle, ns", "cpprb": "cpprb, ns", "ratio": "times ours"}
    return f"{table(rows, columns)}\n\n{conditions(ours)}\n\n{conditions(theirs)}"


# Of each table: the measurements that it needs, and how it is made of them.
TABLES = {
    "step": (["step"], lambda step: measured(step, {
        "algo": "algorithm", "inputs": "inputs", "conv": "convolution", "hidden": "hidden", "batch": "batch", "isa": "instructions", "us": "us",
        "limit_us": "limit, us", "times_limit": "times the limit", "peak_gflops": "peak, GFLOP/s"})),
    "threads": (["threads"], lambda threads: measured(threads, {
        "inputs": "inputs", "conv": "convolution", "hidden": "hidden", "batch": "batch", "threads": "threads", "us": "us",
        "gain": "times as fast as one", "round_trip_ns": "round trip, ns"})),
    "peers": (["step", "step_torch", "step_jax"], peers),
    "infer": (["infer"], lambda infer: measured(infer, {
        "inputs": "inputs", "hidden": "hidden", "isa": "instructions", "us": "us"})),
    "replay": (["replay"], lambda replay: measured(replay, {
        "op": "operation", "dim": "features", "bytes": "bytes each", "stored": "stored", "ns": "ns a transition"})),
    "mentor": (["mentor"], lambda mentor: measured(mentor, {
        "op": "operation", "dim": "features", "mentor": "mentor transitions", "stored": "stored", "states": "states", "ns": "ns",
        "naive_ns": "naive, ns"})),
    "tick": (["tick"], lambda tick: measured(tick, {
        "actors": "actors", "rollout": "rollout", "placement": "placement", "us": "us", "socket_us": "Unix sockets, us", "ratio": "ratio",
        "sleeps": "sleeps", "socket_sleeps": "sleeps over sockets"})),
    "message": (["message"], lambda message: measured(message, {
        "batch": "batch", "ns": "ns a transition", "socket_ns": "Unix socket, ns", "ratio": "ratio"})),
    "weights": (["weights"], lambda weights: measured(weights, {
        "subscribers": "actors", "us": "us", "socket_us": "Unix sockets, us", "ratio": "ratio"})),
    "idle": (["idle"], lambda idle: measured(idle, {"role": "process", "cpu_percent": "% of a core"})),
    "memory": (["memory"], lambda memory: measured(memory, {
        "algo": "algorithm", "replay": "replay", "processes": "processes", "peak_mb": "at most, MB",
        "replay_bytes_each": "bytes a stored transition"})),
    "loop": (["loop"], whole_runs),
    "demonstration": (["demonstration"], lambda runs: measured(runs, {
        "mentor": "mentor transitions", "env_steps": "environment steps", "steps_per_cpu_s": "steps per CPU second", "relative": "relative to ten"})),
    "sampling": (["replay", "sampling"], sampling),
    "minatar": (["minatar"], minatar),
    "slopes": (["slopes"], lambda slopes: measured(slopes, {
        "quantity": "quantity", "cost": "cost", "size": "size", "us": "us", "expected": "expected slope", "slope": "slope"})),
    "maze30": (["maze30"], against_sb3),
}


def main() -> None:
    directory, file = map(Path, sys.argv[1:])
    text = file.read_text(encoding="utf-8")
    for name, (needs, make) in TABLES.items():
        paths = [directory / f"{need}.json" for need in needs]
        if missing := [str(path) for path in paths if not path.exists()]:
            print(f"{name}: not measured ({', '.join(missing)}); its table stays", file=sys.stderr)
            continue
        content = make(*(json.loads(path.read_text(encoding="utf-8")) for path in paths))
        marker = re.compile(rf"(<!-- {name}: [^>]*-->\n).*?(<!-- end -->)", re.DOTALL)
        text, found = marker.subn(lambda m: f"{m[1]}{content}\n{m[2]}", text)
        if found != 1:
            raise SystemExit(f"{file} has {found} places for the table {name}; expected: 1")
    file.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
