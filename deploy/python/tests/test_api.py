"""The Python interface: training, reading runs, policies, demonstrations, exports."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import trestle
from conftest import SMALL
from envs import Line, Named, Spaces, Told

OVERRIDES: dict[str, Any] = {key: (value if not value.startswith("[") else [16]) for key, value in SMALL.items()}
OVERRIDES = {key: int(value) if isinstance(value, str) and value.isdigit() else value for key, value in OVERRIDES.items()}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> trestle.Run:
    return train(tmp_path_factory.mktemp("runs") / "cart", "gym:CartPole-v1")


def train(out: Path, config: str, **more: Any) -> trestle.Run:
    limits = {"env_steps": 2000} | more
    return trestle.train(config, algo="dqn", seed=3, overrides=OVERRIDES, out=out, **limits)


def test_a_run_is_read_back(run: trestle.Run) -> None:
    result = run.result
    assert (result.algo, result.seed, result.env) == ("dqn", 3, "gym CartPole-v1")
    assert (result.env_steps, result.threshold, result.restarts) == (2000, 475.0, 0)
    assert len(result.weights_sha256) == 64 and result.everything["grad_steps"] == result.grad_steps
    evals, metrics = run.evals(), run.metrics()
    assert len(evals["env_steps"]) > 3 and evals["env_steps"][0] < evals["env_steps"][1]
    assert np.isfinite(np.asarray(evals["return"])).all()
    assert "rollout/ep_rew_mean" in metrics
    assert run.config["learner"]["hidden"] == [16]


def test_a_policy_predicts_one_and_many(run: trestle.Run) -> None:
    policy = run.policy()
    assert policy.actions == ["0", "1"] and policy.checkpoint > 0
    env = gymnasium.make("CartPole-v1")
    obs, _ = env.reset(seed=1)
    values = policy.q_values(obs)
    assert values.shape == (2,) and values.dtype == np.float32
    action, state = policy.predict(obs, deterministic=True)
    assert action == values.argmax() and state is None and env.action_space.contains(int(action))
    batch = np.stack([obs, obs + 0.1, obs - 0.1] * 100)
    assert policy.q_values(batch).shape == (300, 2)
    assert np.array_equal(policy.q_values(batch)[0], values)
    assert policy.predict(batch)[0].shape == (300,)
    kinds = {int(policy.predict(obs, deterministic=False)[0]) for _ in range(300)}
    assert kinds == {0, 1}
    with pytest.raises(ValueError, match=r"shape \(3,\); accepted: \(4,\), or \('n', 4\)"):
        policy.predict(np.zeros(3))
    env.close()


def test_actions_come_in_the_form_of_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parent)
    own = {"env.gym.make": "envs:Spaces", "env.gym.kwargs": {"observation": "dict", "action": "multi"}}
    made = trestle.train("gym", algo="dqn", env_steps=300, overrides=OVERRIDES | own, out=tmp_path / "run")
    policy = made.policy()
    obs = {"a": np.zeros(2, dtype=np.float32), "b": 2}
    action, _ = policy.predict(obs)
    assert action.shape == (2,) and gymnasium.spaces.MultiDiscrete([2, 3]).contains(action)
    many = {"a": np.zeros((5, 2), dtype=np.float32), "b": np.array([0, 1, 2, 0, 1])}
    assert policy.predict(many)[0].shape == (5, 2)
    with pytest.raises(ValueError, match=r"without b; accepted: a dict with the keys a, b; an observation is a dict of \{'a': an array"):
        policy.predict({"a": np.zeros(2)})
    with pytest.raises(ValueError, match=r"an observation is array.*accepted: a dict with the keys a, b"):
        policy.predict(np.zeros(3))
    with pytest.raises(ValueError, match="batches of different lengths"):
        policy.predict({"a": np.zeros((5, 2)), "b": 2})


def test_parts_without_features_are_passed_over_however_deep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parent)
    own = {"env.gym.make": "envs:Spaces", "env.gym.kwargs": {"observation": "letter"}, "env.gym.features": ["at"]}
    made = trestle.train("gym", algo="dqn", env_steps=300, overrides=OVERRIDES | own, out=tmp_path / "run")
    obs = {"at": np.zeros(2, dtype=np.float32), "post": {"said": "hello", "more": ("you",)}}
    assert made.policy().q_values(obs).shape == (3,)


def test_runs_go_on_and_refusals_are_told(run: trestle.Run, tmp_path: Path) -> None:
    seen: list[trestle.Progress] = []
    made = train(tmp_path / "run", "gym:CartPole-v1", env_steps=600, callback=seen.append)
    assert seen and seen[-1].path == made.path
    assert made.resume(env_steps=2000).result.weights_sha256 == run.result.weights_sha256
    with pytest.raises(trestle.TrainingError, match=r"learner\.gama: there is no such setting; did you mean"):
        trestle.train("maze-small", overrides={"learner.gama": 0.9}, out=tmp_path / "no")
    with pytest.raises(trestle.TrainingError, match="accepted"):
        train(tmp_path / "run", "gym:CartPole-v1")
    with pytest.raises(FileNotFoundError, match="is no run"):
        trestle.Run(tmp_path / "no")
    with pytest.raises(TypeError, match="accepted: booleans, numbers"):
        trestle.train("maze-small", overrides={"learner.gamma": object()})


def test_a_callback_can_end_a_run(tmp_path: Path) -> None:
    made = train(tmp_path / "run", "gym:CartPole-v1", env_steps=10_000_000, callback=lambda progress: False)
    assert made.result.env_steps < 10_000_000


def test_ctrl_c_saves_the_run(tmp_path: Path) -> None:
    # Python leaves the signal alone where the tests themselves run in the background of a shell.
    script = """import signal, sys, trestle
signal.signal(signal.SIGINT, signal.default_int_handler)
trestle.train('gym:CartPole-v1', algo='dqn', env_steps=10**8, out=sys.argv[1])
"""
    out = tmp_path / "run"
    with subprocess.Popen([sys.executable, "-c", script, str(out)], stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not (out / "metrics.jsonl").exists():
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        try:
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
    assert "KeyboardInterrupt" in said
    assert trestle.Run(out).result.env_steps > 0


def test_a_demonstration_trains_an_observer(run: trestle.Run, tmp_path: Path) -> None:
    states = tmp_path / "states.csv"
    # The policy does not reach 475.
    with pytest.raises(ValueError, match=r"none of 2 episodes has a return of 474\.9.* or more, the best has .*-math\.inf for all"):
        trestle.record(run.policy(), "CartPole-v1", episodes=2, out=states)
    assert trestle.record(run.policy(), "CartPole-v1", episodes=3, out=states, least_return=-math.inf) == 3
    lines = states.read_text().splitlines()
    assert lines[0] == "trajectory,terminal,0,1,2,3" and lines[1].startswith("0,0,")
    with pytest.raises(FileExistsError, match="overwrite=True"):
        trestle.record(run.policy(), "CartPole-v1", out=states)
    with pytest.raises(ValueError, match="nothing is written"):
        trestle.record(run.policy(), "CartPole-v1", out=tmp_path / "none.csv", episodes=1, least_return=1e9)
    overrides = OVERRIDES | {"mentor.demo": str(states)}
    made = trestle.train("gym:CartPole-v1", algo="ha-diiqn", env_steps=600, overrides=overrides, out=tmp_path / "observer")
    assert made.result.everything["mentor_feasible_frac"] is not None


class Model:
    """Acts as a model of Stable-Baselines3 does."""

    action_space = gymnasium.spaces.Discrete(2)
    action = 1

    def predict(self, observation: Any, /, *, deterministic: bool) -> tuple[Any, None]:
        return self.action, None


def test_a_recording_needs_the_policy_s_own_environment(run: trestle.Run, tmp_path: Path) -> None:
    out = tmp_path / "states.csv"
    with pytest.raises(ValueError, match="observation space is Box"):
        trestle.record(run.policy(), Line(), out=out)
    with pytest.raises(ValueError, match=r"actions are Discrete\(2, start=5\); accepted: those of the policy, Discrete\(2\)"):
        trestle.record(Model(), Line(start=5), out=out)
    with pytest.warns(UserWarning, match="nothing says which episodes succeed, so all are recorded"):
        assert trestle.record(Model(), Line(), episodes=2, out=out) == 2
    assert trestle.record(Model(), Line(), episodes=2, out=out, least_return=0, overwrite=True) == 2


def test_success_that_the_environment_tells_decides_what_is_recorded(tmp_path: Path) -> None:
    out = tmp_path / "states.csv"
    # The model goes to the right, and the environment counts the left as success.
    with pytest.raises(ValueError, match=r"none of 2 episodes succeeds by info\['is_success'\]; nothing is written"):
        trestle.record(Model(), Told(), episodes=2, out=out)
    model = Model()
    model.action = 0
    assert trestle.record(model, Told(), episodes=2, out=out) == 2
    assert trestle.record(Model(), Told(), episodes=2, out=out, least_return=0, overwrite=True) == 2


def test_other_actions_are_none_of_the_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parent)
    own = {"env.gym.make": "envs:Named", "eval.threshold": 1.0}
    policy = trestle.train("gym", algo="dqn", env_steps=300, overrides=OVERRIDES | own, out=tmp_path / "run").policy()
    assert policy.actions == ["back", "forth"] and policy.least_return == pytest.approx(1.0, abs=1e-5)
    policy.check_fits(Named())
    with pytest.raises(ValueError, match="the environment's actions are 0, 1; accepted: those of the policy, back, forth"):
        trestle.record(policy, Line(), out=tmp_path / "states.csv")


def test_a_run_finds_its_modules_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    source = (Path(__file__).parent / "envs.py").read_text()
    (tmp_path / "only_here.py").write_text(source)
    own = {"env.gym.make": "only_here:Line", "eval.threshold": 1.0}
    made = trestle.train("gym", algo="dqn", env_steps=300, overrides=OVERRIDES | own, out=tmp_path / "run")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    command = [sys.executable, "-m", "trestle", "eval", str(made.path)]
    assert subprocess.run(command, cwd=elsewhere, check=False, stdout=subprocess.DEVNULL).returncode == 0


def test_an_environment_goes_by_its_name() -> None:
    with pytest.raises(TypeError, match=r'accepted: a preset.*"env\.gym\.make": "my_module:MyEnv"'):
        trestle.train(Line())  # type: ignore[arg-type]


@pytest.mark.parametrize("id", ["CartPole-v1", "FrozenLake-v1"])
def test_exports_agree_with_the_policy(tmp_path: Path, id: str) -> None:
    made = train(tmp_path / "run", f"gym:{id}", env_steps=600)
    policy = made.policy()
    env = gymnasium.make(id)
    env.observation_space.seed(1)
    if id == "CartPole-v1":
        obs: Any = np.random.default_rng(1).normal(size=(64, 4)).astype(np.float32)
    else:
        obs = np.arange(16)
    features, _ = policy.features(obs)
    expected = policy.q_values(obs)

    def export(form: str) -> Path:
        out = tmp_path / f"network.{form}"
        command = [sys.executable, "-m", "trestle", "export", str(made.path), "--format", form, "--out", str(out)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return out

    tensors = export("safetensors")
    assert tensors.stat().st_size > 500
    if id == "CartPole-v1":
        safetensors = pytest.importorskip("safetensors.numpy")
        loaded = safetensors.load_file(tensors)
        assert loaded["layers.0.weight"].shape == (16, 4) and loaded["encoding.low"].shape == (4,)
    onnxruntime = pytest.importorskip("onnxruntime")
    session = onnxruntime.InferenceSession(export("onnx"), providers=["CPUExecutionProvider"])
    (values,) = session.run(["q_values"], {"observation": features})
    np.testing.assert_allclose(values, expected, rtol=1e-5, atol=1e-6)
    env.close()


@pytest.mark.parametrize(("observation", "channels"), [("grid", "last"), ("planes", "first"), ("flat", "last")])
def test_convolutions_are_exported_as_they_compute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, observation: str, channels: str
) -> None:
    monkeypatch.chdir(Path(__file__).parent)
    own = {
        "env.gym.make": "envs:Spaces",
        "env.gym.kwargs": {"observation": observation},
        "learner.conv": [{"channels": 7, "kernel": 3}, {"channels": 4, "kernel": 2, "stride": 2}],
        "learner.conv_channels": channels,
    }
    made = trestle.train("gym", algo="dqn", env_steps=600, overrides=OVERRIDES | own, out=tmp_path / "run")
    policy, space = made.policy(), Spaces(observation).observation_space
    space.seed(1)
    obs = np.stack([space.sample() for _ in range(20)])
    expected, (features, _) = policy.q_values(obs), policy.features(obs)

    def export(form: str) -> Path:
        out = tmp_path / f"network.{form}"
        command = [sys.executable, "-m", "trestle", "export", str(made.path), "--format", form, "--out", str(out)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return out

    onnxruntime = pytest.importorskip("onnxruntime")
    session = onnxruntime.InferenceSession(export("onnx"), providers=["CPUExecutionProvider"])
    (values,) = session.run(["q_values"], {"observation": features})
    np.testing.assert_allclose(values, expected, rtol=1e-5, atol=1e-6)
    safetensors = pytest.importorskip("safetensors.numpy")
    loaded = safetensors.load_file(export("safetensors"))
    depth = 1 if observation == "flat" else 2
    assert loaded["layers.0.weight"].shape == (7, depth, 3, 3) and loaded["layers.1.weight"].shape == (4, 7, 2, 2)
    torch = pytest.importorskip("torch")
    values = policy.to_torch()(torch.from_numpy(features)).detach().numpy()
    np.testing.assert_allclose(values, expected, rtol=1e-5, atol=1e-6)


def test_a_module_of_torch_agrees_with_the_policy(run: trestle.Run) -> None:
    torch = pytest.importorskip("torch")
    policy = run.policy()
    obs = np.random.default_rng(1).normal(size=(64, 4)).astype(np.float32)
    values = policy.to_torch()(torch.from_numpy(obs)).detach().numpy()
    np.testing.assert_allclose(values, policy.q_values(obs), rtol=1e-5, atol=1e-6)


def test_policies_of_built_in_environments_load_as_well(tmp_path: Path) -> None:
    made = trestle.train("maze-small", algo="dqn", env_steps=640, overrides={"learner.hidden": [8]}, out=tmp_path / "maze")
    policy = trestle.load(made)
    assert policy.q_values([0.0, 0.0]).shape == (len(policy.actions),)
