"""Speed of Stable-Baselines3's DQN on CartPole with the settings that `gym:CartPole-v1` stands for; prints JSON."""

import argparse
import json
import platform
import time
import tomllib
from pathlib import Path

import gymnasium
import stable_baselines3
import torch
from stable_baselines3 import DQN

ROOT = Path(__file__).resolve().parents[2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env-steps", type=int, default=20_000, help="environment steps to train for")
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_num_interop_threads(1)
    settings = tomllib.loads((ROOT / "actor/src/env/gym/defaults.toml").read_text(encoding="utf-8"))
    learner, exploration = settings["learner"], settings["exploration"]
    model = DQN(
        "MlpPolicy",
        gymnasium.make("CartPole-v1"),
        policy_kwargs={"net_arch": learner["hidden"], "activation_fn": torch.nn.ReLU},
        learning_rate=learner["lr"],
        batch_size=learner["batch"],
        buffer_size=learner["replay"],
        learning_starts=learner["warmup"],
        train_freq=learner["train_every"],
        gradient_steps=1,
        tau=learner["tau"],
        target_update_interval=1,
        max_grad_norm=learner["max_grad_norm"],
        exploration_initial_eps=1.0,
        exploration_final_eps=exploration["epsilon_end"],
        exploration_fraction=exploration["epsilon_decay_steps"] / args.env_steps,
        seed=1,
        device="cpu",
        verbose=0,
    )
    wall, cpu = time.perf_counter(), time.process_time()
    model.learn(total_timesteps=args.env_steps)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(json.dumps({
        "wall_s": wall,
        "cpu_s": cpu,
        "versions": {
            "stable_baselines3": stable_baselines3.__version__,
            "gymnasium": gymnasium.__version__,
            "torch": torch.__version__,
            "python": platform.python_version(),
        },
    }))


if __name__ == "__main__":
    main()
