"""A synthetic rig with motion capture: readings by magpylib of a robot that differs from its file, and its poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from edition1.kinematics.robot import Robot
from edition1.robot_file.load import load_robot
from edition1.robot_file.robot_file import RobotFile
from edition1.sensing.magnetic import readings
from edition1.sensing.placement import Tolerances, placed
from edition1_live.record.recording_file import RecordingFile
from edition1_live.robot.calibration_poses import coordinate_columns
from edition1_live.wire.frame import Frame

ROBOTS = Path(__file__).parents[3] / "data" / "robots"


@dataclass(frozen=True)
class Rig:
    """A robot as built, moving smoothly for a while; times by the clock of its board."""

    robot: RobotFile
    built: Robot
    gain: torch.Tensor
    offset: torch.Tensor
    waves: torch.Tensor
    rate_hz: float
    seconds: float
    seed: int

    @classmethod
    def of(cls, name: str, *, seed: int = 0, rate_hz: float = 50.0, seconds: float = 26.0) -> Rig:
        robot = load_robot(ROBOTS / f"{name}.toml")
        generator = torch.Generator().manual_seed(seed)
        scale = Tolerances(sensor_gain=0.03).of_parameters(robot.robot, len(robot.moments))
        off = scale * torch.randn(len(scale), dtype=torch.float64, generator=generator)
        parts = placed(robot.robot, robot.moments, off)
        built = Robot(robot.robot.segments, parts.magnets, parts.sensors)
        offset = 0.1 * torch.randn(len(parts.gain), dtype=torch.float64, generator=generator)
        waves = torch.rand(robot.robot.n_q, 3, 2, dtype=torch.float64, generator=generator)
        strength = parts.moments[0] / robot.moments[0]
        return cls(robot, built, parts.gain * strength, offset, waves, rate_hz, seconds, seed)

    def q(self, time_s: np.ndarray) -> torch.Tensor:
        """Configurations: three sines for each coordinate, of 0.1 to 0.6 Hz, within 0.85 of the bounds."""
        t = torch.from_numpy(time_s)[:, None, None]
        rate, phase = 0.1 + 0.5 * self.waves[..., 0], 2 * np.pi * self.waves[..., 1]
        share = torch.sin(2 * np.pi * rate * t + phase).mean(-1)
        middle, width = (self.robot.lower + self.robot.upper) / 2, self.robot.upper - self.robot.lower
        return middle + 0.425 * width * share

    @property
    def readings_s(self) -> np.ndarray:
        return np.arange(round(self.seconds * self.rate_hz)) / self.rate_hz

    def values(self) -> np.ndarray:
        """Readings, by magpylib and with noise."""
        u = readings(self.built, self.q(self.readings_s), self.robot.magnet) * self.gain + self.offset
        noise = np.random.default_rng(self.seed).standard_normal(tuple(u.shape))
        return u.numpy() + self.robot.noise * noise

    def write_csv(self, path: Path, *, unit: str = "mT", values: np.ndarray | None = None) -> Path:
        values = self.values() if values is None else values
        names = [f"u{k + 1}_{unit}" for k in range(values.shape[1])]
        return write(path, {"time_s": self.readings_s} | dict(zip(names, values.T, strict=True)))

    def write_recording(self, path: Path) -> Path:
        """As ``repro record`` writes it, of a board that sends its time; arrivals are late by up to 3 ms."""
        late = np.random.default_rng(self.seed).integers(0, 3_000_000, len(self.readings_s))
        with RecordingFile(path, {"format": "frames", "start_unix_s": 0.0, "start_host_ns": 0}) as file:
            for k, (t, row) in enumerate(zip(self.readings_s, self.values().tolist(), strict=True)):
                file.append(
                    round(1e9 * t) + int(late[k]) * (k > 0), [Frame(0, k, round(1e6 * t), tuple(row))]
                )
        return path

    def capture_s(self, rate_hz: float, lag_s: float) -> np.ndarray:
        """Times of the frames by the clock of the motion capture, which is behind by the lag."""
        n = int((self.seconds - 1.0) * rate_hz)
        return np.arange(n) / rate_hz + 0.4 - lag_s

    def measured(
        self, rate_hz: float = 60.0, lag_s: float = 0.37, noise_m: float = 5e-5
    ) -> tuple[np.ndarray, torch.Tensor]:
        """Times by motion capture's clock, and measured configurations."""
        time_s = self.capture_s(rate_hz, lag_s)
        noise = np.random.default_rng(self.seed + 1).standard_normal((len(time_s), self.robot.robot.n_q))
        return time_s, self.q(time_s + lag_s) + noise_m * torch.from_numpy(noise)

    def write_poses(self, path: Path, time_s: np.ndarray, q: torch.Tensor) -> Path:
        columns = coordinate_columns(self.robot)
        rows = (q / torch.tensor(list(columns.values()))).T.numpy()
        return write(path, {"time_s": time_s} | dict(zip(columns, rows, strict=True)))

    def write_ends(self, path: Path, time_s: np.ndarray, q: torch.Tensor, *, unit: str = "mm") -> Path:
        """Poses of the segments' ends."""
        table, factor = {"time_s": time_s}, {"mm": 1e3, "m": 1.0}[unit]
        for k, T in enumerate(self.robot.robot.base_poses(q)[:, 1:].unbind(1), start=1):
            quaternion = Rotation.from_matrix(T[:, :3, :3].numpy()).as_quat()
            table |= {f"{a}_{k}_{unit}": factor * T[:, i, 3].numpy() for i, a in enumerate("xyz")}
            table |= {f"q{a}_{k}": quaternion[:, i] for i, a in enumerate("xyzw")}
        return write(path, table)

    def write_motive(
        self, path: Path, time_s: np.ndarray, q: torch.Tensor, *, base: np.ndarray, gaps: slice
    ) -> Path:
        """As Motive exports two bodies, base and tip: y up, metres, 1.23; the base is turned about y."""
        T = self.robot.robot.tip(q).numpy()
        world = Rotation.from_euler("z", 25, degrees=True)
        tip = world * Rotation.from_matrix(T[:, :3, :3])
        position = base + world.apply(T[:, :3, 3])
        still = np.repeat(world.as_quat()[None], len(q), axis=0)
        rows = []
        for k, t in enumerate(time_s):
            cells = [
                *_motive(still[k]),
                *_motive(base),
                0.0,
                *_motive(tip[k].as_quat()),
                *_motive(position[k]),
            ]
            text = [f"{x:.6f}" for x in (*cells, 0.0)]
            if k in range(*gaps.indices(len(q))):
                text[8:] = [""] * (len(text) - 8)
            rows.append(f"{k},{t:.6f}," + ",".join(text))
        kinds = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
        head = [
            "Format Version,1.23,Take Name,made up,Capture Frame Rate,120.000000,Export Frame Rate,120.000000,"
            f"Total Exported Frames,{len(rows)},Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global",
            "",
            ",Type," + ",".join(["Rigid Body"] * 16),
            ",Name," + ",".join(["Foot"] * 8 + ["Tip"] * 8),
            ",ID," + ",".join(["1"] * 8 + ["2"] * 8),
            ",," + ",".join(kinds * 2),
            "Frame,Time (Seconds)," + ",".join(["X", "Y", "Z", "W", "X", "Y", "Z", ""] * 2),
        ]
        path.write_text("\n".join([*head, *rows]) + "\n")
        return path


def _motive(xyz: np.ndarray) -> list[float]:
    """From axes with z up to Motive's with y up; a fourth number is the scalar part of a quaternion."""
    x, y, z, *w = xyz
    return [x, z, -y, *w]


def write(path: Path, table: dict[str, np.ndarray]) -> Path:
    rows = [",".join(map(repr, map(float, row))) for row in zip(*table.values(), strict=True)]
    path.write_text("\n".join([",".join(table), *rows]) + "\n")
    return path
