"""The gradient step of `trestle-bench step` in JAX, the whole of it under jax.jit, on one thread; prints JSON.

Parameters, target and Adam's state are one pytree that each step takes and returns, its memory donated. Times are
medians of CPU time.
"""

import math
import os

# Before jax is imported: one thread, as everything it is compared with.
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import jax.numpy as jnp

# Handing each step to another thread costs more than the step.
jax.config.update("jax_cpu_enable_async_dispatch", False)

from step_common import (BETA_1, BETA_2, CONV, CONV_BATCH, DENSE, EPSILON, GAMMA, GRID, LEARNING_RATE, REWARD, SIZES, arguments,
                         medians, print_report, row)


def initial(sizes, key):
    if sizes is None:
        (height, width, channels), (outputs, kernel), (hidden, actions) = GRID, CONV, DENSE
        places = (height - kernel + 1) * (width - kernel + 1)
        shapes = ((kernel, kernel, channels, outputs), (places * outputs, hidden), (hidden, actions))
    else:
        inputs, width, outputs = sizes
        shapes = ((inputs, width), (width, width), (width, outputs))
    layers = []
    for shape in shapes:
        key, weights, bias = jax.random.split(key, 3)
        *rows, columns = shape
        bound = math.prod(rows) ** -0.5
        layers.append((jax.random.uniform(weights, shape, minval=-bound, maxval=bound),
                       jax.random.uniform(bias, (columns,), minval=-bound, maxval=bound)))
    return layers


def values(layers, x):
    for weights, bias in layers[:-1]:
        if weights.ndim == 4:
            x = jax.lax.conv_general_dilated(x, weights, (1, 1), "VALID", dimension_numbers=("NHWC", "HWIO", "NHWC"))
            x = jax.nn.relu(x + bias).reshape(x.shape[0], -1)
        else:
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
    shape = GRID if sizes is None else sizes[:1]
    x = jax.random.uniform(keys[1], (batch, *shape), minval=-1.0)
    following = jax.random.uniform(keys[2], (batch, *shape), minval=-1.0)
    actions = jnp.arange(batch) % (DENSE[1] if sizes is None else sizes[2])
    compiled = jax.jit(step, donate_argnums=0)
    zeros = [jax.tree.map(jnp.zeros_like, online) for _ in range(2)]
    state = (online, *zeros, jnp.float32(0.0))

    def run():
        nonlocal state
        state = jax.block_until_ready(compiled(state, target, x, following, actions))

    return run


def main() -> None:
    args = arguments(__doc__)
    cases = {(sizes, batch): make_step(sizes, batch) for sizes, batch in (*SIZES, (None, CONV_BATCH))}
    found = medians(cases, args.quick)
    print_report("step_jax", {"jax": jax.__version__}, [
        row(sizes, batch, "jit", us)
        for (sizes, batch), us in found.items()
    ])


if __name__ == "__main__":
    main()
