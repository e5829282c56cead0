"""A robot: a chain with its parts, what it reads, whether its design can work, and its picture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, overload

from repro.check import DesignCheck, check_design
from repro.common import ArrayLike, require
from repro.improve import Improvement, improve_design
from repro.parts import Assembly
from repro.plots import plot_robot
from repro.readings import Readings, read_readings
from repro.sensing import Sensing, sensing_of

if TYPE_CHECKING:
    import pandas as pd


class Robot(Assembly):
    """Segments from base to tip, with magnets, sensors and IMUs on them.

    Its configuration ``q`` holds the coordinates of all segments, one after the other. Leading dimensions are a
    batch. Poses are 4 x 4 matrices in the frame of the base, whose z axis points along the straight robot; lengths
    are in metres, angles in radians.

    Parameters
    ----------
    segments
        From base to tip: :class:`ConstantCurvature`, :class:`AffineCurvature`, :class:`Link`, :class:`BallJoint`,
        :class:`FreeBody`, in any order.
    magnets
        Each a :class:`repro.Magnet` on a segment or on the base.
    sensors
        Each a :class:`Sensor` on a segment or on the base.
    imus
        Each an :class:`Imu` on a segment or on the base.
    lower, upper
        Bounds of ``q`` ``[n_q]`` [m, rad]. Equal bounds fix a coordinate. Azimuths and rotations need none: NaN or
        infinity gives them a whole turn.
    start
        Where estimators start ``[n_q]``; they choose for themselves if not given.
    noise
        Standard deviation of a reading [mT; rad for IMUs], one number or one for each. What a sensor states of its
        own noise comes first.
    rate_hz
        Readings per second.
    earth
        Field of the Earth in the base frame [mT]; none if not given.
    model
        Trained networks that predict the readings: see :class:`repro.Sensing`.
    moments
        Multipole moments ``[m, terms]`` [mT m^(l+2)] in place of the shapes of the magnets.
    source
        The file that it was read from.

    Raises
    ------
    InputError
        If there is no segment, something is mounted where there is none, or numbers do not fit the coordinates or
        the readings.

    Examples
    --------
    A chain of three kinds of segments:

    >>> from repro import AffineCurvature, ConstantCurvature, Link, Robot
    >>> robot = Robot([ConstantCurvature(0.11, 0.022), Link(0.02), AffineCurvature(0.2)])
    >>> robot.coordinates
    ('delta_x_1', 'delta_y_1', 'delta_L_1', 'kappa_0_3', 'kappa_1_3', 'phi_3', 'delta_L_3')
    >>> robot.tip([0.0] * 7)[:3, 3].round(3)
    array([0.  , 0.  , 0.33])
    """

    def __repr__(self) -> str:
        """Say what it is made of."""
        kinds = ", ".join(type(segment).__name__ for segment in self.segments)
        parts = f"{len(self.magnets)} magnets, {len(self.sensors)} sensors, {len(self.imus)} IMUs"
        return f"Robot of {kinds}; {parts}; {self.n_q} coordinates"

    def sensing(self) -> Sensing:
        """Return the sensor model with the gain and offset of every sensor and the Earth's field."""
        return sensing_of(self)

    def readings(self, table: str | os.PathLike[str] | pd.DataFrame) -> Readings:
        """Return the readings of a table ``[t, s]``: flux densities in mT, rotation vectors of IMUs in rad.

        Columns are found by the names of channels, or by their numbers (``u1_mT``, ``ch2``, ``channel_3``), and their
        units are taken from their names; without a unit they are in mT. What a board has printed is read too, with
        commas, tabs, blanks or labels: without names its columns are those of the readings, in their order. An IMU
        has the four columns of its quaternion (``qx_1`` to ``qw_1``), or rows with the number of its ``stream``.

        A cell without a number, what :meth:`missing` names and a quaternion of zeros are NaN, a missing reading. The
        result has the ``times`` of the rows [s], or None, the ``lines`` where they stand, and ``remarks``: sentences
        that say what is missing, left out or put together. Copies and parts of it keep them.

        Parameters
        ----------
        table
            A data frame, or the path of a text file.

        Raises
        ------
        InputError
            If a column is missing, there twice, or of another unit; if a cell is no number, times do not increase or
            quaternions are no orientations; with the file and the line.
        """
        return read_readings(self, table)

    @overload
    def check(self, *, samples: int = 400, seed: int = 0) -> DesignCheck: ...

    @overload
    def check(
        self,
        *,
        samples: int = 400,
        seed: int = 0,
        improve: Literal["calibrated", "as built"],
        target: float | None = None,
    ) -> Improvement: ...

    def check(
        self, *, samples: int = 400, seed: int = 0, improve: str | None = None, target: float | None = None
    ) -> DesignCheck:
        """Ask whether the design can work, before any reading is taken: see :class:`repro.check.DesignCheck`.

        In random shapes within the bounds it finds how well readings determine the tip, by noise alone and with the
        tolerances of the parts; sensors that contribute nothing or go beyond their range; what stays undetermined.
        ``print`` shows it in a few lines, the last of them a verdict.

        With ``improve`` it looks for a better design where this one cannot work or misses a target, by moving what is
        ``free`` of magnets and sensors, and by more chips: the smallest median deviation of the tip. It returns the
        check of the better design, an :class:`repro.improve.Improvement` with the changes in words and the better
        robot.

        Parameters
        ----------
        samples
            Number of random shapes.
        seed
            Seed of their generator, and of the search.
        improve
            ``"calibrated"`` or ``"as built"``: make the deviation small after a calibration or before one.
        target
            Median deviation of the tip that is wanted [m], with ``improve``.

        Raises
        ------
        InputError
            If the robot states no bounds or no noise, or has no sensors; or nothing of it may change.
        """
        if improve is None:
            require(target is None, "target", "check", "left out without improve", target)
            return check_design(self, samples=samples, seed=seed)
        known = ("calibrated", "as built")
        require(improve in known, "improve", "check", f"one of {', '.join(known)}", repr(improve))
        return improve_design(self, target=target, as_built=improve == "as built", samples=samples, seed=seed)

    def plot(
        self, q: ArrayLike | None = None, *, axes: Any = None, labels: Sequence[str] | None = None
    ) -> Any:
        """Draw the robot in one shape or several on each other, and return the axes: :func:`repro.plots.plot_robot`.

        Parameters
        ----------
        q
            Configurations ``[n_q]`` or ``[k, n_q]``; its start, the middle of its bounds, or straight, if not given.
        axes
            matplotlib axes in three dimensions to draw on; new ones if not given.
        labels
            One name for each shape.
        """
        return plot_robot(self, q, axes=axes, labels=labels)
