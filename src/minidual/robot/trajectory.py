"""Timed joint trajectories."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from minidual.durable import replacing, write_text
from minidual.errors import DataError, UsageError
from minidual.robot.pair import Array


class JointSamples(NamedTuple):
    """Positions [rad], velocities [rad/s] and accelerations [rad/s^2] of one shape."""

    q: Array
    v: Array
    a: Array


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples at regular times.

    Attributes:
        times: (n,) [s], from 0; n >= 2.
        q: (n, dof) [rad].
        v: (n, dof) [rad/s].
        a: (n, dof) [rad/s^2].
        group: Planning group that moves.

    Raises:
        UsageError: Shapes differ, or the times do not grow from 0 in equal steps.
        DataError: A value is not finite.
    """

    times: Array
    q: Array
    v: Array
    a: Array
    group: str

    def __post_init__(self) -> None:
        n = len(self.times)
        is_table = self.q.ndim == 2 and len(self.q) == n
        shapes_agree = self.v.shape == self.q.shape == self.a.shape
        if n < 2 or not is_table or not shapes_agree:
            raise UsageError(
                "a trajectory needs n >= 2 times and q, v, a of one shape (n, joints); "
                f"got {self.times.shape}, {self.q.shape}, {self.v.shape}, {self.a.shape}",
            )
        if not all(np.isfinite(x).all() for x in (self.times, self.q, self.v, self.a)):
            raise DataError("a trajectory holds a value that is not finite")
        regular = np.arange(n) * self.times[1]
        grows_from_0 = self.times[0] == 0.0 and self.times[1] > 0.0
        if not grows_from_0 or np.abs(self.times - regular).max() > 1e-9:
            raise UsageError("the times of a trajectory must start at 0 and grow in equal steps")

    @property
    def duration_s(self) -> float:
        """Last time [s]."""
        return float(self.times[-1])

    @property
    def dt_s(self) -> float:
        """Time step [s]."""
        return float(self.times[1] - self.times[0])

    def sample(self, t_s: float) -> JointSamples:
        """Return q, v, a (dof,) at a time, clamped to the ends."""
        samples = self.sample_many(np.array([t_s]))
        return JointSamples(samples.q[0], samples.v[0], samples.a[0])

    def sample_many(self, times: Array) -> JointSamples:
        """Return q, v, a (m, dof) at times (m,) [s], clamped to the ends.

        q is a cubic Hermite interpolant, v its derivative; a is linear.
        """
        t = np.clip(np.asarray(times, dtype=float), 0.0, self.duration_s)
        h = self.dt_s
        i = np.minimum((t / h).astype(int), len(self.times) - 2)
        x = ((t - self.times[i]) / h)[:, None]
        q0 = self.q[i]
        q1 = self.q[i + 1]
        v0 = self.v[i] * h
        v1 = self.v[i + 1] * h
        q = (
            q0 * (2 * x**3 - 3 * x**2 + 1)
            + v0 * (x**3 - 2 * x**2 + x)
            + q1 * (3 * x**2 - 2 * x**3)
            + v1 * (x**3 - x**2)
        )
        v = (
            (q0 - q1) * (6 * x**2 - 6 * x) + v0 * (3 * x**2 - 4 * x + 1) + v1 * (3 * x**2 - 2 * x)
        ) / h
        a = self.a[i] * (1 - x) + self.a[i + 1] * x
        return JointSamples(q, v, a)

    def variation_rates(self) -> Array:
        """Return bounds on the speed within each step (n - 1, dof) [rad/s].

        They are the largest Bezier coefficients of the velocity of each cubic.
        """
        h = self.dt_s
        middle = 3.0 * np.diff(self.q, axis=0) / h - self.v[:-1] - self.v[1:]
        return np.abs([self.v[:-1], self.v[1:], middle]).max(axis=0)

    def digest(self) -> str:
        """Return a sha256 of all samples."""
        sha256 = hashlib.sha256(self.group.encode())
        for x in (self.times, self.q, self.v, self.a):
            sha256.update(np.ascontiguousarray(x).tobytes())
        return sha256.hexdigest()

    def write_json(self, path: Path, joint_names: Sequence[str], every: int = 1) -> None:
        """Write every `every`-th sample and the last, atomically."""
        last = len(self.times) - 1
        rows = np.unique(np.append(np.arange(0, last + 1, every), last))

        def column(values: Array) -> list[float]:
            return values[rows].round(9).tolist()

        content = {
            "group": self.group,
            "joint_names": list(joint_names),
            "times_s": column(self.times),
            "q_rad": column(self.q),
            "v_rad_per_s": column(self.v),
            "a_rad_per_s2": column(self.a),
        }
        write_text(path, json.dumps(content))

    def write_csv(self, path: Path, joint_names: Sequence[str]) -> None:
        """Write time, q, v, a, atomically: a truncated file would be a shorter trajectory."""
        columns = ["time_s"]
        for unit in ("rad", "rad_per_s", "rad_per_s2"):
            columns += [f"{name}_{unit}" for name in joint_names]
        table = np.column_stack([self.times, self.q, self.v, self.a])
        with replacing(path) as partial:
            np.savetxt(
                partial,
                table,
                fmt="%.9g",
                delimiter=",",
                newline="\r\n",
                header=",".join(columns),
                comments="",
                encoding="utf-8",
            )
