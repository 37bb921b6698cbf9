"""Speed of DQN on MinAtar's Breakout in another library, with MinAtar's network and the settings of settings_minatar.py; prints JSON.

`sb3` is Stable-Baselines3's DQN. `cleanrl` is a loop as CleanRL's dqn.py has it: one vectorised environment, a replay of numpy arrays,
PyTorch's modules and Adam.
"""

import argparse
import json
import platform
import random
import time

import gymnasium
import numpy as np
import torch
from minatar.gym import BaseEnv
from torch import nn
from torch.nn import functional

from settings_minatar import (BATCH, CHANNELS, EPSILON, EPSILON_STEPS, GAMMA, HIDDEN, KERNEL, LEARNING_RATE, MAX_GRAD_NORM, REPLAY,
                              TARGET_EVERY, TRAIN_EVERY, WARMUP)


def make() -> gymnasium.Env:
    """Breakout with all that Trestle's side has, too."""
    return gymnasium.wrappers.TimeLimit(BaseEnv(game="breakout"), 10_000)


class Features(nn.Module):
    """The convolution and the hidden layer, of observations `[batch][height][width][channels]`."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        super().__init__()
        height, width, channels = shape
        places = (height - KERNEL + 1) * (width - KERNEL + 1)
        self.layers = nn.Sequential(nn.Conv2d(channels, CHANNELS, KERNEL), nn.ReLU(), nn.Flatten(),
                                    nn.Linear(places * CHANNELS, HIDDEN), nn.ReLU())

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.layers(x.permute(0, 3, 1, 2))


def sb3(steps: int) -> dict[str, str]:
    """Trains, and returns versions."""
    import stable_baselines3
    from stable_baselines3 import DQN
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

    class Extractor(BaseFeaturesExtractor):
        def __init__(self, space: gymnasium.spaces.Box) -> None:
            super().__init__(space, HIDDEN)
            self.features = Features(space.shape)

        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return self.features(x)

    model = DQN(
        "MlpPolicy",
        make(),
        policy_kwargs={"features_extractor_class": Extractor, "net_arch": []},
        learning_rate=LEARNING_RATE,
        batch_size=BATCH,
        buffer_size=REPLAY,
        learning_starts=WARMUP,
        train_freq=TRAIN_EVERY,
        gradient_steps=1,
        gamma=GAMMA,
        tau=1.0,
        target_update_interval=TARGET_EVERY,
        max_grad_norm=MAX_GRAD_NORM,
        exploration_final_eps=EPSILON,
        exploration_fraction=EPSILON_STEPS / steps,
        seed=1,
        device="cpu",
        verbose=0,
    )
    clock = Clock()
    model.learn(total_timesteps=steps)
    return clock.read() | {"version": stable_baselines3.__version__}


class Clock:
    def __init__(self) -> None:
        self.wall, self.cpu = time.perf_counter(), time.process_time()

    def read(self) -> dict[str, float]:
        return {"wall_s": time.perf_counter() - self.wall, "cpu_s": time.process_time() - self.cpu}


def cleanrl(steps: int) -> dict[str, str | float]:
    """Trains, and returns versions."""
    random.seed(1)
    np.random.seed(1)
    torch.manual_seed(1)
    envs = gymnasium.vector.SyncVectorEnv([make])
    shape, actions = envs.single_observation_space.shape, int(envs.single_action_space.n)
    online, target = (nn.Sequential(Features(shape), nn.Linear(HIDDEN, actions)) for _ in range(2))
    target.load_state_dict(online.state_dict())
    adam = torch.optim.Adam(online.parameters(), lr=LEARNING_RATE)
    states, nexts = (np.zeros((REPLAY, *shape), dtype=bool) for _ in range(2))
    taken, rewards, dones = np.zeros(REPLAY, dtype=np.int64), np.zeros(REPLAY, np.float32), np.zeros(REPLAY, np.float32)
    clock = Clock()
    obs, _ = envs.reset(seed=1)
    for step in range(steps):
        epsilon = max(EPSILON, 1.0 + (EPSILON - 1.0) * step / EPSILON_STEPS)
        if random.random() < epsilon:
            action = np.array([envs.single_action_space.sample()])
        else:
            with torch.no_grad():
                action = torch.argmax(online(torch.as_tensor(obs, dtype=torch.float32)), dim=1).numpy()
        following, reward, terminated, _, _ = envs.step(action)
        at = step % REPLAY
        states[at], nexts[at], taken[at], rewards[at], dones[at] = obs[0], following[0], action[0], reward[0], terminated[0]
        obs = following
        if step > WARMUP and step % TRAIN_EVERY == 0:
            drawn = np.random.randint(0, min(step + 1, REPLAY), BATCH)
            with torch.no_grad():
                best = target(torch.as_tensor(nexts[drawn], dtype=torch.float32)).max(dim=1).values
                wanted = torch.as_tensor(rewards[drawn]) + GAMMA * best * (1 - torch.as_tensor(dones[drawn]))
            chosen = torch.as_tensor(taken[drawn]).unsqueeze(1)
            value = online(torch.as_tensor(states[drawn], dtype=torch.float32)).gather(1, chosen).squeeze(1)
            loss = functional.smooth_l1_loss(value, wanted)
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(online.parameters(), MAX_GRAD_NORM)
            adam.step()
        if step % TARGET_EVERY == 0:
            target.load_state_dict(online.state_dict())
    return clock.read() | {"version": "-"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("how", choices=("sb3", "cleanrl"))
    parser.add_argument("--env-steps", type=int, default=20_000, help="environment steps to train for")
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_num_interop_threads(1)
    found = (sb3 if args.how == "sb3" else cleanrl)(args.env_steps)
    versions = {"gymnasium": gymnasium.__version__, "torch": torch.__version__, "python": platform.python_version()}
    if args.how == "sb3":
        versions["stable_baselines3"] = found["version"]
    print(json.dumps({"wall_s": found["wall_s"], "cpu_s": found["cpu_s"], "versions": versions}))


if __name__ == "__main__":
    main()
