"""The settings that DQN has on MinAtar's Breakout on every side: MinAtar's network, a gradient step each step."""

CHANNELS, KERNEL, HIDDEN = 16, 3, 128
BATCH, REPLAY, WARMUP, TRAIN_EVERY = 32, 100_000, 1_000, 1
LEARNING_RATE, GAMMA, TARGET_EVERY, MAX_GRAD_NORM = 2.5e-4, 0.99, 1_000, 10.0
EPSILON, EPSILON_STEPS = 0.1, 10_000

#: The same for Trestle.
TRESTLE = {
    "env.gym.make": "minatar.gym:BaseEnv",
    "env.gym.kwargs": "{game='breakout'}",
    "env.step_limit": "10000",
    "learner.conv": f"[{{channels={CHANNELS},kernel={KERNEL},stride=1}}]",
    "learner.hidden": f"[{HIDDEN}]",
    "learner.batch": str(BATCH),
    "learner.replay": str(REPLAY),
    "learner.warmup": str(WARMUP),
    "learner.train_every": str(TRAIN_EVERY),
    "learner.lr": str(LEARNING_RATE),
    "learner.gamma": str(GAMMA),
    "learner.target": "hard",
    "learner.target_every": str(TARGET_EVERY),
    "learner.max_grad_norm": str(MAX_GRAD_NORM),
    "learner.double": "false",
    "learner.n_step": "1",
    "exploration.epsilon_end": str(EPSILON),
    "exploration.epsilon_decay_steps": str(EPSILON_STEPS),
    # Nothing but training, as on the other sides.
    "eval.every": "1000000",
    "checkpoint.every_env_steps": "0",
    "supervise.silence_s": "600",
    "supervise.stall_s": "600",
}
