"""Linear interpolation of columns over time."""

from __future__ import annotations

from model.arrays import Array
from rig.tip_control.kernels.compilation import internal


@internal
def interval_at(t_s: float, times_s: Array) -> tuple[int, float]:
    """Index of the sample before a time, and the share (0 to 1) of the way to the next; times (n,) ascend, n > 1.

    Before the first time the share is 0, after the last 1.
    """
    last = len(times_s) - 1
    if t_s <= times_s[0]:
        return 0, 0.0
    if t_s >= times_s[last]:
        return last - 1, 1.0
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if times_s[middle] <= t_s:
            low = middle
        else:
            high = middle
    return low, (t_s - times_s[low]) / (times_s[low + 1] - times_s[low])


@internal
def interpolate(t_s: float, times_s: Array, values: Array, found: Array) -> None:
    """Write the values (n, m) at a time into `found` (m,): linear in between, at the ends the first and the last."""
    if len(times_s) == 1:
        found[:] = values[0]
        return
    left, share = interval_at(t_s, times_s)
    for column in range(values.shape[1]):
        if share == 0.0:
            found[column] = values[left, column]
        elif share == 1.0:
            found[column] = values[left + 1, column]
        else:
            found[column] = values[left, column] + share * (values[left + 1, column] - values[left, column])
