"""The gradient step of `trestle-bench step` in JAX, the whole of it under jax.jit, on one thread; prints JSON.

Parameters, target and Adam's state are one pytree that each step takes and returns, its memory donated. Times are
medians of CPU time.
"""

import os

# Before jax is imported: one thread, as everything it is compared with.
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import jax.numpy as jnp

# Handing each step to another thread costs more than the step.
jax.config.update("jax_cpu_enable_async_dispatch", False)

from step_common import BETA_1, BETA_2, EPSILON, GAMMA, LEARNING_RATE, REWARD, SIZES, arguments, medians, print_report


def initial(sizes, key):
    inputs, width, outputs = sizes
    layers = []
    for rows, columns in ((inputs, width), (width, width), (width, outputs)):
        key, weights, bias = jax.random.split(key, 3)
        bound = rows ** -0.5
        layers.append((jax.random.uniform(weights, (rows, columns), minval=-bound, maxval=bound),
                       jax.random.uniform(bias, (columns,), minval=-bound, maxval=bound)))
    return layers


def values(layers, x):
    for weights, bias in layers[:-1]:
        x = jax.nn.relu(x @ weights + bias)
    weights, bias = layers[-1]
    return x @ weights + bias


def step(state, target, x, following, actions):
    online, mean, square, count = state
    wanted = REWARD + GAMMA * values(target, following).max(axis=1)

    def loss(layers):
        error = values(layers, x)[jnp.arange(x.shape[0]), actions] - wanted
        size = jnp.abs(error)
        return jnp.mean(jnp.where(size <= 1.0, 0.5 * error * error, size - 0.5))

    grad = jax.grad(loss)(online)
    count = count + 1
    mean = jax.tree.map(lambda m, g: BETA_1 * m + (1 - BETA_1) * g, mean, grad)
    square = jax.tree.map(lambda v, g: BETA_2 * v + (1 - BETA_2) * g * g, square, grad)
    size, root = LEARNING_RATE / (1 - BETA_1 ** count), jnp.sqrt(1 - BETA_2 ** count)
    online = jax.tree.map(lambda p, m, v: p - size * m / (jnp.sqrt(v) / root + EPSILON), online, mean, square)
    return online, mean, square, count


def make_step(sizes, batch: int):
    keys = jax.random.split(jax.random.key(1), 3)
    online = initial(sizes, keys[0])
    target = jax.tree.map(jnp.copy, online)
    x = jax.random.uniform(keys[1], (batch, sizes[0]), minval=-1.0)
    following = jax.random.uniform(keys[2], (batch, sizes[0]), minval=-1.0)
    actions = jnp.arange(batch) % sizes[2]
    compiled = jax.jit(step, donate_argnums=0)
    zeros = [jax.tree.map(jnp.zeros_like, online) for _ in range(2)]
    state = (online, *zeros, jnp.float32(0.0))

    def run():
        nonlocal state
        state = jax.block_until_ready(compiled(state, target, x, following, actions))

    return run


def main() -> None:
    args = arguments(__doc__)
    cases = {(sizes, batch): make_step(sizes, batch) for sizes, batch in SIZES}
    found = medians(cases, args.quick)
    print_report("step_jax", {"jax": jax.__version__}, [
        {"inputs": sizes[0], "hidden": [sizes[1]] * 2, "batch": batch, "how": "jit", "us": round(us, 2)}
        for (sizes, batch), us in found.items()
    ])


if __name__ == "__main__":
    main()
