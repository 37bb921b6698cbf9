"""Speed of Stable-Baselines3's DQN on maze30 with the settings of actor/src/env/maze/presets/maze30.toml; prints JSON.

Its plain DQN has no Double target: next actions are chosen and valued by the target network. For equal work run
Trestle with learner.double=false. It also always clips the gradient's norm, here at its default of 10, so give
Trestle learner.max_grad_norm=10.
"""

import argparse
import json
import platform
import time
import tomllib
from pathlib import Path

import gymnasium
import numpy as np
import stable_baselines3
import torch
from stable_baselines3 import DQN

from maze_env import Maze, check

ROOT = Path(__file__).resolve().parents[2]
MAX_GRAD_NORM = 10.0


def preset() -> dict:
    """The preset, refused if it asks for what the peer below would not do."""
    settings = tomllib.loads((ROOT / "actor/src/env/maze/presets/maze30.toml").read_text(encoding="utf-8"))
    env, learner = settings["env"], settings["learner"]
    asked = (env["maze"]["map"], env["maze"]["actions"], env["encoding"], learner["target"])
    if asked != ("maze30", "irregular", "coordinates", "polyak"):
        raise SystemExit(f"preset maze30 has map, actions, encoding, target = {asked}, which is not implemented here")
    return settings


def build(maze: Maze, settings: dict, steps: int, seed: int) -> DQN:
    """SB3's DQN; what is not named here is its default, which agrees with Trestle's (Adam, Huber loss at 1)."""
    learner, exploration = settings["learner"], settings["exploration"]
    return DQN(
        "MlpPolicy",
        maze,
        policy_kwargs={"net_arch": learner["hidden"], "activation_fn": torch.nn.ReLU},
        learning_rate=learner["lr"],
        gamma=learner["gamma"],
        batch_size=learner["batch"],
        buffer_size=learner["replay"],
        learning_starts=learner["warmup"],
        train_freq=learner["train_every"],
        gradient_steps=1,
        tau=learner["tau"],
        # SB3 counts environment steps here. One update a gradient step, as Trestle does it, is therefore one every
        # train_freq steps; an interval of 1 would be four times the work.
        target_update_interval=learner["train_every"],
        max_grad_norm=MAX_GRAD_NORM,
        exploration_initial_eps=exploration["epsilon_start"],
        exploration_final_eps=exploration["epsilon_end"],
        # A share of all steps, above 1 if the run ends before the schedule does.
        exploration_fraction=exploration["epsilon_decay_steps"] / steps,
        seed=seed,
        device="cpu",
        verbose=0,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env-steps", type=int, default=60_000, help="environment steps to train for")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_num_interop_threads(1)

    settings = preset()
    learner = settings["learner"]
    if args.env_steps <= learner["warmup"] or args.env_steps % learner["train_every"] != 0:
        parser.error(f"--env-steps {args.env_steps}; accepted: multiples of {learner['train_every']} above "
                     f"{learner['warmup']}")
    map_file = ROOT / "actor/maps/maze30.txt"
    check(map_file, settings["env"]["step_limit"])
    model = build(Maze(map_file, settings["env"]["step_limit"]), settings, args.env_steps, args.seed)

    wall, cpu = time.perf_counter(), time.process_time()
    model.learn(total_timesteps=args.env_steps)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu

    if model.num_timesteps != args.env_steps:
        raise SystemExit(f"{model.num_timesteps} environment steps were taken; expected: {args.env_steps}")
    print(json.dumps({
        "steps_per_s": args.env_steps / wall,
        "env_steps": args.env_steps,
        "grad_steps": model._n_updates,
        "wall_s": wall,
        "cpu_s": cpu,
        "torch_threads": torch.get_num_threads(),
        "versions": {
            "stable_baselines3": stable_baselines3.__version__,
            "gymnasium": gymnasium.__version__,
            "torch": torch.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
    }))


if __name__ == "__main__":
    main()
