"""Reproduction of the paper's tables and figures: the model with the printed numbers, the experiments with a rig."""
