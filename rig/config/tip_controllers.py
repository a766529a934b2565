"""The tip controllers of softrig: the only place that names them."""

from __future__ import annotations

FEED_FORWARD = "feed-forward"
"""No controller: the set-points of the protocol."""
CONTROLLERS = {
    "horizon": "rig.tip_control.horizon:HorizonControl",
    "static-inverse": "rig.tip_control.baselines:StaticInverse",
    "inverse-integral": "rig.tip_control.baselines:InverseIntegral",
}
"""Class of each controller by its name."""
KNOWN = ", ".join([FEED_FORWARD, *CONTROLLERS])
"""Their names, for messages and help."""
