"""Timed joint trajectories."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from minidual.errors import DataError, UsageError
from minidual.robot.pair import Array


def largest(x: Array) -> Array:
    """Return the largest |x| per column. NaN propagates."""
    return np.abs(np.ascontiguousarray(x.T)).max(axis=1)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples at regular times.

    Attributes:
        times: (n,) [s], from 0; n >= 2.
        q: (n, dof) [rad].
        v: [rad/s].
        a: [rad/s^2].
    """

    times: Array
    q: Array
    v: Array
    a: Array
    group: str

    def __post_init__(self) -> None:
        n = len(self.times)
        if n < 2 or self.q.ndim != 2 or any(x.shape != (n, self.q.shape[1]) for x in (self.q, self.v, self.a)):
            raise UsageError(
                f"a trajectory needs n >= 2 times and q, v, a of one shape (n, joints); got {self.times.shape}, "
                f"{self.q.shape}, {self.v.shape}, {self.a.shape}"
            )
        if not all(np.isfinite(x).all() for x in (self.times, self.q, self.v, self.a)):
            raise DataError("a trajectory holds a value that is not finite")
        even = np.arange(n) * self.times[1]
        if self.times[0] != 0.0 or self.times[1] <= 0.0 or np.abs(self.times - even).max() > 1e-9:
            raise UsageError("the times of a trajectory must start at 0 and grow in equal steps")

    @property
    def duration_s(self) -> float:
        """Last time [s]."""
        return float(self.times[-1])

    @property
    def dt_s(self) -> float:
        """Time step."""
        return float(self.times[1] - self.times[0])

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Return q, v, a (dof,) at t, clamped to the ends."""
        q, v, a = self.sample_many(np.array([t]))
        return q[0], v[0], a[0]

    def sample_many(self, times: Array) -> tuple[Array, Array, Array]:
        """Return q, v, a (m, dof) at times (m,).

        q is a cubic Hermite interpolant, v its derivative; a is linear.
        """
        t = np.clip(np.asarray(times, dtype=float), 0.0, self.duration_s)
        h = self.dt_s
        i = np.minimum((t / h).astype(int), len(self.times) - 2)
        x = ((t - self.times[i]) / h)[:, None]
        q0, q1, v0, v1 = self.q[i], self.q[i + 1], self.v[i] * h, self.v[i + 1] * h
        q = (
            q0 * (2 * x**3 - 3 * x**2 + 1)
            + v0 * (x**3 - 2 * x**2 + x)
            + q1 * (3 * x**2 - 2 * x**3)
            + v1 * (x**3 - x**2)
        )
        v = ((q0 - q1) * (6 * x**2 - 6 * x) + v0 * (3 * x**2 - 4 * x + 1) + v1 * (3 * x**2 - 2 * x)) / h
        a = self.a[i] * (1 - x) + self.a[i + 1] * x
        return q, v, a

    def variation_rates(self) -> Array:
        """Return bounds on the speed within each step (n - 1, dof) [rad/s], from Bezier coefficients."""
        h = self.dt_s
        middle = 3.0 * np.diff(self.q, axis=0) / h - self.v[:-1] - self.v[1:]
        return np.abs([self.v[:-1], self.v[1:], middle]).max(axis=0)

    def digest(self) -> str:
        """Return a sha256 of all samples."""
        h = hashlib.sha256(self.group.encode())
        for x in (self.times, self.q, self.v, self.a):
            h.update(np.ascontiguousarray(x).tobytes())
        return h.hexdigest()

    def write_json(self, path: Path, joint_names: Sequence[str], every: int = 1) -> None:
        """Write every `every`-th sample and the last."""
        rows = np.unique(np.append(np.arange(0, len(self.times), every), len(self.times) - 1))
        content = {
            "group": self.group,
            "joint_names": list(joint_names),
            "times_s": self.times[rows].round(6).tolist(),
            "q_rad": self.q[rows].round(9).tolist(),
            "v_rad_per_s": self.v[rows].round(9).tolist(),
            "a_rad_per_s2": self.a[rows].round(9).tolist(),
        }
        path.write_text(json.dumps(content), encoding="utf-8")

    def write_csv(self, path: Path, joint_names: Sequence[str]) -> None:
        """Write time, q, v, a."""
        header = [f"{name}_{unit}" for unit in ("rad", "rad_per_s", "rad_per_s2") for name in joint_names]
        table = np.column_stack([self.times, self.q, self.v, self.a])
        header = ",".join(["time_s", *header])
        np.savetxt(path, table, "%.9g", ",", "\r\n", header, comments="", encoding="utf-8")
