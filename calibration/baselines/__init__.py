"""Simple predictors of the tip that a rod has to beat: no motion, constant curvature, a quadratic polynomial."""

from calibration.baselines.selection import BaselineFit, fit_baselines
from calibration.baselines.tip_inputs import TipInputs, inputs_of

__all__ = ["BaselineFit", "TipInputs", "fit_baselines", "inputs_of"]
