r"""The board's clock against the host's: unwrapped time, offset and drift.

A frame that leaves the board at device time :math:`d` arrives at host time :math:`h = o + (1 + \delta) d + \ell` with
a latency :math:`\ell \ge 0` of the cable, the driver and the scheduler: never early, often late. So the line sought
lies below all points and as high as it can; of all such lines, the one with the least sum of latencies contains the
edge of the lower convex hull below the mean device time. The hull is kept while frames arrive: it has few corners.
What no such estimate can see is the smallest latency: the offset is late by it.
"""

from __future__ import annotations

from bisect import bisect
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from edition1.errors import bad_input
from edition1_live.wire.frame import WRAP

EARLY_S = 0.5
"""A frame that arrives this much earlier than the earliest before it comes from a clock that began anew [s]."""
_EARLY_PER_S = 1e-3
"""Added to it for each second without frames: more than any clock drifts."""
LATE_S = 5.0
"""After a reopened port, the same for later; otherwise a late frame was held up in a buffer."""
MOST_CORNERS = 128
"""Corners of the hull kept; every second one is dropped beyond."""
_PARTS = 4
"""Parts of the arrivals, taken in turn, whose lines are compared to state an error."""
LEAST_S = 10.0
"""No drift is estimated from less [s]."""


@dataclass(frozen=True)
class ClockFit:
    """The line from device time to host time since the board's last start.

    Attributes
    ----------
    device_us
        Device time at the middle, unwrapped [µs].
    host_ns
        Monotonic host time at that device time [ns].
    offset_error_us
        Standard deviation of this offset between four parts of the arrivals, taken in turn [µs]; so it holds for a
        quarter of them. The offset is late by the smallest latency, which nothing shows and which is not in here.
    drift_ppm, drift_error_ppm
        By how much the board's clock runs fast against the host's [1e-6], and its standard deviation, as above; NaN
        over less than :data:`LEAST_S`.
    span_s
        Device time covered [s].
    restarts
        Times at which the board's clock began anew.
    """

    device_us: float
    host_ns: int
    offset_error_us: float
    drift_ppm: float
    drift_error_ppm: float
    span_s: float
    restarts: int

    def host_s(self, device_us: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " frames"]:
        """Monotonic host times [s] of unwrapped device times [µs] since the last start."""
        drift = 0.0 if np.isnan(self.drift_ppm) else self.drift_ppm
        return 1e-9 * self.host_ns + 1e-6 * (device_us - self.device_us) / (1 + 1e-6 * drift)


class DeviceClock:
    """Device times as they arrive: unwrapped, checked for restarts, and fitted to the host's clock.

    All streams of a port share the board's clock. Memory is bounded. A step of the times is read as a wrap or as
    a restart, whichever agrees with the host's clock:

    - no step goes back (of all multiples of 2^32 µs, the one nearest to the host's step is added first);
    - no frame arrives :data:`EARLY_S` before the earliest so far would have it; late ones were held up;
    - after `reopened`, none arrives :data:`LATE_S` late either.

    A restart that agrees with all of these, as of a board cut off for about 71.6 minutes, is not seen.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._reopened = False
        self._last: tuple[int, int, int] | None = None  # host [ns], device as sent, device unwrapped [us]

    def _start(self, host_ns: int, device_us: int) -> None:
        self._last = (host_ns, device_us, device_us)
        self._earliest_us = host_ns / 1e3 - device_us  # host minus device, least since this start
        self._origin = (device_us, host_ns)
        self._line, self._parts = _LowerLine(), [_LowerLine() for _ in range(_PARTS)]
        self._arrivals = 0

    def reopened(self) -> None:
        """Say that the port was closed and opened: the next frame may come from a board that was switched off."""
        self._reopened = True

    def add(
        self, host_ns: int | Int[np.ndarray, " frames"], device_us: Int[np.ndarray, " frames"]
    ) -> tuple[Int[np.ndarray, " frames"], Bool[np.ndarray, " frames"]]:
        """Take frames in order of arrival.

        Parameters
        ----------
        host_ns
            Arrival by the host's monotonic clock [ns], of all or of each.
        device_us
            Device times as sent [µs].

        Returns
        -------
        unwrapped, restarted
            Device time since the board's last start [µs], and whether a frame is the first after one.
        """
        sent = np.asarray(device_us, dtype=np.int64)
        if sent.size and not (sent.min() >= 0 and sent.max() < WRAP):
            raise bad_input(
                "device_us", "DeviceClock", "32 bits without sign", f"{sent.min()} to {sent.max()}"
            )
        host = np.broadcast_to(np.asarray(host_ns, dtype=np.int64), sent.shape)
        unwrapped, restarted = np.empty_like(sent), np.zeros(sent.shape, dtype=bool)
        first = 0
        while first < len(sent):
            end = self._run(host, sent, unwrapped, restarted, first)
            self._fit_in(host[first:end], unwrapped[first:end])
            first = end
        return unwrapped, restarted

    def _run(
        self,
        host: np.ndarray,
        sent: np.ndarray,
        unwrapped: np.ndarray,
        restarted: np.ndarray,
        first: int,
    ) -> int:
        """Unwrap from ``first`` up to the next restart; return where that is."""
        if self._last is None:
            self._start(int(host[first]), int(sent[first]))
        assert self._last is not None
        last_host, last_sent, last_unwrapped = self._last
        part = slice(first, min(len(sent), first + 4096))
        host_us = np.diff(host[part], prepend=last_host) / 1e3
        steps = np.diff(sent[part], prepend=last_sent)
        steps += WRAP * np.rint((host_us - steps) / WRAP).astype(np.int64)
        total = last_unwrapped + np.cumsum(steps)
        offset = host[part] / 1e3 - total
        before = np.minimum.accumulate(np.append(self._earliest_us, offset[:-1]))
        anew = (steps < 0) | (offset < before - 1e6 * EARLY_S - _EARLY_PER_S * np.maximum(host_us, 0.0))
        if self._reopened:
            anew[0] |= bool(offset[0] > before[0] + 1e6 * LATE_S)
            self._reopened = False
        if anew[0]:
            self.restarts += 1
            restarted[first] = True
            self._start(int(host[first]), int(sent[first]))
            return self._run(host, sent, unwrapped, restarted, first)
        n = int(np.argmax(anew)) if anew.any() else len(total)
        unwrapped[first : first + n] = total[:n]
        self._earliest_us = float(min(before[n - 1], offset[n - 1]))
        self._last = (int(host[first + n - 1]), int(sent[first + n - 1]), int(total[n - 1]))
        return first + n

    def _fit_in(self, host: np.ndarray, device: np.ndarray) -> None:
        """Add frames to the lines; of those that arrived together only the last can touch one."""
        x = (device - self._origin[0]).astype(float)
        y = (host - self._origin[1]) / 1e3 - x  # little but latency and drift: no digits are lost
        last = np.append(np.diff(host) > 0, True)
        points = list(zip(x[last].tolist(), y[last].tolist(), strict=True))
        self._line.add(points)
        for k, line in enumerate(self._parts):
            line.add(points[(k - self._arrivals) % _PARTS :: _PARTS])
        self._arrivals += len(points)

    def fit(self) -> ClockFit | None:
        """Return the line since the last start, or None before the second arrival."""
        if self._last is None or len(self._line.corners) < 2:
            return None
        x = self._line.mean_x
        height, slope = self._line.at(x)
        span_s = 1e-6 * self._line.corners[-1][0]
        parts = [line.at(x) for line in self._parts if len(line.corners) > 1]
        errors = np.std(parts, axis=0, ddof=1) if len(parts) == _PARTS else np.full(2, np.nan)
        long = span_s >= LEAST_S
        return ClockFit(
            device_us=self._origin[0] + x,
            host_ns=self._origin[1] + round(1e3 * (x + height)),
            offset_error_us=float(errors[0]),
            drift_ppm=1e6 * (1 / (1 + slope) - 1) if long else np.nan,
            drift_error_ppm=1e6 * float(errors[1]) if long else np.nan,
            span_s=span_s,
            restarts=self.restarts,
        )


class _LowerLine:
    """The line below all points that leaves the least sum of heights above it; points come in order of x."""

    def __init__(self) -> None:
        self.corners: list[tuple[float, float]] = []
        self.mean_x = 0.0
        self._count = 0

    def add(self, points: list[tuple[float, float]]) -> None:
        """Keep the lower convex hull."""
        hull = self.corners
        for x, y in points:
            self._count += 1
            self.mean_x += (x - self.mean_x) / self._count
            if hull and x <= hull[-1][0]:
                if y >= hull[-1][1]:
                    continue
                hull.pop()
            while len(hull) > 1:
                (x0, y0), (x1, y1) = hull[-2:]
                if (y1 - y0) * (x - x1) < (y - y1) * (x1 - x0):
                    break
                hull.pop()
            hull.append((x, y))
        if len(hull) > MOST_CORNERS:
            hull[1:-1] = hull[1:-1:2]

    def at(self, x: float) -> tuple[float, float]:
        """Height at ``x``, and slope, of the edge below the mean; there must be two corners."""
        hull = self.corners
        k = min(max(bisect([corner[0] for corner in hull], self.mean_x) - 1, 0), len(hull) - 2)
        (x0, y0), (x1, y1) = hull[k : k + 2]
        slope = (y1 - y0) / (x1 - x0)
        return y0 + slope * (x - x0), slope
