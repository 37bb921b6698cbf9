"""Hosts that share nothing but a bad network: namespaces for network, processes, /dev/shm and /tmp, joined by TUN devices.

A thread carries packets between the devices and treats each as it is told: delays it, loses it, lets others overtake it, or holds
it back to a rate. No kernel module is needed. Needs root.
"""

import ctypes
import fcntl
import heapq
import os
import random
import select
import struct
import subprocess
import threading
import time

CLONE_NEWNET = 0x40000000
TUNSETIFF = 0x400454CA
IFF_TUN, IFF_NO_PI = 0x0001, 0x1000
MTU = 1400
# Packets that wait for a slow network; more are lost.
QUEUE = 400

libc = ctypes.CDLL(None, use_errno=True)


def sh(*words):
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)


class Network:
    """A star of hosts `names`, the first of which is 10.77.0.1."""

    def __init__(self, names, seed):
        self.names = [f"trestle-{os.getpid()}-{name}" for name in names]
        self.address = {name: f"10.77.0.{nth + 1}" for nth, name in enumerate(names)}
        self.space = dict(zip(names, self.names))
        self.random = random.Random(seed)
        self.delay = self.loss = self.overtake = 0.0
        self.rate = None
        self.cut = False
        # Bytes of packets that each host has sent and that were carried.
        self.sent = dict.fromkeys(self.address.values(), 0)
        self.over = False
        self.devices = {}
        try:
            for name in names:
                sh("ip", "netns", "add", self.space[name])
                self.devices[self.address[name]] = self._tun(self.space[name])
                for words in (
                    ("addr", "add", f"{self.address[name]}/24", "dev", "tun0"),
                    ("link", "set", "tun0", "mtu", str(MTU), "up"),
                    ("link", "set", "lo", "up"),
                ):
                    sh("ip", "netns", "exec", self.space[name], "ip", *words)
        except BaseException:
            self.close()
            raise
        self.thread = threading.Thread(target=self._carry, daemon=True)
        self.thread.start()

    def _tun(self, space):
        """A TUN device in `space`. The device stays there when this thread has returned to its own namespace."""
        own = os.open("/proc/self/ns/net", os.O_RDONLY)
        other = os.open(f"/var/run/netns/{space}", os.O_RDONLY)
        try:
            if libc.setns(other, CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), "setns")
            device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH", b"tun0", IFF_TUN | IFF_NO_PI))
            return device
        finally:
            libc.setns(own, CLONE_NEWNET)
            os.close(own)
            os.close(other)

    def _carry(self):
        waiting, nth, free = [], 0, 0.0
        while not self.over:
            now = time.monotonic()
            while waiting and waiting[0][0] <= now:
                _, _, device, packet = heapq.heappop(waiting)
                try:
                    os.write(device, packet)
                except OSError:
                    pass
            pause = min(0.05, waiting[0][0] - now) if waiting else 0.05
            ready, _, _ = select.select(list(self.devices.values()), [], [], max(0.0, pause))
            for device in ready:
                for _ in range(64):
                    try:
                        packet = os.read(device, 65536)
                    except OSError:
                        break
                    if packet[0] >> 4 != 4:
                        continue
                    source, target = (".".join(str(byte) for byte in packet[at : at + 4]) for at in (12, 16))
                    to = self.devices.get(target)
                    if to is None or self.cut or self.random.random() < self.loss or len(waiting) >= QUEUE:
                        continue
                    now = time.monotonic()
                    at = now + self.delay
                    if self.rate:
                        free = max(free, now) + 8 * len(packet) / self.rate
                        at = free + self.delay
                    if self.random.random() < self.overtake:
                        at += 0.03
                    self.sent[source] = self.sent.get(source, 0) + len(packet)
                    nth += 1
                    heapq.heappush(waiting, (at, nth, to, packet))

    def start(self, name, words, env, log):
        """Starts a command on a host, with its own /dev/shm, /tmp and processes, as one process group."""
        script = 'mount -t tmpfs tmpfs /dev/shm && mount -t tmpfs tmpfs /tmp && "$@"; status=$?; ls /dev/shm /tmp; exit $status'
        inside = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc", "sh", "-c", script, "sh", *words]
        return subprocess.Popen(
            ["ip", "netns", "exec", self.space[name], *inside],
            env={**os.environ, **env},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    @property
    def bytes(self):
        """Bytes of all packets that were carried."""
        return sum(self.sent.values())

    def close(self):
        self.over = True
        if hasattr(self, "thread"):
            self.thread.join()
        for device in self.devices.values():
            os.close(device)
        for space in self.names:
            subprocess.run(["ip", "netns", "del", space], stderr=subprocess.DEVNULL, check=False)
