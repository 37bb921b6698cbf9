"""Files of other people's tools, each with one trait that readers trip over: makes those in foreign/ beside this file.

Run as `python foreign.py`; the committed files were written with Python 3.11, h5py 3.16.0 and NumPy 2.4.6.

Unless said otherwise a file holds two episodes of three states, (0, 1), (2, 3), (4, 5) and (6, 7), (8, 9), (10, 11).
"""

import pathlib

import h5py
import numpy as np

OUT = pathlib.Path(__file__).parent / "foreign"
STATES = np.arange(12, dtype="f4").reshape(6, 2)
ENDS = np.array([0, 0, 1, 0, 0, 1], bool)
NEVER = np.zeros(6, bool)


def hdf5(name, **options):
    return h5py.File(OUT / f"{name}.hdf5", "w", **options)


def d4rl(file, states=STATES):
    file["observations"] = states
    file["terminals"] = NEVER
    file["timeouts"] = ENDS


def minari(file, number, first):
    """An episode of one step from (first, first + 1)."""
    group = file.create_group(f"episode_{number}")
    group["observations"] = np.array([[first, first + 1], [first + 2, first + 3]], "f4")
    group["terminations"] = np.array([True])
    group["truncations"] = np.array([False])


def links():
    for libver in ("earliest", "latest"):
        with hdf5(f"soft-link-needed-{libver}", libver=libver) as file:
            d4rl(file)
            file.move("observations", "kept")
            file["observations"] = h5py.SoftLink("/kept")
            file["elsewhere"] = h5py.SoftLink("/nothing")
        with hdf5(f"external-link-{libver}", libver=libver) as file:
            d4rl(file)
            file["images"] = h5py.ExternalLink("images.hdf5", "/images")
        with hdf5(f"external-link-needed-{libver}", libver=libver) as file:
            file["observations"] = h5py.ExternalLink("states.hdf5", "/observations")
            file["terminals"] = NEVER
            file["timeouts"] = ENDS
        with hdf5(f"many-links-{libver}", libver=libver) as file:
            kept = file.create_group("kept")
            for i in range(5):
                minari(kept, i, i)
            for i in range(300):
                path = f"kept/episode_{i % 5}"
                file[f"episode_{i}"] = h5py.SoftLink(f"/{path}") if i % 100 == 50 else file[path]
        with hdf5(f"external-episode-{libver}", libver=libver) as file:
            minari(file, 0, 0)
            minari(file, 1, 1)
            file["episode_2"] = h5py.ExternalLink("others.hdf5", "/episode_2")
    with hdf5("soft-link-dangling") as file:
        d4rl(file)
        del file["observations"]
        file["observations"] = h5py.SoftLink("/nothing")
    with hdf5("soft-link-loop", libver="latest") as file:
        d4rl(file)
        del file["observations"]
        file["observations"] = h5py.SoftLink("/states")
        file["states"] = h5py.SoftLink("observations")
    with hdf5("soft-link-to-group") as file:
        group = file.create_group("kept")
        for i in range(2):
            demo = group.create_group(f"demo_{i}")
            demo["obs/joints"] = STATES[3 * i : 3 * i + 3]
            demo["dones"] = np.array([0, 0, 1])
        file["data"] = h5py.SoftLink("kept")
        file["kept/again"] = h5py.SoftLink("/kept")


def storage():
    with hdf5("user-block", userblock_size=1024) as file:
        d4rl(file)
    with open(OUT / "user-block.hdf5", "r+b") as file:
        file.write(b"x,y\n1,2\n")
    with hdf5("user-block-latest", userblock_size=512, libver="latest") as file:
        d4rl(file)
    with hdf5("float16") as file:
        d4rl(file, STATES.astype("f2"))
    with hdf5("float16-big-endian") as file:
        d4rl(file, STATES.astype(">f2"))
    with hdf5("float64-big-endian") as file:
        d4rl(file, STATES.astype(">f8"))
    with hdf5("enumeration") as file:
        d4rl(file)
        del file["timeouts"]
        flags = h5py.enum_dtype({"NO": 0, "YES": 1}, basetype=">i4")
        file.create_dataset("timeouts", data=ENDS.astype("i4"), dtype=flags)
    with hdf5("records") as file:
        fields = [("x", "f4"), ("y", "f8"), ("done", "?")]
        file["log/steps"] = np.array([(x, y, end) for (x, y), end in zip(STATES, ENDS)], fields)
    # Since HDF5 2.0, filtered chunks of the newest format are laid out in a way of their own.
    with hdf5("newest-layout", libver="latest") as file:
        file.create_dataset("observations", data=STATES, chunks=(2, 2), compression="gzip")
        file["timeouts"] = ENDS
    with hdf5("virtual") as file:
        d4rl(file)
        file.move("observations", "parts")
        layout = h5py.VirtualLayout(shape=(6, 2), dtype="f4")
        layout[:] = h5py.VirtualSource(".", "parts", shape=(6, 2))
        file.create_virtual_dataset("observations", layout)
    with hdf5("external-storage") as file:
        file["terminals"] = NEVER
        file["timeouts"] = ENDS
        file.create_dataset("observations", (6, 2), "f4", external=[("raw.bin", 0, 48)])
    (OUT / "raw.bin").unlink(missing_ok=True)
    # A filter that nobody has: the number is that of Blosc.
    with hdf5("filter") as file:
        d4rl(file)
        del file["observations"]
        space = h5py.h5s.create_simple((6, 2))
        settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        settings.set_chunk((6, 2))
        settings.set_filter(32001, h5py.h5z.FLAG_OPTIONAL)
        h5py.h5d.create(file.id, b"observations", h5py.h5t.IEEE_F32LE, space, settings)


def layouts():
    with hdf5("padded-names") as file:
        for i in range(11):
            group = file.create_group(f"episode_{i:05}")
            group["observations"] = STATES[:3] + 10 * i
            group["terminations"] = np.array([False, i % 2 == 0])
            group["truncations"] = np.array([False, i % 2 == 1])
    with hdf5("robomimic") as file:
        for i in range(2):
            demo = file.create_group(f"data/demo_{i}")
            demo["obs/joints"] = STATES[3 * i : 3 * i + 3]
            demo["obs/object"] = STATES[3 * i : 3 * i + 3, :1]
            demo["actions"] = np.zeros((3, 7))
            demo["rewards"] = np.zeros(3)
            demo["dones"] = np.array([0, 0, 1])
            if i == 0:
                demo["next_obs/joints"] = STATES[3 * i : 3 * i + 3] + 2
    with hdf5("aloha") as file:
        file["observations/qpos"] = STATES
        file["observations/qvel"] = STATES + 1
        file.create_dataset("observations/images/top", (6, 40, 40, 3), "u1", compression="gzip")
        file["action"] = np.zeros((6, 14))
    with hdf5("maniskill") as file:
        for i in range(2):
            group = file.create_group(f"traj_{i}")
            group["obs/agent/qpos"] = STATES[3 * i : 3 * i + 3]
            group["actions"] = np.zeros((2, 8))
            group["terminated"] = np.array([False, i == 0])
            group["truncated"] = np.array([False, i == 1])
    for name in ("dones", "is_last", "episode_id"):
        with hdf5(f"flat-{name}") as file:
            file["observations"] = STATES
            file[name] = np.array([4, 4, 4, 2, 2, 2]) if name == "episode_id" else ENDS
    with hdf5("flat-without-flags") as file:
        file["observations"] = STATES


def positions():
    """Arrays that are shorter than the states: where episodes end or begin, and how long they are."""
    with hdf5("ends-in-meta") as file:
        file["data/state"] = STATES
        file["data/action"] = np.zeros((6, 2))
        file["meta/episode_ends"] = np.array([3, 6])
    with hdf5("axes") as file:
        file["observations"] = STATES.reshape(6, 1, 2)
        file["terminals"] = NEVER
        file["timeouts"] = ENDS
    with hdf5("pandas-table") as file:
        file["df/_i_table/index/bounds"] = np.zeros((0, 127))
        file["df/table"] = np.array([(0, (0, 1))], [("index", "i8"), ("values_block_0", "f4", (2,))])
    np.savez(OUT / "ends.npz", observations=STATES, episode_ends=np.array([3, 6]))
    np.savez(OUT / "last-rows.npz", observations=STATES, episode_ends=np.array([2, 5]))
    np.savez(OUT / "starts.npz", observations=STATES, episode_starts=np.array([0, 3]))
    np.savez(OUT / "lengths.npz", observations=STATES, episode_lengths=np.array([3, 3]))
    np.savez(OUT / "wrong-lengths.npz", observations=STATES, episode_lengths=np.array([3, 4]))
    np.savez(OUT / "one-more.npz", observations=STATES, terminals=np.arange(5) == 4)
    np.savez(OUT / "one-more-of-several.npz", observations=STATES, terminals=np.arange(5) == 2)
    np.savez(OUT / "folders.npz", **{"a/obs": STATES, "a/dones": ENDS, "b/obs": STATES, "b/dones": NEVER})
    np.savez(OUT / "trajectory.npz", traj=STATES, other=STATES)


def arrays():
    np.save(OUT / "float16.npy", STATES.astype("f2"))
    np.save(OUT / "long-double.npy", STATES.astype("longdouble"))
    np.save(OUT / "fortran.npy", np.asfortranarray(STATES))
    np.save(OUT / "flat.npy", STATES[:, 0])
    np.save(OUT / "text.npy", STATES.astype("U4"))
    fields = [("x", "f4"), ("y", "f8"), ("v", "f4", (2,)), ("done", "?"), ("reward", "f4")]
    rows = [(x, y, (x + y, 0), end, 0) for (x, y), end in zip(STATES, ENDS)]
    np.save(OUT / "records.npy", np.array(rows, fields))
    np.savez(OUT / "flat.npz", observations=STATES, terminals=NEVER, timeouts=ENDS, rewards=np.zeros(6))
    np.savez_compressed(
        OUT / "successors.npz",
        observations=STATES,
        next_observations=STATES + 2,
        actions=np.zeros((6, 1)),
        terminals=ENDS,
        timeouts=NEVER,
    )
    np.savez_compressed(OUT / "dones.npz", obs=STATES.astype("f2"), dones=ENDS)
    np.savez(OUT / "episodes.npz", STATES[:3], STATES[3:])
    np.savez(OUT / "batched.npz", states=STATES.reshape(2, 3, 2))
    np.save(OUT / "gym-maze.npy", np.array([[0, 2], [8, 1]]))
    np.save(OUT / "grid.npy", np.array([[1, 1, 1, 1], [1, 0, 0, 1], [1, 1, 1, 1]], bool))


if __name__ == "__main__":
    OUT.mkdir(exist_ok=True)
    for make in (links, storage, layouts, positions, arrays):
        make()
