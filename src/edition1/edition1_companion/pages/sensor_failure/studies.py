"""Are faults of sensors noticed? What the study ``alarms`` of an emulated robot with a monitor says; synthetic."""

from __future__ import annotations

import pandas as pd


def alarm_table(study: pd.DataFrame) -> pd.DataFrame:
    """What the study says, in per cent.

    Returns
    -------
    pandas.DataFrame
        ``robot, estimator, scenario``; ``off_percent``, readings after the fault at which the tip is off;
        ``noticed_percent`` of those that are due; ``unseen_percent``, readings at which it is off and the residuals
        cannot tell; ``named_percent``, trials with a clear signal in which a sensor was named, and
        ``named_right_percent`` of those in which one was; ``alarms_before``, readings with an alarm before the fault;
        ``holds_percent``, trusted readings whose 95 % ellipsoid holds the truth.
    """
    share = {
        "off_percent": ("wrong", "readings"),
        "noticed_percent": ("noticed", "due"),
        "unseen_percent": ("unseen", "readings"),
        "named_percent": ("named_clear", "clear"),
        "named_right_percent": ("named_right", "named"),
        "holds_percent": ("trusted_hold", "trusted"),
    }
    columns = {name: study[name] for name in ("robot", "estimator", "scenario")}
    for column, (part, whole) in share.items():
        columns[column] = 100 * study[part] / study[whole].where(study[whole] > 0)
    return pd.DataFrame(columns | {"alarms_before": study["alarms_before"].astype(int)})
