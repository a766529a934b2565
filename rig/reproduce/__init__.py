"""The paper's tables and figures again: the model by the printed numbers, the experiments by a rig."""
